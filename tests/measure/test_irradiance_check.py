"""The warning of a bake with a large irradiance error, and its likely cause."""

import warnings

import pytest

from lumitree.asset.asset import light_field_asset
from lumitree.core.results import Stopwatch
from lumitree.errors import LumitreeWarning
from lumitree.fit.light_field.bake import bake_light_field
from lumitree.measure.irradiance import measure_irradiance
from lumitree.trace.light_field_config import LightFieldConfig
from support.lamps import AREA, cube, lamp_of

PATHS = 1 << 16
DISK = f'<shape type="disk" id="disk">{AREA}</shape>'


def _measured(folder, depth, resolution, *shapes):
    """`irradiance` of a lamp, whose light field has bins of this number a side."""
    lamp = lamp_of(folder, *shapes)
    config = LightFieldConfig(paths=PATHS, batch=PATHS, depth=depth, resolution=resolution)
    field = bake_light_field(lamp, config, folder)
    return measure_irradiance(
        light_field_asset(field, lamp.frame, "lamp"), lamp, PATHS, Stopwatch()
    )


@pytest.mark.parametrize(
    ("depth", "others", "cause"),
    [
        (5, (), "narrow beams"),
        (1, (), "only 4 cells"),
        (3, (cube("pole", (0.1, 0.1, 4), (0, 0, -4.2)),), "in one far part of its box"),
    ],
)
def test_a_large_error_is_told_with_its_likely_cause(mi, tmp_path, depth, others, cause):
    """A disk, which emits to one side, in bins of 45 degrees."""
    with pytest.warns(
        LumitreeWarning, match=rf"RMS error of \d\d%, expected at most 10%: .*{cause}"
    ):
        found = _measured(tmp_path, depth, 4, DISK, *others)
    assert found["irradiance_rms"] > 0.1


def test_a_small_error_is_not(mi, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error", LumitreeWarning)
        found = _measured(tmp_path, 4, 32, DISK)
    assert found["irradiance_rms"] < 0.05
