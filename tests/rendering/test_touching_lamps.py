"""A surface that touches the box of a lamp, such as a table, gets the light beside it."""

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.core.frames import LocalFrame
from support.light_fields import random_light_field
from support.slow import slow

HALF = np.array([1.0, 0.6, 0.8])
# Distance of the table below the box, in units of half the height of the box. A table far higher
# counts as an object in the box.
GAPS = [-1.9e-3, slow(-1e-3), -1e-5, slow(-3e-7), 0.0, slow(3e-7), 1e-6, slow(1e-5), slow(1e-3)]
# Where nothing touches.
FAR = 5e-3


@pytest.fixture(scope="module")
def asset(mi):
    frame = LocalFrame(HALF, np.eye(4))
    return light_field_asset(random_light_field(3, resolution=8, count=20), frame, "lamp")


def room(mi, asset, gap, turned):
    """A lamp on a table, or, turned round, below a ceiling."""
    lamp = lumitree.shape(asset, np.diag([1.0, -1, -1, 1]) if turned else np.eye(4))
    up = -1 if turned else 1
    level = -up * HALF[1] * (1 + gap)
    to_world = (
        mi.ScalarTransform4f().translate([0, level, 0]).rotate([1, 0, 0], -90 * up).scale(0.7)
    )
    table = {"type": "rectangle", "to_world": to_world, "bsdf": {"type": "diffuse"}}
    return mi.load_dict({"type": "scene", "lamp": lamp, "table": table}), level, up


def seen(mi, asset, gap, turned):
    """Mean radiance of an image of the middle of the table, through the lamp's box."""
    scene, level, up = room(mi, asset, gap, turned)
    to_world = mi.ScalarTransform4f().look_at([2, 1.8 * up, 1.5], [0, level, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    camera = {"type": "perspective", "fov": 14, "to_world": to_world, "film": film}
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": 2})
    image = mi.render(scene, sensor=mi.load_dict(camera), integrator=integrator, spp=2048, seed=1)
    return np.array(image).mean()


@pytest.fixture(scope="module")
def beside(mi, asset):
    return {turned: seen(mi, asset, FAR, turned) for turned in (False, True)}


@pytest.mark.parametrize("turned", [False, slow(True)], ids=["table", "ceiling"])
@pytest.mark.parametrize("gap", GAPS)
def test_images(mi, asset, beside, gap, turned):
    assert seen(mi, asset, gap, turned) == pytest.approx(beside[turned], rel=0.03)
