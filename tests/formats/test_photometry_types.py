"""One light sampled in Types A, B and C, against its intensity in world directions.

The frame is the frame of `formats.type_c`: see `support.photometric_types`.
"""

import numpy as np
import pytest

from lumitree.formats.ies import read_ies
from lumitree.formats.type_c import IntensityDistribution
from support.photometric_types import ies, world

# Lobes of different widths about axes in front (x > 0) and below, in no plane of symmetry.
LOBES = (((0.62, -0.55, 0.35), 40.0, 1000.0), ((0.7, -0.6, -0.3), 60.0, 600.0))
STEP = 1.0


def analytic(direction):
    """Intensity [...], cd, in directions [..., 3] of any length."""
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    total = np.zeros(direction.shape[:-1])
    for axis, sharpness, peak in LOBES:
        cosine = direction @ np.array(axis) / np.linalg.norm(axis)
        total += peak * np.exp(sharpness * (cosine - 1))
    return total


ANGLES = np.arange(-90, 90 + STEP, STEP)
SAMPLES = {
    "A": (ANGLES, ANGLES),
    "B": (ANGLES, ANGLES),
    "C": (np.arange(0, 360 + STEP, STEP), np.arange(0, 180 + STEP, STEP)),
}


def read(tmp_path, kind, horizontal, vertical, intensity):
    path = tmp_path / "lamp.ies"
    path.write_text(ies(kind, horizontal, vertical, intensity))
    return read_ies(path)


@pytest.fixture(scope="module")
def directions():
    random = np.random.default_rng(0).normal(size=(50_000, 3))
    return random / np.linalg.norm(random, axis=1, keepdims=True)


@pytest.mark.parametrize("kind", SAMPLES)
def test_all_types_are_the_same_light(tmp_path, kind, directions):
    horizontal, vertical = SAMPLES[kind]
    intensity = analytic(world(kind, horizontal, vertical))
    lamp = read(tmp_path, kind, horizontal, vertical, intensity)
    exact = analytic(directions)
    # Linear interpolation over 1 degree: k h² / 8 in each direction, of lobes of sharpness k.
    limit = 2 * 60 * np.deg2rad(STEP) ** 2 / 8 * exact.max()
    assert np.abs(lamp.at(directions) - exact).max() < limit
    # No mirror image of it is as near.
    for mirrored in ([-1, 1, 1], [1, -1, 1], [1, 1, -1]):
        assert np.abs(lamp.at(directions * mirrored) - exact).max() > 20 * limit
    exact_lumens = sum(
        peak * 2 * np.pi * (1 - np.exp(-2 * sharpness)) / sharpness for _, sharpness, peak in LOBES
    )
    # The part of the second lobe that is behind or above is not in the angles of Types A and B.
    assert lamp.lumens == pytest.approx(exact_lumens, rel=3e-3)
    # Length along C = 0, width along C = 90, of all types.
    assert lamp.opening.sides == (0.2, 0, 0.4)
    assert lamp.details["photometry"] == f"Type {kind}, absolute"


@pytest.mark.parametrize("kind", "AB")
def test_half_of_the_horizontal_angles_stand_for_both(tmp_path, kind, directions):
    """A light that is symmetric about H = 0, which is the plane of C = 0, from half of it."""

    def symmetric(direction):
        return analytic(direction) + analytic(direction * [1, 1, -1])

    half = ANGLES[ANGLES >= 0]
    intensity = symmetric(world(kind, half, ANGLES))
    lamp = read(tmp_path, kind, half, ANGLES, intensity)
    exact = symmetric(directions)
    assert np.abs(lamp.at(directions) - exact).max() < 5e-3 * exact.max()


def test_type_b_in_the_angles_of_cie_121():
    """tan B = tan γ cos C and sin β = sin γ sin C, where V is B and H is -β."""
    horizontal, vertical = np.array([-50.0, -20, 10, 40]), np.array([-60.0, -30, 20, 70])
    x, y, z = np.moveaxis(world("B", horizontal, vertical), -1, 0)
    gamma, c = np.arccos(-y), np.arctan2(-z, x)
    b, beta = np.arctan(np.tan(gamma) * np.cos(c)), np.arcsin(np.sin(gamma) * np.sin(c))
    assert np.rad2deg(b) == pytest.approx(np.broadcast_to(vertical, b.shape))
    assert np.rad2deg(beta) == pytest.approx(np.broadcast_to(-horizontal[:, None], b.shape))


def test_intensities_of_type_b_are_those_of_its_own_angles(tmp_path):
    """A beam of 4 degrees, which a grid of 1 degree would change by some percent."""
    horizontal, vertical = (np.arange(-20, 20.5, 0.5),) * 2
    sharpness = np.log(2) / (1 - np.cos(np.deg2rad(2)))
    narrow = np.exp(sharpness * (-world("B", horizontal, vertical)[..., 1] - 1))
    lamp = read(tmp_path, "B", horizontal, vertical, 1000 * narrow)
    found = lamp.at(world("B", horizontal, vertical)) / 1000
    assert found == pytest.approx(narrow, abs=1e-6)
    grid = IntensityDistribution("", lamp.c, lamp.gamma, lamp.intensity)
    assert grid.lumens == pytest.approx(lamp.turned.distribution.lumens)
