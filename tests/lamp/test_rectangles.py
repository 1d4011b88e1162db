"""Rectangles: kernels read their transforms, and have no code for each of them."""

import numpy as np
import pytest

from lumitree.lamp.loading import load_luminaire
from lumitree.trace.lamp_rays import LampRays
from support.lamps import scene

SIDES = np.random.default_rng(0).uniform(0.1, 0.4, (12, 2))


def panels(folder, count):
    """A lamp of parallel rectangles of several sizes, which do not meet."""
    shapes = [
        f'<shape type="rectangle"><transform name="to_world"><scale x="{x}" y="{y}"/>'
        f'<translate x="{index}" z="{0.1 * index}"/></transform>'
        '<emitter type="area"><rgb name="radiance" value="2"/></emitter></shape>'
        for index, (x, y) in enumerate(SIDES[:count])
    ]
    path = folder / f"{count}.xml"
    path.write_text(scene("".join(shapes)))
    return load_luminaire(path)


def test_kernels_do_not_grow_with_the_number_of_rectangles(mi, tmp_path):
    import drjit as dr

    largest = []
    for count in (3, 12):
        lamp = panels(tmp_path, count)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            flux = np.array(LampRays(lamp).draw(1 << 10, 1).flux, np.float64).mean(axis=0).sum()
            kernels = dr.kernel_history([dr.KernelType.JIT])
        largest.append(max(kernel["operation_count"] for kernel in kernels))
        expected = np.pi * 2 * 4 * SIDES[:count].prod(axis=1).sum() / lamp.frame.scale**2
        assert flux == pytest.approx(expected, rel=0.1)
    assert largest[1] == pytest.approx(largest[0], rel=0.1)
