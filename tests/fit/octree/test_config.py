"""Settings of the octree fit: documented, and refused where they are wrong."""

import inspect
import re

import pytest

from lumitree.errors import LumitreeError
from lumitree.fit.config import BakeConfig
from lumitree.fit.octree import config
from lumitree.fit.octree.config import (
    CalibrationConfig,
    EstimateConfig,
    OctreeConfig,
    RefineConfig,
    ScheduleConfig,
)


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
        (EstimateConfig, "rays", 0),
        (EstimateConfig, "batch_rays", 100),
        (EstimateConfig, "prior_paths", -1.0),
        (EstimateConfig, "prior_paths", float("nan")),
        (ScheduleConfig, "score_interval", 0.0),
        (CalibrationConfig, "region_levels", 4),
        (CalibrationConfig, "finest_level", 2),
    ],
)
def test_wrong_settings_of_a_group_are_refused(group, name, value):
    with pytest.raises(LumitreeError, match=f"{name} (is )?{value:g}"):
        group(**{name: value})


@pytest.mark.parametrize(
    "settings",
    [
        {"rays": 0},
        {"rays": 100},
        {"epsilon": 0.0},
        {"density_rate": -1.0},
        {"coefficient_rate": 0.0},
        {"final_rate": 0.0},
        {"final_rate": 1.5},
        {"smoothing": -0.1},
        {"smoothing": 1.1},
    ],
)
def test_wrong_settings_of_the_descent_are_refused(settings):
    with pytest.raises(LumitreeError, match=next(iter(settings))):
        RefineConfig(**settings)
