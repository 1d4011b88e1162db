"""Colours of temperatures against published chromaticities, and flux there and back."""

import numpy as np
import pytest

from lumitree.model.photometry import (
    blackbody_colour,
    flux_from_radiance,
    luminance,
    radiance_from_flux,
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
