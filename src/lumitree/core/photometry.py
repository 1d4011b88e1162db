"""Radiometry to photometry and back: luminance, luminous flux, colour temperature, spectra.

lumitree's convention: a radiance (R, G, B) in W/(m² sr), linear sRGB primaries, has the luminance
683 lm/W x (0.2126 R + 0.7152 G + 0.0722 B) cd/m². A Lambertian surface of area A emits a
luminous flux of π A times its luminance. Spectral power distributions are sampled at `WAVELENGTHS`.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.backend import load_mitsuba
from lumitree.core.device import on_device
from lumitree.errors import LumitreeError

# Maximum luminous efficacy, lm/W.
LUMENS_PER_WATT = 683.0
RGB = tuple[float, float, float]
# Luminance of the linear sRGB primaries (ITU-R BT.709).
LUMA: RGB = (0.2126, 0.7152, 0.0722)
MIN_TEMPERATURE, MAX_TEMPERATURE = 1000.0, 20000.0

_SRGB_FROM_XYZ = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)
# The other way; the rows are x, y and z, so the second is `LUMA` of IEC 61966-2-1, rounded.
_XYZ_FROM_SRGB = np.linalg.inv(_SRGB_FROM_XYZ)
# Wavelengths, nm, at which spectra are sampled and over which they are summed, 1 nm each.
WAVELENGTHS = np.arange(360.0, 831.0)
# 2hc² for wavelengths in nm and radiance per nm, W/(m² sr).
_PLANCK = 1.191043e20
# Temperatures of the Planckian locus, K: neighbours differ by 0.5 %.
_LOCUS_TEMPERATURES = np.geomspace(900.0, 1e5, 950)
# Luminance of a spectrum of 1 per nm, for which Mitsuba's images of spectra have a luminance of 1.
FILM_LUMINANCE = 106.7502593994140625
# Largest distance from the locus for which a correlated colour temperature is defined (CIE 15).
MAX_DUV = 0.05


def luminance(rgb: ArrayLike) -> NDArray[np.float64]:
    """Photometric [...] of a radiometric quantity [..., 3] in R, G and B: W becomes lm."""
    return LUMENS_PER_WATT * (np.asarray(rgb, np.float64) @ np.array(LUMA))


def flux_from_radiance(radiance: Sequence[float], area: float) -> float:
    """Luminous flux, lm, of a Lambertian surface of RGB radiance in W/(m² sr) and area in m²."""
    return math.pi * area * float(luminance(radiance))


def radiance_from_flux(lumens: float, area: float, colour: Sequence[float]) -> RGB:
    """Radiance, W/(m² sr), of a Lambertian surface of `area` m² that emits `lumens`.

    Args:
        colour: linear RGB; only its ratios matter.
    """
    factor = lumens / flux_from_radiance(colour, area)
    return (factor * colour[0], factor * colour[1], factor * colour[2])


def blackbody_colour(temperature: float) -> RGB:
    """Linear sRGB colour, of luminance 1, of a black body; clipped at 0 outside the gamut.

    Args:
        temperature: in kelvin, from 1000 to 20000.
    """
    rgb = np.maximum(_SRGB_FROM_XYZ @ blackbody_xyz(np.array([temperature]))[0], 0.0)
    rgb /= rgb @ LUMA
    return (float(rgb[0]), float(rgb[1]), float(rgb[2]))


def blackbody_radiance(temperature: float, shortest: float = 360.0, longest: float = 830.0) -> RGB:
    """Radiance, W/(m² sr), of a black body as linear sRGB, with its luminance.

    The spectral radiance is integrated against the CIE 1931 colour matching functions. Channels
    that are negative outside the gamut become 0; the others are then scaled to the luminance.

    Args:
        temperature: in kelvin, from 100 to 100000.
        shortest, longest: wavelengths between which it emits, nm.

    Raises:
        LumitreeError: the temperature is out of range.
    """
    xyz = _PLANCK * xyz_of_spectrum(blackbody_spectrum(temperature, shortest, longest))
    rgb = np.maximum(_SRGB_FROM_XYZ @ xyz, 0.0)
    rgb *= xyz[1] / max(rgb @ LUMA, np.finfo(float).tiny)
    return (float(rgb[0]), float(rgb[1]), float(rgb[2]))


def blackbody_spectrum(
    temperature: float, shortest: float = 360.0, longest: float = 830.0
) -> NDArray[np.float64]:
    """Spectral radiance of a black body at `WAVELENGTHS`, divided by `_PLANCK`.

    Args and errors as for `blackbody_radiance`.
    """
    if not 100 <= temperature <= 1e5:
        raise LumitreeError(f"a black body of {temperature:g} K; expected 100 to 100000 K")
    # Each wavelength stands for the nanometre around it, and the first and the last for all beyond.
    first = -np.inf if shortest <= WAVELENGTHS[0] else shortest
    last = np.inf if longest >= WAVELENGTHS[-1] else longest
    within = np.minimum(WAVELENGTHS + 0.5, last) - np.maximum(WAVELENGTHS - 0.5, first)
    return _planck(np.array([temperature]))[0] * within.clip(0, 1)


def xyz_of_spectrum(spectrum: ArrayLike) -> NDArray[np.float64]:
    """CIE 1931 XYZ [..., 3] of spectra [..., 471] at `WAVELENGTHS`, per nm; Y is Σ V(λ) S(λ)."""
    return np.asarray(spectrum, np.float64) @ matching_functions().T


def matching_functions() -> NDArray[np.float64]:
    """CIE 1931 colour matching functions [3, 471] at `WAVELENGTHS`."""
    mi = load_mitsuba()
    return np.array(mi.cie1931_xyz(on_device(mi.Float, WAVELENGTHS)), np.float64)


def xyz_from_srgb(rgb: ArrayLike) -> NDArray[np.float64]:
    """CIE 1931 XYZ [..., 3] of linear sRGB [..., 3]; white of luminance 1 has Y = 1."""
    return np.asarray(rgb, np.float64) @ _XYZ_FROM_SRGB.T


def srgb_from_xyz(xyz: ArrayLike) -> NDArray[np.float64]:
    """Linear sRGB [..., 3] of CIE 1931 XYZ [..., 3]; inverse of `xyz_from_srgb`."""
    return np.asarray(xyz, np.float64) @ _SRGB_FROM_XYZ.T


def colour_temperature(rgb: ArrayLike) -> tuple[float, float]:
    """Correlated colour temperature and Duv of a colour, [3] linear sRGB, as `xyz_temperature`."""
    return xyz_temperature(xyz_from_srgb(rgb))


def xyz_temperature(xyz: NDArray[np.float64]) -> tuple[float, float]:
    """Correlated colour temperature and Duv of a colour (CIE 15; ANSI C78.377).

    The nearest point of the Planckian locus in the CIE 1960 (u, v) diagram.

    Args:
        xyz: [3] CIE 1931 XYZ; only its ratios matter.

    Returns:
        Temperature, K: NaN if the colour is black, more than 0.05 from the locus, or its
        temperature is not within 1000 to 90000 K. And Duv, the distance from the locus, positive
        above it (greenish); NaN for black.
    """
    if not (xyz.sum() > 0):
        return math.nan, math.nan
    locus, point = _uv(blackbody_xyz(_LOCUS_TEMPERATURES)), _uv(xyz)
    # Nearest points of the straight lines between neighbours.
    edge = np.diff(locus, axis=0)
    along = ((point - locus[:-1]) * edge).sum(axis=1) / (edge**2).sum(axis=1)
    along = np.clip(along, 0, 1)
    distance = np.linalg.norm(locus[:-1] + along[:, None] * edge - point, axis=1)
    nearest = int(distance.argmin())
    first, second = 1 / _LOCUS_TEMPERATURES[nearest : nearest + 2]
    temperature = 1 / (first + along[nearest] * (second - first))
    # The locus goes from red to blue, so what is above it is on the right of its edges.
    offset = point - locus[nearest]
    above = edge[nearest, 0] * offset[1] - edge[nearest, 1] * offset[0] < 0
    duv = math.copysign(float(distance[nearest]), 1 if above else -1)
    known = abs(duv) <= MAX_DUV and 1000 <= temperature <= 9e4
    return (float(temperature) if known else math.nan), duv


def _uv(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIE 1960 chromaticity [..., 2] of XYZ [..., 3]."""
    x, y, z = np.moveaxis(xyz, -1, 0)
    return np.stack([4 * x, 6 * y], axis=-1) / (x + 15 * y + 3 * z)[..., None]


