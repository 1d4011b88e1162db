"""The spectrum of the rays of a TM-25 file."""

import numpy as np
import pytest

from lumitree.core.photometry import WAVELENGTHS, matching_functions, sampled_spectrum
from lumitree.formats.tm25 import rays_spectrum

BLUE, RED = np.array([[440.0, 0], [450, 2], [460, 0]]), np.array([[600.0, 1], [700, 1]])


def column(*values):
    return np.array(values, np.float64)[:, None]


def lines(*pairs):
    return sum(power * sampled_spectrum([at], [1]) for at, power in pairs)


def test_one_wavelength(mi):
    found = rays_spectrum({"radiant": column(1, 2)}, [], 1, 555.25)
    assert found == pytest.approx(lines((555.25, 1)))


@pytest.mark.parametrize("kind", ["radiant", "luminous"])
def test_a_wavelength_of_each_ray(mi, kind):
    """Luminous flux is radiant flux times V(λ)."""
    items = {kind: column(1, 2, 4, 8), "wavelength": column(400, 555.25, 700, 900)}
    efficacy = np.interp([400, 555.25, 700], WAVELENGTHS, matching_functions()[1])
    power = np.array([1, 2, 4]) / (efficacy if kind == "luminous" else 1)
    found = rays_spectrum(items, [], 2, np.nan)
    assert found == pytest.approx(lines(*zip([400, 555.25, 700], power, strict=True)))


def test_one_table(mi):
    found = rays_spectrum({"luminous": column(1, 2)}, [RED, BLUE], 3, np.nan)
    assert found.tolist() == sampled_spectrum(*RED.T).tolist()


def test_a_table_of_each_ray(mi):
    """By their power: tables are weights, which may have any sum."""
    items = {"radiant": column(1, 2, 4), "table": column(1, 2, 1)}
    found = rays_spectrum(items, [BLUE, [1, 7] * RED], 4, np.nan)
    blue, red = (sampled_spectrum(*each.T, means=True) for each in (BLUE, RED))
    expected = 5 * blue / 20 + 2 * red / 100
    assert found == pytest.approx(expected)


def test_luminous_flux_of_each_table(mi):
    items = {"luminous": column(1, 2, 4), "table": column(1, 2, 1)}
    found = rays_spectrum(items, [BLUE, RED], 4, np.nan)
    visible = matching_functions()[1]
    blue, red = (sampled_spectrum(*each.T, means=True) for each in (BLUE, RED))
    assert found == pytest.approx(5 * blue / (blue @ visible) + 2 * red / (red @ visible))


@pytest.mark.parametrize(
    ("items", "tables", "kind"),
    [
        ({}, [], 0),
        ({}, [], 1),
        ({}, [], 2),
        ({}, [], 3),
        ({}, [BLUE], 4),
        ({}, [BLUE[::-1]], 3),
        ({"table": column(2)}, [BLUE], 4),
        ({"table": column(np.nan)}, [BLUE], 4),
    ],
)
def test_files_without_a_usable_spectrum_have_none(mi, items, tables, kind):
    """Their colours may be known from tristimulus values."""
    assert rays_spectrum({"luminous": column(1), **items}, tables, kind, np.nan) is None
