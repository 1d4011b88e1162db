"""Symmetries of photometric files, and Types A and B."""

import numpy as np
import pytest

from lumitree.errors import LumitreeError
from lumitree.formats.symmetry import (
    completed,
    on_grid,
    turned_of_type_b,
    type_a,
    without_noise,
)
from lumitree.formats.type_c import IntensityDistribution, direction_of


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
        ([10.0, 90], [0.0, 180]),
        ([90.0, 180], [0.0, 180]),
        ([0.0, 90, 80], [0.0, 180]),
        ([0.0], [0.0, 190]),
        ([0.0], [-10.0, 90]),
        ([0.0], [90.0]),
        ([0.0, 400], [0.0, 180]),
        ([30.0, 210], [0.0, 180]),
        # There are no planes between 270 and 360.
        ([0.0, 30, 60, 90, 120, 150, 180, 210, 240, 270], [0.0, 180]),
    ],
)
def test_other_angles_are_refused(c, gamma):
    with pytest.raises(LumitreeError, match="angles"):
        completed(np.array(c), np.array(gamma), np.ones((len(c), len(gamma))))


def test_unusual_first_planes_are_the_same_planes():
    gamma, values = np.array([0.0, 90, 180]), np.random.default_rng(1).random((5, 3))
    values[-1] = values[0]
    first = completed(np.array([-180.0, -90, 0, 90, 180]), gamma, values)
    again = completed(np.array([0.0, 90, 180, 270, 360]), gamma, values[[2, 3, 4, 1, 2]])
    for one, other in zip(first, again, strict=True):
        assert one == pytest.approx(other)


ANGLES = np.arange(-90.0, 91, 10)


def type_b(horizontal, vertical, intensity):
    return on_grid(turned_of_type_b(horizontal, vertical, intensity))


@pytest.mark.parametrize("convert", [type_a, type_b])
def test_a_constant_half_space(convert):
    """100 cd over the half space in front: 2 pi 100 lm."""
    values = np.full((19, 19), 100.0)
    lamp = IntensityDistribution("", *convert(ANGLES, ANGLES, values))
    assert lamp.lumens == pytest.approx(200 * np.pi, rel=1e-4)
    front, back = ([1, 0, 0], [-1, 0, 0]) if convert is type_a else ([0, -1, 0], [0, 1, 0])
    assert lamp.at([front, back]).tolist() == pytest.approx([100, 0], abs=1e-2)


# Where H and V point: by the frames of LM-63.
DIRECTIONS = {
    type_a: {(0, 0): [1, 0, 0], (0, 90): [0, 1, 0], (0, -90): [0, -1, 0], (80, 0): [0.17, 0, 0.98]},
    type_b: {(0, 0): [0, -1, 0], (0, 80): [0.98, -0.17, 0], (80, 0): [0, -0.17, 0.98]},
}


@pytest.mark.parametrize("convert", [type_a, type_b])
def test_directions_of_types_a_and_b(convert):
    """A beam at one pair of angles is where the standard has it."""
    for (horizontal, vertical), direction in DIRECTIONS[convert].items():
        values = np.zeros((19, 19))
        values[np.where(horizontal == ANGLES)[0], np.where(vertical == ANGLES)[0]] = 1
        if abs(vertical) == 90:
            # Of Type A all H are one direction there.
            values[:, vertical == ANGLES] = 1
        lamp = IntensityDistribution("", *convert(ANGLES, ANGLES, values))
        assert lamp.at(direction) > 0.9
        assert lamp.at(-np.array(direction)) == 0
        assert lamp.at([direction[0], direction[1], -direction[2] or 0.9]) < 0.95


@pytest.mark.parametrize("convert", [type_a, type_b])
def test_half_of_the_angles_stand_for_symmetry(convert):
    half = ANGLES[ANGLES >= 0]
    values = np.random.default_rng(0).random((10, 10))
    whole = values[np.abs(ANGLES).astype(int) // 10][:, np.abs(ANGLES).astype(int) // 10]
    found, expected = convert(half, half, values), convert(ANGLES, ANGLES, whole)
    for one, other in zip(found, expected, strict=True):
        assert one == pytest.approx(other)


def test_type_b_has_the_flux_of_its_angles():
    """A cosine about the axis, over 80 degrees: the same by a sum over directions."""
    angles = np.arange(-80.0, 81, 5)
    h, v = np.meshgrid(np.deg2rad(angles), np.deg2rad(angles), indexing="ij")
    lamp = IntensityDistribution("", *type_b(angles, angles, np.cos(h) * np.cos(v)))
    # The integral of cos h cos v over the solid angle cos h dh dv.
    limit = np.deg2rad(80)
    exact = (limit + np.sin(2 * limit) / 2) * 2 * np.sin(limit)
    assert lamp.lumens == pytest.approx(exact, rel=2e-3)
    assert lamp.at([0.3, -1, 0.2]) == pytest.approx(1 / np.sqrt(1.13), rel=3e-3)


@pytest.mark.parametrize(
    ("horizontal", "vertical"),
    [([0, 200], [-90, 90]), ([-90, 90], [-100, 200]), ([-90, 90, 80], [0, 90]), ([], [0, 90])],
)
def test_other_angles_of_types_a_and_b_are_refused(horizontal, vertical):
    values = np.ones((len(horizontal), len(vertical)))
    for convert in (type_a, type_b):
        with pytest.raises(LumitreeError, match=r"angles|planes"):
            convert(np.array(horizontal, float), np.array(vertical, float), values)


@pytest.mark.parametrize("convert", [type_a, type_b])
def test_one_horizontal_angle_is_no_symmetry_of_types_a_and_b(convert):
    """LM-63 has it for Type C alone."""
    kind = "A" if convert is type_a else "B"
    with pytest.raises(
        LumitreeError,
        match=f"horizontal angles are 0, its vertical angles -90 to 90; expected several .*{kind}",
    ):
        convert(np.zeros(1), ANGLES, np.full((1, 19), 100.0))


def test_limits_of_angles_are_those_of_the_type():
    """H of Type A and V of Type B are longitudes about the axis, within -180 to 180 degrees."""
    wide, narrow = np.arange(-180.0, 181, 10), ANGLES
    values = np.full((37, 19), 100.0)
    for convert, angles, light in (
        (type_a, (wide, narrow), values),
        (type_b, (narrow, wide), values.T),
    ):
        lamp = IntensityDistribution("", *convert(*angles, light))
        # 100 cd in all directions.
        assert lamp.lumens == pytest.approx(400 * np.pi, rel=1e-3)
    for convert, angles, light in (
        (type_a, (narrow, wide), values.T),
        (type_b, (wide, narrow), values),
    ):
        shown = ["-180 to 180" if each is wide else "-90 to 90" for each in angles]
        with pytest.raises(LumitreeError, match=f"are {shown[0]}, its vertical angles {shown[1]}"):
            convert(*angles, light)


def test_small_negative_intensities_are_noise():
    values, least = without_noise(np.array([[1000.0, -0.05, 3]]))
    assert (values.tolist(), least) == ([[1000, 0, 3]], -0.05)
    with pytest.raises(LumitreeError, match="negative intensity, -2 cd"):
        without_noise(np.array([[1000.0, -2.0]]))
