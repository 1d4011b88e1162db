"""Glare ratings of a Lambertian luminaire against its own sum and the radiosity of its room."""

import sys

import numpy as np
import pytest

from lumitree.formats.opening import Opening
from lumitree.formats.type_c import Grid, IntensityDistribution
from lumitree.measure.photometric_figures import REFLECTANCES, ROOMS, ugr_table

# Height of the luminaires above the eye, m, and their distance; side of the luminaire, m.
HEIGHT, SPACING, SIDE = 2.0, 0.5, 0.3


def lambertian(lumens=1000.0, emitted=None):
    """A square that emits downwards with equal luminance."""
    grid = Grid(5)
    down = lumens / np.pi * np.maximum(np.cos(np.deg2rad(grid.gamma)), 0)
    intensity = np.tile(down, (len(grid.c), 1))
    return IntensityDistribution(
        "square", grid.c, grid.gamma, intensity, Opening((SIDE, 0.0, SIDE)), emitted
    )


def position_index(across, along):
    """Guth's formula for the index of luminaires at a height of HEIGHT."""
    eccentricity = np.rad2deg(np.arctan2(np.hypot(across, HEIGHT), along))
    turn = np.rad2deg(np.arctan2(np.abs(across), HEIGHT))
    first = 35.2 - 0.31889 * turn - 1.22 * np.exp(-2 * turn / 9)
    second = 21 + 0.26667 * turn - 0.002963 * turn**2
    return np.exp(1e-3 * first * eccentricity + 1e-5 * second * eccentricity**2)


def form_factor(x, y):
    """Between equal parallel rectangles of sides x and y in units of their distance."""
    u, v = np.sqrt(1 + x**2), np.sqrt(1 + y**2)
    logarithm = np.log(u * v / np.sqrt(1 + x**2 + y**2))
    arcs = x * v * np.arctan(x / v) + y * u * np.arctan(y / u)
    return 2 / (np.pi * x * y) * (logarithm + arcs - x * np.arctan(x) - y * np.arctan(y))


def background(room, reflectances, lumens):
    """Mean luminance of indirect light, cd/m²: illuminance of the walls by reflections, over pi."""
    x, y = room
    floor, walls = x * y * HEIGHT**2, 2 * HEIGHT**2 * (x + y)
    across = form_factor(x, y)
    back = (1 - across) * floor / walls
    factors = np.array(
        [[0, across, 1 - across], [across, 0, 1 - across], [back, back, 1 - 2 * back]]
    )
    ceiling, wall, ground = (float(each) / 100 for each in reflectances.split("/"))
    direct = lumens * np.array([0, across / floor, (1 - across) / walls])
    total = np.linalg.solve(np.eye(3) - factors * [ceiling, ground, wall], direct)
    return (total - direct)[2] / np.pi


def rating(room, reflectances, lumens=1000.0):
    """UGR by its definition, for an observer in the middle of a wall."""
    x, y = (side * HEIGHT for side in room)
    across, along = np.meshgrid(
        np.arange(-x / 2 + SPACING / 2, x / 2, SPACING), np.arange(SPACING / 2, y, SPACING)
    )
    distance = np.sqrt(across**2 + along**2 + HEIGHT**2)
    cosine = HEIGHT / distance
    # The limits of CIE 117; its table of the index ends at HEIGHT / along = 1.9.
    seen = (np.abs(across) / along <= 3) & (cosine >= np.cos(np.deg2rad(85)))
    seen &= HEIGHT / along <= 1.9
    luminance = lumens / np.pi / SIDE**2
    solid_angle = SIDE**2 * cosine / distance**2
    glare = luminance**2 * solid_angle / position_index(across, along) ** 2
    base = background(room, reflectances, lumens * across.size)
    return 8 * np.log10(0.25 / base * glare[seen].sum())


@pytest.mark.parametrize("emitted", [None, 1250.0])
def test_a_lambertian_luminaire_has_the_rating_of_the_definition(emitted):
    pytest.importorskip("eulumdat_ugr")
    table = ugr_table(lambertian(emitted=emitted))
    assert table.shape == (len(ROOMS), 2 * len(REFLECTANCES))
    # It has no direction.
    np.testing.assert_allclose(table[:, :5], table[:, 5:], atol=0.01)
    expected = [[rating(room, each) for each in REFLECTANCES] for room in ROOMS]
    # The numbers are tabulated in steps of 10 degrees, with a fit of the position index.
    np.testing.assert_allclose(table[:, :5], expected, atol=0.5)


def test_brightness_and_darkness():
    pytest.importorskip("eulumdat_ugr")
    plain = ugr_table(lambertian())
    # Ratings are 8 log₁₀ of L² / L_b.
    np.testing.assert_allclose(ugr_table(lambertian(10_000.0)), plain + 8, atol=0.01)
    dark = lambertian(0.0)
    assert np.isnan(ugr_table(dark)).all()


def test_without_the_package_there_is_no_table(monkeypatch):
    monkeypatch.setitem(sys.modules, "eulumdat_ugr", None)
    assert ugr_table(lambertian()) is None
