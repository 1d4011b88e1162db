"""Symmetries of photometric files, and Types A and B."""

import numpy as np
import pytest

from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.formats.reading import without_noise
from lumitree.formats.type_c import (
    IntensityDistribution,
    completed,
    direction_of,
    on_grid,
    turned_of_type_b,
    type_a,
)


@pytest.mark.parametrize(
    ("c", "same"),
    [
        ([0.0], lambda c: 0 * c),
        ([0.0, 30, 90], lambda c: np.minimum(c % 180, 180 - c % 180)),
        ([0.0, 60, 170, 180], lambda c: np.minimum(c, 360 - c)),
        ([0.0, 100, 200, 300, 360], lambda c: c),
        ([0.0, 90, 180, 270], lambda c: c),
        ([90.0, 130, 180, 270], lambda c: np.where((c >= 90) & (c <= 270), c, (180 - c) % 360)),
        ([180.0, 250, 360], lambda c: np.maximum(c, 360 - c)),
        (
            [-90.0, -20, 90],
            lambda c: np.where(np.cos(np.deg2rad(c)) > 0, (c + 90) % 360 - 90, 180 - c),
        ),
        ([270.0, 340, 450], lambda c: np.where(c < 90, c + 360, np.where(c > 270, c, 540 - c))),
    ],
)
def test_symmetries_of_files(c, same):
    """The completed distribution is that of the file at the mirrored angle."""
    gamma = np.array([0.0, 50, 180])
    values = np.random.default_rng(0).random((len(c), 3))
    if c[-1] - c[0] == 360:
        values[-1] = values[0]
    whole = IntensityDistribution("", *completed(np.array(c), gamma, values))
    angles = np.arange(0.5, 360, 7)
    planes = np.append(c, 360.0) if len(c) == 4 and c[0] == 0 else np.array(c)
    rows = np.append(values[:, 1], values[0, 1]) if len(planes) > len(c) else values[:, 1]
    expected = np.interp(same(angles), planes, rows)
    assert whole.at(direction_of(angles, 50.0)) == pytest.approx(expected)


def test_ranges_of_gamma_are_filled_with_darkness():
    values = np.ones((1, 2))
    below = IntensityDistribution("", *completed(np.zeros(1), np.array([0.0, 90]), values))
    above = IntensityDistribution("", *completed(np.zeros(1), np.array([90.0, 180]), values))
    assert below.at([[0, -1, 0], [1, -0.1, 0], [1, 0.1, 0], [0, 1, 0]]).tolist() == [1, 1, 0, 0]
    assert above.at([[0, -1, 0], [1, -0.1, 0], [1, 0.1, 0], [0, 1, 0]]).tolist() == [0, 0, 1, 1]
    assert below.lumens == pytest.approx(2 * np.pi, rel=1e-4)


@pytest.mark.parametrize(
    ("c", "gamma"),
    [
        ([0.0, 120], [0.0, 180]),
        ([90.0, 180], [0.0, 180]),
        ([0.0], [0.0, 190]),
        ([0.0], [-10.0, 90]),
        ([0.0, 400], [0.0, 180]),
        # There are no planes between 270 and 360.
        ([0.0, 30, 60, 90, 120, 150, 180, 210, 240, 270], [0.0, 180]),
    ],
)
def test_other_angles_are_refused(c, gamma):
    with pytest.raises(LumitreeError, match="angles"):
        completed(np.array(c), np.array(gamma), np.ones((len(c), len(gamma))))


def type_b(horizontal, vertical, intensity):
    return on_grid(turned_of_type_b(horizontal, vertical, intensity))


@pytest.mark.parametrize(
    ("horizontal", "vertical"),
    [([0, 200], [-90, 90]), ([-90, 90], [-100, 200]), ([-90, 90, 80], [0, 90]), ([], [0, 90])],
)
def test_other_angles_of_types_a_and_b_are_refused(horizontal, vertical):
    values = np.ones((len(horizontal), len(vertical)))
    for convert in (type_a, type_b):
        with pytest.raises(LumitreeError, match=r"angles|planes"):
            convert(np.array(horizontal, float), np.array(vertical, float), values)


def test_small_negative_intensities_are_noise():
    with pytest.warns(LumitreeWarning, match="a.ies: small negative"):
        values = without_noise("a.ies", np.array([[1000.0, -0.05, 3]]))
    assert values.tolist() == [[1000, 0, 3]]
    with pytest.raises(LumitreeError, match="negative intensity, -2 cd"):
        without_noise("a.ies", np.array([[1000.0, -2.0]]))
