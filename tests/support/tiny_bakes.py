"""`lumitree` with bakes of seconds: `python tiny_bakes.py bake lamp.xml -o lamp.lumitree`."""

import dataclasses
import sys

from lumitree.cli import main
from lumitree.fit import bake_network as network
from lumitree.fit.network.config import PRESETS
from lumitree.fit.octree.config import (
    QUALITIES,
    CalibrationConfig,
    DirectConfig,
    EstimateConfig,
    FluxConfig,
    HeldOutConfig,
    MaxRadianceConfig,
    RefineConfig,
    SplitConfig,
)
from lumitree.measure.irradiance_check import IRRADIANCE_PATHS
from lumitree.trace.light_field_config import EXITANT_QUALITIES, ExitantConfig

# Budget of rays of a direct bake, and rays of its first estimate.
RAYS, ESTIMATE_RAYS = 1 << 19, 1 << 20
EXITANT = ExitantConfig(paths=1 << 18, batch=1 << 18, depth=3, resolution=32)


def direct_config(**options):
    """Settings of a direct bake of seconds, about four million rays and paths in all.

    Args:
        options: other settings; those of a group, as `refine`, are a dictionary of some of them.
    """
    few = {
        "max_radiance": MaxRadianceConfig(rays=1 << 18),
        "estimate": EstimateConfig(rays=ESTIMATE_RAYS, growth_rays=1 << 19, batch_rays=1 << 19),
        "calibration": CalibrationConfig(rays=1 << 14),
        "flux": FluxConfig(draws=2, rays=1 << 18),
        "held_out": HeldOutConfig(rays=1 << 15),
        "refine": RefineConfig(rays=1 << 14),
        "split": SplitConfig(indicator_rays=1 << 15),
    }
    config = DirectConfig(tree_depth=5, l_max=1, seconds=None, rays=RAYS, **few)
    groups = {
        name: dataclasses.replace(getattr(config, name), **value)
        for name, value in options.items()
        if isinstance(value, dict)
    }
    return dataclasses.replace(config, **{**options, **groups})


def network_preset():
    """Settings of a bake by a small network from few views."""
    train = dataclasses.replace(
        PRESETS["preview"], width=32, output_width=16, num_coarse=16, num_fine=16,
        rays_per_batch=512, num_steps=250,
    )  # fmt: skip
    return network.NetworkBake(16, 48, 32, 5, train)


def set_qualities(set_item, **options):
    """Make all qualities those of bakes of seconds.

    Args:
        set_item: as `dict.__setitem__`, or the `setitem` of pytest's monkeypatch.
        options: as for `direct_config`.
    """
    for name in QUALITIES:
        set_item(QUALITIES, name, direct_config(**options))
        set_item(EXITANT_QUALITIES, name, EXITANT)
        set_item(IRRADIANCE_PATHS, name, 1 << 14)


if __name__ == "__main__":
    set_qualities(dict.__setitem__)
    network.NETWORK_BAKES["preview"] = network_preset()
    PRESETS["preview"] = network.NETWORK_BAKES["preview"].train
    sys.exit(main())
