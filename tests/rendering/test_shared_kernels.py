"""Lamps of equal depth, bands and resolution share kernels, whatever else differs."""

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from support.fields import random_asset
from support.light_fields import random_light_field
from support.slow import slow
from support.variant import VARIANT


def lamp(seed, parts):
    """A lamp with its own box, leaves, cells, L_max and scale."""
    count = 40 + seed
    field = random_asset(
        seed,
        half_extents=np.array([1.0, 0.9 - 0.1 * seed, 0.5]),
        max_radiance=5.0 + seed,
        density_scale=1.0 + seed,
    )
    light = random_light_field(seed, depth=3, resolution=8, count=count)
    light = dataclasses.replace(light, scale=light.scale * (1 + seed))
    return {
        "field": field,
        "both": dataclasses.replace(field, light_field=light),
        "light": light_field_asset(light, field.frame, "test"),
    }[parts]


def compiled(mi, asset):
    """Kernels that were not known when a scene with the lamp was made and rendered."""
    import drjit as dr

    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    look = mi.ScalarTransform4f().look_at([0, 2.5, 4], [0, -0.5, 0], [0, 1, 0])
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        scene = mi.load_dict(
            {
                "type": "scene",
                "sensor": {"type": "perspective", "to_world": look, "film": film},
                "floor": {"type": "sphere", "center": [0, -101.2, 0], "radius": 100},
                "lamp": lumitree.shape(asset),
            },
            # In parallel the order of emitters varies, which is a part of the kernels too.
            parallel=False,
        )
        for kind in ("lumitree_path", "volpath"):
            integrator = mi.load_dict({"type": kind, "max_depth": 3})
            image = np.array(mi.render(scene, integrator=integrator, spp=4))
            assert image.max() > 0
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert len(kernels) > 2
    return sum(not kernel["cache_hit"] for kernel in kernels)


@pytest.mark.slow
@pytest.mark.parametrize("parts", ["light", slow("both")])
def test_another_lamp_compiles_no_kernel(tmp_path, parts):
    """Each in a process of its own, with one cache.

    Kernels depend on which emitters and BSDFs there have been before, too.
    """
    environment = os.environ | {
        "DRJIT_CACHE_DIR": str(tmp_path),
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    counts = []
    for seed in range(3):
        command = [sys.executable, __file__, str(seed), parts]
        run = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert run.returncode == 0, run.stderr
        counts.append(int(run.stdout))
    assert counts[0] > 2
    assert counts[1:] == [0, 0]


def main(seed, parts):
    """Print the number of new kernels for a lamp."""
    from lumitree.core.backend import load_mitsuba
    from lumitree.rendering.register import register

    mi = load_mitsuba(VARIANT)
    register()
    print(compiled(mi, lamp(int(seed), parts)))


if __name__ == "__main__":
    main(*sys.argv[1:])
