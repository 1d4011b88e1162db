"""The RGB light of an asset in variants of Mitsuba that render spectra.

Symbols
    rgb     light of the asset, linear sRGB
    S(λ)    spectrum of the luminaire's emitters, or D65 if it is not known
    B(λ)    three smooth functions, 0 to 1, that add up to 1 at each wavelength (`smooth_basis`)
    A       3 x 3 matrix, whose columns are the RGB of S · B_r, S · B_g and S · B_b

    L(λ) = S(λ) Σ_c (A⁻¹ rgb)_c B_c(λ)

So L has the colour rgb. It is linear in rgb, as light is: light may be added up before or after the
conversion. Where rgb is the colour of S, L is S. With D65 no L is negative. With another S, L is
negative at some wavelengths for colours that S could hardly have behind a filter; images still have
these colours. Where A has no inverse, for a lamp of one line, L is S with the luminance of rgb.
"""

from __future__ import annotations

import functools

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import EmittedSpectrum
from lumitree.core.device import on_device
from lumitree.core.photometry import (
    FILM_LUMINANCE,
    LUMA,
    WAVELENGTHS,
    sampled_spectrum,
    srgb_from_xyz,
    xyz_of_spectrum,
)

# Condition number of A above which S has not enough colours.
_MAX_CONDITION = 1e3
# nm between the nodes of the basis, and the weight of its constraints beside its slope.
_BASIS_STEP, _CONSTRAINT = 10.0, 1e3


class LightSpectra:
    """Light of an asset as spectra, by a table [471, 3] of `light_table`."""

    def __init__(self, table: NDArray[np.float64]) -> None:
        self._table = on_device(mi.Float, table)

    def __call__(self, rgb: mi.Color3f, wavelengths: mi.Spectrum) -> mi.Spectrum:
        """Light at wavelengths in nm."""
        value = mi.Spectrum(0)
        for index in range(len(value)):
            place = wavelengths[index] - WAVELENGTHS[0]
            lower = dr.clip(mi.UInt32(place), 0, len(WAVELENGTHS) - 2)
            left, right = (dr.gather(mi.Color3f, self._table, lower + each) for each in (0, 1))
            value[index] = dr.dot(rgb, dr.lerp(left, right, place - lower))
        return value


def light_table(found: EmittedSpectrum | None) -> NDArray[np.float64]:
    """Spectra [471, 3] of R = 1, of G = 1 and of B = 1."""
    if found is not None and found.is_whole:
        spectrum = found.power.astype(np.float64)
    else:
        spectrum = d65()
    products = spectrum[:, None] * smooth_basis()
    colours = srgb_from_xyz(xyz_of_spectrum(products.T)).T / FILM_LUMINANCE
    if np.linalg.cond(colours) > _MAX_CONDITION:
        return spectrum[:, None] * (np.array(LUMA) * FILM_LUMINANCE / xyz_of_spectrum(spectrum)[1])
    return products @ np.linalg.inv(colours)


def d65() -> NDArray[np.float64]:
    """D65 at `WAVELENGTHS`, as Mitsuba has it."""
    parameters = mi.traverse(mi.load_dict({"type": "d65"}))
    values = np.array(parameters["values"], np.float64)
    first, last = np.ravel(parameters["range"]).tolist()
    return sampled_spectrum(np.linspace(first, last, len(values)), values)


@functools.cache
def smooth_basis() -> NDArray[np.float64]:
    """The functions B [471, 3], which turn D65 into the primaries of sRGB.

    They have the least slope of all such functions (Mallett and Yuksel 2019, Spectral Primary
    Decomposition for Rendering with sRGB Reflectance).
    """
    # Not at the top: RGB variants do without it.
    from scipy.optimize import lsq_linear

    nodes = np.arange(WAVELENGTHS[0], WAVELENGTHS[-1] + 1, _BASIS_STEP)
    count, white = len(nodes), d65()
    # Rows that interpolate between the nodes.
    hat = np.array([np.interp(WAVELENGTHS, nodes, each) for each in np.eye(count)])
    colours = srgb_from_xyz(xyz_of_spectrum(hat * white)).T / xyz_of_spectrum(white)[1]
    slope, each, sums = np.diff(np.eye(count), axis=0), np.eye(3), np.tile(np.eye(count), 3)
    rows = [np.kron(each, slope), _CONSTRAINT * sums, _CONSTRAINT * np.kron(each, colours)]
    values = [np.zeros(3 * (count - 1)), np.full(count, _CONSTRAINT), _CONSTRAINT * each.ravel()]
    found = lsq_linear(np.vstack(rows), np.concatenate(values), (0, 1), tol=1e-12)
    basis = found.x.reshape(3, count) @ hat
    return (basis / basis.sum(axis=0)).T
