"""A bake with any setting at its least value ends well, or in one line."""

import contextlib
import dataclasses

import pytest

from lumitree.errors import LumitreeError
from lumitree.fit.octree.config import OctreeConfig
from support.lamps import AREA, sphere
from support.tiny_bakes import GROUPS, octree_config

FEW = dataclasses.replace(
    GROUPS,
    max_radiance=dataclasses.replace(GROUPS.max_radiance, rays=1 << 16),
    estimate=dataclasses.replace(
        GROUPS.estimate,
        rays=1 << 17,
        growth_rays=1 << 15,
        batch_rays=1 << 15,
        start_level=3,
        max_level=4,
    ),
    calibration=dataclasses.replace(GROUPS.calibration, rays=1 << 12),
    flux=dataclasses.replace(GROUPS.flux, rays=1 << 14),
    held_out=dataclasses.replace(GROUPS.held_out, rays=1 << 12),
    refine=dataclasses.replace(GROUPS.refine, rays=1 << 11),
    split=dataclasses.replace(GROUPS.split, indicator_rays=1 << 12),
)
SETTINGS = [
    (group.name, field.name, field.metadata["limits"])
    for group in dataclasses.fields(OctreeConfig)
    if dataclasses.is_dataclass(group.default)
    for field in dataclasses.fields(group.default)
]


@pytest.mark.parametrize(("group", "name", "limits"), SETTINGS)
def test_limits_are_kept(group, name, limits):
    old = getattr(FEW, group)
    assert limits[0] <= getattr(old, name) <= limits[1]
    for value in (limits[0] - 1, limits[1] + 1, float("nan")):
        with pytest.raises(LumitreeError, match=rf"{name} is "):
            dataclasses.replace(old, **{name: value})


@pytest.mark.slow
@pytest.mark.parametrize(("group", "name", "limits"), SETTINGS)
def test_a_bake_at_the_least_value(lamp, tmp_path, group, name, limits):
    from lumitree.fit.octree.bake import bake

    ball = lamp(sphere("lamp", 2, (1, 0, 0), AREA))
    # Some are refused beside the others, or too few to bake anything from.
    with contextlib.suppress(LumitreeError):
        changed = dataclasses.replace(getattr(FEW, group), **{name: limits[0]})
        few = {
            each.name: vars(changed if each.name == group else getattr(FEW, each.name))
            for each in dataclasses.fields(OctreeConfig)
            if dataclasses.is_dataclass(each.default)
        }
        asset = bake(ball, octree_config(tree_depth=4, rays=1 << 15, **few), tmp_path).asset
        assert asset.num_leaves > 0
