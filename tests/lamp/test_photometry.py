"""Colours of temperatures against published chromaticities, and flux there and back."""

import numpy as np
import pytest

from lumitree.core.photometry import (
    blackbody_colour,
    colour_temperature,
    flux_from_radiance,
    luminance,
    radiance_from_flux,
    srgb_from_xyz,
    xyz_from_srgb,
)

XYZ_FROM_SRGB = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


@pytest.mark.parametrize(
    ("temperature", "x", "y"),
    # CIE illuminant A, and points of the Planckian locus (Wyszecki and Stiles).
    [(2856, 0.4476, 0.4074), (2000, 0.5267, 0.4133), (4000, 0.3805, 0.3768)],
)
def test_blackbody_chromaticity(mi, temperature, x, y):
    xyz = XYZ_FROM_SRGB @ blackbody_colour(temperature)
    assert xyz[:2] / xyz.sum() == pytest.approx([x, y], abs=1e-3)


def test_blackbody_luminance_and_order(mi):
    colours = np.array([blackbody_colour(kelvin) for kelvin in (1000, 2700, 6500, 20000)])
    assert (colours >= 0).all()
    for colour in colours:
        assert luminance(colour) == pytest.approx(683)
    blue_over_red = colours[:, 2] / colours[:, 0]
    assert (np.diff(blue_over_red) > 0).all()


def test_flux_of_a_known_surface():
    # 1 m² of 1 cd/m² sends out pi lm, and 683 cd/m² is a radiance of 1.
    assert flux_from_radiance((1, 1, 1), 1.0) == pytest.approx(683 * np.pi)
    assert flux_from_radiance((0, 1, 0), 2.0) == pytest.approx(683 * np.pi * 2 * 0.7152)


def test_flux_and_back():
    radiance = radiance_from_flux(800.0, 0.03, (2.0, 0.8, 0.1))
    assert flux_from_radiance(radiance, 0.03) == pytest.approx(800)
    assert radiance[0] / radiance[2] == pytest.approx(20)


def test_xyz_there_and_back():
    colours = np.random.default_rng(0).random((5, 3))
    assert xyz_from_srgb(colours) == pytest.approx(colours @ XYZ_FROM_SRGB.T, abs=1e-5)
    assert srgb_from_xyz(xyz_from_srgb(colours)) == pytest.approx(colours)
    # White has the luminance 1.
    assert xyz_from_srgb([1, 1, 1])[1] == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize(
    ("x", "y", "temperature", "duv"),
    # Illuminants A, D50, D65, F2 and F11, a warm LED, a pinkish white, and points of the locus; as
    # computed by colour-science 0.4.7 with the method of Ohno (2013).
    [
        (0.44758, 0.40745, 2855.49, 2.8e-6),
        (0.34567, 0.35851, 5001.83, 0.0032097),
        (0.31272, 0.32903, 6503.01, 0.0032122),
        (0.37208, 0.37529, 4225.26, 0.0018639),
        (0.38052, 0.37713, 4000.67, 0.0001556),
        (0.43, 0.41, 3167.89, 0.0034064),
        (0.33, 0.31, 5624.30, -0.0157578),
        (0.5267, 0.4133, 1999.81, 1.2e-6),
        (0.2637, 0.2673, 14997.61, 1.5e-5),
    ],
)
def test_colour_temperature_and_duv(mi, x, y, temperature, duv):
    rgb = srgb_from_xyz([x / y, 1, (1 - x - y) / y])
    found = colour_temperature(7 * rgb)
    assert found[0] == pytest.approx(temperature, rel=5e-4)
    assert found[1] == pytest.approx(duv, abs=5e-6)


@pytest.mark.parametrize("temperature", [1500, 2700, 4000, 6500, 15000])
def test_colour_temperature_of_a_black_body(mi, temperature):
    rgb = blackbody_colour(temperature)
    if min(rgb) > 0:
        found = colour_temperature(rgb)
        assert found[0] == pytest.approx(temperature, rel=1e-3)
        assert found[1] == pytest.approx(0, abs=1e-5)


def test_colours_without_a_temperature(mi):
    for rgb in ([0, 1, 0], [1, 0, 1], [0, 0, 1]):
        temperature, duv = colour_temperature(rgb)
        assert np.isnan(temperature)
        assert abs(duv) > 0.05
    assert np.isnan(colour_temperature([0, 0, 0])).all()
