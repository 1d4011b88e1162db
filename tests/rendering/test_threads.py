"""Several threads load and render scenes at once, as a web service does."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import lumitree
from support.fields import random_asset

_IMAGES = 4


def room(mi, reflectance):
    transform = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "to_world": transform().look_at([0, 1, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 12, "height": 8, "rfilter": {"type": "box"}},
        },
        "wall": {
            "type": "rectangle",
            "to_world": transform().translate([0, 0, -2]).scale(6),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}},
        },
    }


@pytest.mark.slow
def test_two_threads_render_two_scenes_at_once(mi):
    """Dr.Jit also traces the emitters that another thread is just creating."""

    def image(number):
        lamp = lumitree.Placement(random_asset(number), at=(0, 0, 0), size=1.5)
        scene = room(mi, [0.3 + 0.4 * number, 0.5, 0.2])
        return lumitree.render(scene, [lamp], spp=4, progress=None).pixels

    def images(number):
        start.wait()
        return [image(number) for _ in range(_IMAGES)]

    alone, start = [image(0), image(1)], threading.Barrier(2)
    with ThreadPoolExecutor(2) as threads:
        found = list(threads.map(images, (0, 1)))
    for number in (0, 1):
        for pixels in found[number]:
            np.testing.assert_allclose(pixels, alone[number], rtol=1e-4, atol=1e-6)
    assert np.abs(alone[0] - alone[1]).max() > 0.01