def chromaticity_difference(first: ArrayLike, second: ArrayLike) -> float:
    """Distance of two colours, [3] XYZ, in the CIE 1976 (u', v') diagram; NaN if one is black."""
    colours = np.array([first, second], np.float64)
    if not (colours.sum(axis=1) > 0).all():
        return math.nan
    # v' is 1.5 v of CIE 1960.
    return float(np.linalg.norm(np.diff(_uv(colours), axis=0) * [1, 1.5]))


def blackbody_xyz(temperature: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIE 1931 XYZ [N, 3], divided by `_PLANCK`, of black bodies [N], K."""
    return xyz_of_spectrum(_planck(temperature))


def _planck(temperature: NDArray[np.float64]) -> NDArray[np.float64]:
    """Planck's law, divided by `_PLANCK`, at `WAVELENGTHS`: [N, 471] for temperatures [N], K."""
    # 1.438777e7 nm K is hc/k.
    return WAVELENGTHS**-5 / np.expm1(1.438777e7 / (WAVELENGTHS * temperature[:, None]))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flux:
    """Estimate of the flux that leaves a luminaire, for lengths in metres.

    Attributes:
        watts: radiant flux of R, G and B, W, for radiance in W/(m² sr).
        watts_error: standard errors of `watts`, W.
        lumens: luminous flux, lm.
        lumens_error: standard error of `lumens`, lm.
        paths: number of paths of the estimate.
        hits: number of paths that carry light.
    """

    watts: tuple[float, ...]
    watts_error: tuple[float, ...]
    lumens: float
    lumens_error: float
    paths: int
    hits: int

    def __str__(self) -> str:
        return flux_text(self.lumens, self.lumens_error)


def flux_text(lumens: float, error: float) -> str:
    """Luminous flux ± standard error, rounded to two significant digits of the error."""
    digits = max(0, 1 - math.floor(math.log10(error))) if error else 0
    return f"{lumens:,.{digits}f} ± {error:,.{digits}f} lm"


@dataclasses.dataclass(frozen=True, kw_only=True)
class MissedFlux:
    """Share of the luminous flux that paths of limited length miss.

    Attributes:
        path_depth: largest number of bounces.
        reference_depth: largest number of bounces of the paths that are compared with, without
            Russian roulette.
        share: share of the flux, 0 to 1.
        error: standard error of `share`.
    """

    path_depth: int
    reference_depth: int
    share: float
    error: float


# nm between the wavelengths, and how many a finer spectrum may have.
_STEP = 1.0
_MAX_SAMPLES = 1 << 20


def sampled_spectrum(
    wavelengths: ArrayLike, values: ArrayLike, *, means: bool = False
) -> NDArray[np.float64]:
    """A spectrum at `WAVELENGTHS`.

    It is linear between the wavelengths that are given, and 0 beyond them. If some are less than
    1 nm apart, each value of the result is a mean over 1 nm, so that narrow lines keep their power.

    Args:
        wavelengths: [N] nm, increasing.
        values: [N] power per nm in any unit, at least 0. A single one is the power of a line, which
            is divided between the two wavelengths next to it.
        means: whether values are means in any case, so that their sum is the power.

    Returns:
        [471] power per nm; invisible light is omitted.

    Raises:
        LumitreeError: there are no values or more than 2²⁰; a number is NaN, infinite or negative;
            or the wavelengths do not increase.
    """
    wavelengths, values = np.asarray(wavelengths, np.float64), np.asarray(values, np.float64)
    if wavelengths.shape != values.shape or not 1 <= values.size <= _MAX_SAMPLES:
        raise LumitreeError(
            f"a spectrum has {wavelengths.size} wavelengths and {values.size} values; expected as "
            f"many of both, 1 to {_MAX_SAMPLES}"
        )
    numbers = np.isfinite(wavelengths).all() and np.isfinite(values).all()
    if not numbers or not (values >= 0).all() or not (np.diff(wavelengths) > 0).all():
        raise LumitreeError(
            "the wavelengths of a spectrum do not increase, or a value is negative, NaN or infinite"
        )
    if values.size == 1:
        return values * np.maximum(1 - np.abs(WAVELENGTHS - wavelengths) / _STEP, 0)
    if not means and np.diff(wavelengths).min() >= _STEP:
        return np.interp(WAVELENGTHS, wavelengths, values, left=0, right=0)
    # Means over 1 nm around each wavelength: differences of the exact integral.
    edges = np.append(WAVELENGTHS - _STEP / 2, WAVELENGTHS[-1] + _STEP / 2)
    # The integral is quadratic between the nodes; with the edges as nodes it is exact at them.
    nodes = np.union1d(wavelengths, edges[(edges > wavelengths[0]) & (edges < wavelengths[-1])])
    heights = np.interp(nodes, wavelengths, values)
    integral = np.append(0, np.cumsum(np.diff(nodes) * (heights[1:] + heights[:-1]) / 2))
    return np.diff(np.interp(edges, nodes, integral)) / _STEP
