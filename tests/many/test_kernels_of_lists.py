"""Lamps of the same plugins share the kernels of their bakes, whatever their numbers."""

import contextlib
import gc
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from support.tiny_bakes import bake_config
from support.variant import VARIANT

# Operations of a kernel that takes long to compile.
LARGE = 1000


def lamp(mi, seed):
    """A panel and a glass bulb in a metal cylinder, of random sizes, places and colours."""
    random = np.random.default_rng(seed)
    radius, side, height = random.uniform(0.1, 0.9, 3).tolist()

    def light():
        radiance = {"type": "rgb", "value": random.uniform(1, 9, 3).tolist()}
        return {"type": "area", "radiance": radiance}

    turned = mi.ScalarTransform4f().rotate([1, 0, 0], 40 * seed).scale([side, height, 1])
    metal = {"type": "roughconductor", "material": "Al", "alpha": random.uniform(0.1, 0.4)}
    return {
        "type": "scene",
        "panel": {"type": "rectangle", "to_world": turned, "light": light()},
        "glass": {"type": "sphere", "radius": radius, "bsdf": {"type": "dielectric"}},
        "wire": {"type": "sphere", "radius": radius / 2, "light": light()},
        "shade": {"type": "cylinder", "radius": 2 * radius, "p1": [0, 0, height], "bsdf": metal},
    }


def compiled(mi, seed):
    """Number of large kernels of a bake and a thumbnail that were not known."""
    import drjit as dr

    import lumitree
    from lumitree.many.page import write_thumbnail

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        config = bake_config(parts=("light", "geometry"))
        asset = lumitree.bake(lamp(mi, seed), None, config, progress=None).asset
        assert asset.geometry is not None
        write_thumbnail(Path(), str(seed), asset)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    large = [kernel for kernel in kernels if kernel["operation_count"] > LARGE]
    assert large
    return sum(not kernel["cache_hit"] for kernel in large)


@pytest.mark.slow
def test_another_lamp_compiles_no_large_kernel(tmp_path):
    environment = os.environ | {
        "DRJIT_CACHE_DIR": str(tmp_path),
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    run = subprocess.run(
        [sys.executable, __file__],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    # Kernels also depend on the plugins that there have been: the first thumbnail has new ones.
    first, second, *others = map(int, run.stdout.split())
    assert first > 2 >= second
    assert others == [0, 0]


def main():
    """Print the number of new kernels of each lamp."""
    from lumitree.core.backend import load_mitsuba, use_threads
    from lumitree.lamp import scene_file

    # Threads create the plugins of a scene in any order, on which kernels depend, too.
    use_threads(1)
    scene_file.second_thread = contextlib.nullcontext
    mi = load_mitsuba(VARIANT)
    for seed in range(4):
        print(compiled(mi, seed))
        # Tables in kernels are as long as the largest number of an object.
        gc.collect()


if __name__ == "__main__":
    main()
