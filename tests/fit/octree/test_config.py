"""Settings of the octree fit: documented, and refused where they are wrong.

A bake with any setting at its least value ends well, or in one line.
"""

import contextlib
import dataclasses
import inspect
import re

import pytest

from lumitree.errors import LumitreeError
from lumitree.fit.config import BakeConfig
from lumitree.fit.octree import config
from lumitree.fit.octree.config import CalibrationConfig, EstimateConfig, OctreeConfig
from support.lamps import AREA, sphere
from support.tiny_bakes import SMALLEST, octree_config

FEW = octree_config(**SMALLEST)
SETTINGS = [
    (group.name, field.name, field.metadata["limits"])
    for group in dataclasses.fields(OctreeConfig)
    if dataclasses.is_dataclass(group.default)
    for field in dataclasses.fields(group.default)
]


@pytest.mark.parametrize("name", [name for name in vars(config) if name.endswith("Config")])
def test_every_setting_is_documented(name):
    group = getattr(config, name)
    described = re.findall(r"\w+", group.__doc__.partition("Attributes:")[2])
    assert inspect.get_annotations(group).keys() <= set(described)


def test_qualities_are_for_bakes_of_more_and_more_time():
    preview, standard, high = (
        BakeConfig.of(name).octree for name in ("preview", "standard", "high")
    )
    assert preview.time < standard.time < high.time
    assert preview.tree_depth < standard.tree_depth < high.tree_depth


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"time": None, "rays": None}, "needs a budget"),
        ({"time": 0.0}, "time is 0.0; expected 0.001 to 31,536,000.0 seconds"),
        ({"time": float("nan")}, "time is nan"),
        ({"rays": 0}, "rays is 0"),
        ({"tree_depth": 0}, "tree depth is 0; expected 1 to 10"),
        ({"tree_depth": 11}, "tree depth is 11"),
        ({"l_max": -1}, "l_max is -1; expected 0 to 4"),
        ({"l_max": 5}, "l_max is 5"),
        ({"law": "cubic"}, "law is 'cubic'; expected linear, exponential"),
    ],
)
def test_wrong_settings_are_refused(settings, message):
    with pytest.raises(LumitreeError, match=message):
        OctreeConfig(**settings)


@pytest.mark.parametrize(
    ("group", "name", "value"),
    [
        (EstimateConfig, "batch_rays", 100),
        (CalibrationConfig, "region_levels", 4),
        (CalibrationConfig, "finest_level", 2),
    ],
)
def test_wrong_settings_of_a_group_are_refused(group, name, value):
    with pytest.raises(LumitreeError, match=f"{name} (is )?{value:g}"):
        group(**{name: value})


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
