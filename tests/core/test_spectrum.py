"""Spectra in steps of 1 nm, and what follows of them."""

import numpy as np
import pytest

from lumitree.core.photometry import (
    LUMENS_PER_WATT,
    WAVELENGTHS,
    blackbody_radiance,
    blackbody_spectrum,
    chromaticity_difference,
    luminance,
    sampled_spectrum,
    srgb_from_xyz,
    xyz_of_spectrum,
    xyz_temperature,
)
from lumitree.errors import LumitreeError


def test_a_spectrum_at_its_own_wavelengths_is_kept():
    values = np.random.default_rng(0).random(len(WAVELENGTHS))
    assert sampled_spectrum(WAVELENGTHS, values).tolist() == values.tolist()


def test_it_is_linear_between_wavelengths_and_zero_beyond():
    found = sampled_spectrum([400, 410, 430], [1.0, 3.0, 0.0])
    assert found[WAVELENGTHS == 405] == pytest.approx(2)
    assert found[WAVELENGTHS == 420] == pytest.approx(1.5)
    assert not found[(WAVELENGTHS < 400) | (WAVELENGTHS > 430)].any()


@pytest.mark.parametrize("at", [400.0, 437.25, 829.5])
def test_a_line_keeps_its_power_and_its_place(at):
    found = sampled_spectrum([at], [3.0])
    assert found.sum() == pytest.approx(3)
    assert found @ WAVELENGTHS / found.sum() == pytest.approx(at)
    assert np.count_nonzero(found) <= 2


@pytest.mark.parametrize("step", [0.05, 0.1, 0.37])
def test_lines_narrower_than_the_grid_keep_their_power(step):
    """Samples at whole numbers alone would miss them, or count them twenty times."""
    fine = np.arange(380, 781, step)
    at = fine[np.abs(fine - 546.07).argmin()]
    values = np.where(fine == at, 100.0, 1.0)
    found = sampled_spectrum(fine, values)
    assert found.sum() == pytest.approx(np.trapezoid(values, fine), rel=1e-12)
    assert found.argmax() == round(at) - 360


def test_what_is_invisible_is_left_out():
    assert not sampled_spectrum([200, 300], [1, 1]).any()
    assert not sampled_spectrum([1000], [1]).any()


@pytest.mark.parametrize(
    ("wavelengths", "values"),
    [
        ([], []),
        ([400, 500], [1]),
        ([500, 400], [1, 1]),
        ([400, 500], [1, -1]),
        ([400, 500], [1, np.nan]),
        ([[400, 500]], [1, 1]),
    ],
)
def test_what_is_no_spectrum_is_refused(wavelengths, values):
    with pytest.raises(LumitreeError, match="spectrum"):
        sampled_spectrum(wavelengths, values)


def test_the_luminance_of_an_equal_energy_spectrum(mi):
    """The integral of V(λ) is 106.857 nm (CIE 1931, 1 nm)."""
    xyz = xyz_of_spectrum(np.ones(len(WAVELENGTHS)))
    assert xyz == pytest.approx(106.86, rel=1e-3)


@pytest.mark.parametrize("temperature", [2000.0, 2856, 6500])
def test_a_black_body_has_its_temperature_and_its_radiance(mi, temperature):
    xyz = xyz_of_spectrum(blackbody_spectrum(temperature))
    assert xyz_temperature(xyz) == pytest.approx((temperature, 0), rel=1e-4, abs=1e-5)
    rgb = np.array(blackbody_radiance(temperature))
    # Planck's constant factor, 2hc² in nm and W/(m² sr).
    assert luminance(rgb) == pytest.approx(LUMENS_PER_WATT * 1.191043e20 * xyz[1], rel=1e-3)
    assert rgb / rgb[0] == pytest.approx(srgb_from_xyz(xyz) / srgb_from_xyz(xyz)[0], abs=1e-3)


def test_distances_in_the_diagram_of_1976(mi):
    """u' = 4x / (-2x + 12y + 3), v' = 9y / (-2x + 12y + 3)."""
    first, second = np.array([0.3, 0.4, 0.3]), np.array([2.0, 1.0, 1.0])

    def uv(xyz):
        x, y, _ = xyz / xyz.sum()
        return np.array([4 * x, 9 * y]) / (-2 * x + 12 * y + 3)

    expected = np.linalg.norm(uv(first) - uv(second))
    assert chromaticity_difference(first, second) == pytest.approx(expected)
    assert chromaticity_difference(first, 5 * first) == pytest.approx(0, abs=1e-12)
    assert np.isnan(chromaticity_difference(first, np.zeros(3)))
