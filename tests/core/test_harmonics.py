"""Laws of the spherical-harmonics basis."""

import numpy as np
import pytest
from scipy.special import sph_harm_y

from lumitree.core.harmonics import basis, basis_array, num_coefficients


def gauss_sphere(order):
    """Quadrature that is exact for polynomials up to `order` on the sphere."""
    z, weight = np.polynomial.legendre.leggauss(order // 2 + 1)
    azimuth = np.arange(order + 1) * 2 * np.pi / (order + 1)
    z, azimuth = np.meshgrid(z, azimuth, indexing="ij")
    r = np.sqrt(1 - z**2)
    directions = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], -1).reshape(-1, 3)
    return directions, np.repeat(weight, order + 1) * 2 * np.pi / (order + 1)


@pytest.mark.parametrize("l_max", range(5))
def test_orthonormal(l_max):
    directions, weights = gauss_sphere(2 * l_max + 2)
    y = basis_array(directions, l_max)
    gram = y.T @ (weights[:, None] * y)
    assert gram == pytest.approx(np.eye(num_coefficients(l_max)), abs=1e-12)


def test_agrees_with_scipy():
    directions = np.random.default_rng(0).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    polar = np.arccos(directions[:, 2])
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    y = basis_array(directions, 4)
    index = 0
    for band in range(5):
        for m in range(-band, band + 1):
            value = sph_harm_y(band, abs(m), polar, azimuth)
            # SciPy's has the Condon-Shortley phase (-1)^m.
            part = value.real if m >= 0 else value.imag
            expected = part * (1 if m == 0 else np.sqrt(2) * (-1) ** m)
            assert y[:, index] == pytest.approx(expected, abs=1e-12), (band, m)
            index += 1


def test_bands_are_limited():
    with pytest.raises(ValueError, match="expected 0 to 4"):
        basis(0.0, 0.0, 1.0, 5)
