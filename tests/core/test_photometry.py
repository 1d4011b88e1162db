"""Colours of temperatures against published chromaticities, and flux there and back."""

import numpy as np
import pytest

from lumitree.core.photometry import (
    colour_temperature,
    flux_from_radiance,
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


def test_flux_of_a_known_surface():
    # 1 m² of 1 cd/m² sends out pi lm, and 683 cd/m² is a radiance of 1.
    assert flux_from_radiance((1, 1, 1), 1.0) == pytest.approx(683 * np.pi)
    assert flux_from_radiance((0, 1, 0), 2.0) == pytest.approx(683 * np.pi * 2 * 0.7152)


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


def test_colours_without_a_temperature(mi):
    for rgb in ([0, 1, 0], [1, 0, 1], [0, 0, 1]):
        temperature, duv = colour_temperature(rgb)
        assert np.isnan(temperature)
        assert abs(duv) > 0.05
    assert np.isnan(colour_temperature([0, 0, 0])).all()
