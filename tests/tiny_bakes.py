"""`lumitree` with bakes of seconds: `python tiny_bakes.py bake lamp.xml -o lamp.lumitree`."""

import dataclasses
import sys

from lumitree.api import baking
from lumitree.cli import main
from lumitree.nerf.config import PRESETS

# Refinement rays of a direct bake, and lines of its first estimate.
RAYS, LINES = 1 << 19, 1 << 20


def direct_config():
    """Settings of a direct bake of seconds."""
    from lumitree.direct.bake import DirectConfig
    from lumitree.direct.refine import RefineConfig

    return DirectConfig(
        tree_depth=5, l_max=1, estimate_lines=LINES, seconds=None, rays=RAYS,
        refine=RefineConfig(lines=1 << 14),
    )  # fmt: skip


def network_preset():
    """Settings of a bake by a small network from few views."""
    train = dataclasses.replace(
        PRESETS["preview"], width=32, output_width=16, num_coarse=16, num_fine=16,
        rays_per_batch=512, num_steps=250,
    )  # fmt: skip
    return baking.NetworkBake(16, 48, 32, 5, train)


if __name__ == "__main__":
    from lumitree.core.backend import load_mitsuba

    load_mitsuba("llvm_ad_rgb")
    from lumitree.direct import bake

    bake.QUALITIES["standard"] = direct_config()
    baking.NETWORK_BAKES["preview"] = network_preset()
    PRESETS["preview"] = baking.NETWORK_BAKES["preview"].train
    sys.exit(main())
