"""Settings of the octree fit: documented, and refused where they are wrong.

A bake with settings at their least values ends well, or in one line.
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


# The settings of views are not used where rays are traced.
TRACED = [each for each in SETTINGS if each[0] != "views"]
COUNTS = [each for each in TRACED if type(each[2][0]) is int]
OTHER_GROUPS = sorted({each[0] for each in TRACED if each not in COUNTS})


def bake_with(lamp, folder, group, values):
    """An asset baked in seconds with other values of a group."""
    from lumitree.fit.octree.bake import bake

    groups = {group: dataclasses.replace(getattr(FEW, group), **values)}
    few = dataclasses.replace(FEW, tree_depth=4, l_max=1, time=None, rays=1 << 15, **groups)
    return bake(lamp(sphere("lamp", 2, (1, 0, 0), AREA)), few, folder).asset


@pytest.mark.slow
@pytest.mark.parametrize(("group", "name", "limits"), COUNTS)
def test_a_bake_at_the_least_count(lamp, tmp_path, group, name, limits):
    # Some are refused beside the others, or too few to bake anything from.
    with contextlib.suppress(LumitreeError):
        assert bake_with(lamp, tmp_path, group, {name: limits[0]}).num_leaves > 0


@pytest.mark.slow
@pytest.mark.parametrize("group", OTHER_GROUPS)
def test_a_bake_at_the_least_values_that_are_no_counts(lamp, tmp_path, group):
    least = {name: low for of, name, (low, _) in SETTINGS if of == group and type(low) is float}
    # It must be above the least emission.
    least.pop("max_emission", None)
    assert bake_with(lamp, tmp_path, group, least).num_leaves > 0
