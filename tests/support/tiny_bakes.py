"""`lumitree` with bakes of seconds: `python tiny_bakes.py bake lamp.xml -o lamp.lumitree`."""

import dataclasses
import sys

from lumitree.asset.asset import PARTS
from lumitree.cli import main
from lumitree.fit.config import BakeConfig, NetworkConfig
from lumitree.fit.network.config import TrainConfig
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
from lumitree.trace.light_field_config import LightFieldConfig

# Budget of rays of an octree fit, and rays of its first estimate.
RAYS, ESTIMATE_RAYS = 1 << 19, 1 << 20
LIGHT_FIELD = LightFieldConfig(paths=1 << 18, batch=1 << 18, depth=3, resolution=32)
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

# As few rays in all stages, for what does not depend on how good the result is.
SMALLEST = {
    "max_radiance": {"rays": 1 << 16},
    "estimate": {
        "rays": 1 << 17,
        "growth_rays": 1 << 15,
        "batch_rays": 1 << 15,
        "start_level": 3,
        "max_level": 4,
    },
    "calibration": {"rays": 1 << 12},
    "flux": {"rays": 1 << 14},
    "held_out": {"rays": 1 << 12},
    "refine": {"rays": 1 << 11},
    "split": {"indicator_rays": 1 << 12},
}


def bake_config(**options):
    """Settings of a bake of all parts in seconds, about four million rays and paths in all.

    Args:
        options: other settings of the bake, and settings of the octree fit, as for `octree_config`.
    """
    of_octree = {each.name for each in dataclasses.fields(OctreeConfig)} & set(options)
    octree = octree_config(**{name: options.pop(name) for name in of_octree})
    few = {"parts": PARTS, "irradiance_paths": IRRADIANCE_PATHS, "light": LIGHT_FIELD, **options}
    return BakeConfig(octree=octree, network=NETWORK, **few)


def octree_config(**options):
    """The octree fit of `bake_config`.

    Args:
        options: other settings; a group, such as `refine`, is a dictionary of some of its settings.
    """
    settings = {
        name: dataclasses.replace(getattr(GROUPS, name), **value)
        if isinstance(value, dict) else value
        for name, value in options.items()
    }  # fmt: skip
    few = {"tree_depth": 5, "l_max": 1, "time": None, "rays": RAYS, **settings}
    return dataclasses.replace(GROUPS, **few)


def standard(**options):
    """The quality "standard", or what `set_qualities` has put in its place, with other settings."""
    return dataclasses.replace(BakeConfig.of("standard"), **options)


NETWORK = NetworkConfig(
    views=16,
    resolution=48,
    spp=32,
    tree_depth=5,
    samples_per_leaf=256,
    train=dataclasses.replace(
        TrainConfig.preview(), width=32, output_width=16, num_coarse=16, num_fine=16,
        rays_per_batch=512, num_steps=250,
    ),
)  # fmt: skip


def set_qualities(set_attribute, **options):
    """Let all qualities mean bakes of seconds, for commands and functions with defaults.

    Args:
        set_attribute: as `setattr`, or the `setattr` of pytest's monkeypatch.
        options: as for `bake_config`.
    """

    def of(quality=None, method="octree"):
        few = bake_config(**options)
        return few if method == "octree" else dataclasses.replace(few, method=method, parts=None)

    set_attribute(BakeConfig, "of", staticmethod(of))


if __name__ == "__main__":
    set_qualities(setattr)
    sys.exit(main())
