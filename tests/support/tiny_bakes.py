"""`lumitree` with bakes of seconds: `python tiny_bakes.py bake lamp.xml -o lamp.lumitree`."""

import dataclasses
import sys

from lumitree.asset.asset import PARTS
from lumitree.cli import main
from lumitree.fit.config import NETWORK_BAKES, QUALITIES, BakeConfig, NetworkConfig
from lumitree.fit.network.config import PRESETS
from lumitree.fit.octree.config import (
    CalibrationConfig,
    EstimateConfig,
    FluxConfig,
    HeldOutConfig,
    MaxRadianceConfig,
    OctreeConfig,
    RefineConfig,
    SplitConfig,
)
from lumitree.trace.light_field_config import LightFieldConfig, LightFieldFitConfig

# Budget of rays of an octree fit, and rays of its first estimate.
RAYS, ESTIMATE_RAYS = 1 << 19, 1 << 20
LIGHT_FIELD = LightFieldConfig(paths=1 << 18, batch=1 << 18, depth=3, resolution=32)
LIGHT_FIELD = LightFieldFitConfig(paths=1 << 18, batch=1 << 18, depth=3, resolution=32)
IRRADIANCE_PATHS = 1 << 14


GROUPS = OctreeConfig(
    max_radiance=MaxRadianceConfig(rays=1 << 18),
    estimate=EstimateConfig(rays=ESTIMATE_RAYS, growth_rays=1 << 19, batch_rays=1 << 19),
    calibration=CalibrationConfig(rays=1 << 14),
    flux=FluxConfig(draws=2, rays=1 << 18),
    held_out=HeldOutConfig(rays=1 << 15),
    refine=RefineConfig(rays=1 << 14),
    split=SplitConfig(indicator_rays=1 << 15),
)


def bake_config(**options):
    """Settings of a bake of all parts in seconds, about four million rays and paths in all.

    Args:
        options: other settings; those of a group of the octree fit, as `refine`, are a dictionary
            of some of them.
    """
    groups = {
        name: dataclasses.replace(getattr(GROUPS, name), **options.pop(name))
        for name in [each for each in options if isinstance(options[each], dict)]
    }
    few = {"parts": PARTS, "tree_depth": 5, "l_max": 1, "time": None, "rays": RAYS, **options}
    octree = dataclasses.replace(GROUPS, **groups)
    return BakeConfig(
        irradiance_paths=IRRADIANCE_PATHS, light_field=LIGHT_FIELD, octree=octree, **few
    )


def octree_fit(**options):
    """The octree fit of `bake_config`."""
    return bake_config(**options).octree_fit


def standard(**options):
    """The quality "standard", or what `set_qualities` has put in its place, with other settings."""
    return dataclasses.replace(BakeConfig.standard(), **options)


def network_config():
    """Settings of a bake by a small network from few views."""
    train = dataclasses.replace(
        PRESETS["preview"], width=32, output_width=16, num_coarse=16, num_fine=16,
        rays_per_batch=512, num_steps=250,
    )  # fmt: skip
    return NetworkConfig(
        num_views=16,
        resolution=48,
        samples_per_pixel=32,
        tree_depth=5,
        samples_per_leaf=256,
        irradiance_paths=IRRADIANCE_PATHS,
        light_field=LIGHT_FIELD,
        train=train,
    )


def set_qualities(set_item, **options):
    """Make all qualities those of bakes of seconds, for commands and functions with defaults.

    Args:
        set_item: as `dict.__setitem__`, or the `setitem` of pytest's monkeypatch.
        options: as for `bake_config`.
    """
    for name in QUALITIES:
        set_item(QUALITIES, name, bake_config(**options))


if __name__ == "__main__":
    set_qualities(dict.__setitem__)
    NETWORK_BAKES["preview"] = network_config()
    PRESETS["preview"] = NETWORK_BAKES["preview"].train
    sys.exit(main())
