"""Directional albedo of single scattering by GGX microfacets, by numerical integration.

The distribution and the separable masking-shadowing function follow appendix B of the glTF
2.0 specification. With E(μ) the albedo for the cosine μ of the angle to the normal, 1 - E(μ) is the
light that is scattered more than once. Kulla and Conty (2017) give it back by a lobe in proportion
to (1 - E(μ_i)) (1 - E(μ_o)), which is reciprocal.

Tables have the roughness, the root of alpha, along the first axis and the root of the cosine along
the second, both from 0 to 1: the albedo changes fast at grazing angles.
"""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Entries along each axis of a table, and sampled normals for each entry.
SIZE, _SAMPLES = 48, 1024
# Least alpha of a surface; no normal is sampled in the plane of the surface.
MIN_ALPHA, _MIN_COSINE = 1e-3, 1e-4


@dataclasses.dataclass(frozen=True)
class GlassAlbedo:
    """The surface of a dielectric, seen from both sides.

    Attributes:
        table: [2, SIZE, SIZE, 2] reflected part and sum of both parts; from outside, from inside.
        reflectance: of light from all directions outside, by Fresnel's equations.
    """

    table: Floats
    reflectance: float


@functools.cache
def reflection_albedo() -> Floats:
    """[SIZE, SIZE, 2] albedo of microfacets that reflect 1 - s and s, with s = (1 - cos)⁵.

    cos is between a direction and the normal of a microfacet. By Schlick's approximation
    microfacets reflect f0 at normal incidence with an albedo of f0 times the first plus the second.
    """

    def reflected(alpha: float, cosine: float) -> tuple[float, float]:
        normal, facing = _visible_normals(alpha, cosine)
        weight = _unshadowed(alpha, 2 * facing * normal - cosine)
        tinted = weight * (1 - facing) ** 5
        return float((weight - tinted).mean()), float(tinted.mean())

    return _tabulated(reflected)


@functools.lru_cache(maxsize=64)
def glass_albedo(ior: float) -> GlassAlbedo:
    """The albedo of a dielectric's surface; `ior` is inside over outside, above 1."""

    def side(eta: float, alpha: float, cosine: float) -> tuple[float, float]:
        normal, facing = _visible_normals(alpha, cosine)
        part, refracted = _fresnel(facing, eta)
        mirrored = part * _unshadowed(alpha, 2 * facing * normal - cosine)
        through = (refracted - facing / eta) * normal + cosine / eta
        crossed = (1 - part) * _unshadowed(alpha, through)
        return float(mirrored.mean()), float((mirrored + crossed).mean())

    sides = [_tabulated(functools.partial(side, eta)) for eta in (ior, 1 / ior)]
    cosines = (np.arange(4096) + 0.5) / 4096
    reflectance = 2 * (cosines * _fresnel(cosines, ior)[0]).mean()
    return GlassAlbedo(np.stack(sides), float(reflectance))


def hemisphere_mean(table: Floats) -> Floats:
    """Mean [..., C] of a table over the cosine-weighted hemisphere, linear between its entries.

    The table is [..., SIZE, C], with the root of the cosine along the last axis but one.
    """
    # The density of the root x is 4 x³; three points of Gauss and Legendre are exact.
    points, weights = np.polynomial.legendre.leggauss(3)
    place = (np.arange(SIZE - 1)[:, None] + (points + 1) / 2).ravel()
    density = 4 * (place / (SIZE - 1)) ** 3 * np.tile(weights / 2, SIZE - 1) / (SIZE - 1)
    weight = np.maximum(1 - np.abs(np.arange(SIZE)[:, None] - place), 0) @ density
    return np.einsum("...kc,k->...c", table, weight)


def _tabulated(values: Callable[[float, float], tuple[float, float]]) -> Floats:
    """[SIZE, SIZE, 2] values for an alpha and a cosine."""
    roughness, cosines = np.linspace(0, 1, SIZE), np.linspace(0, 1, SIZE) ** 2
    return np.array(
        [
            [values(max(rough**2, MIN_ALPHA), max(cosine, _MIN_COSINE)) for cosine in cosines]
            for rough in roughness
        ]
    )


@functools.cache
def _unit_disk() -> tuple[Floats, Floats]:
    """Radius and azimuth of points that fill the unit disk evenly, on a Fibonacci spiral."""
    index = np.arange(_SAMPLES, dtype=np.float64)
    return np.sqrt((index + 0.5) / _SAMPLES), 2 * np.pi * (index * 0.6180339887498949 % 1)


def _visible_normals(alpha: float, cosine: float) -> tuple[Floats, Floats]:
    """Cosines of normals with the surface's normal, and with the direction that sees them.

    Heitz (2018), "Sampling the GGX Distribution of Visible Normals"; the direction is in the plane
    of x and z.
    """
    sine = np.sqrt(1 - cosine**2)
    x, z = np.array([alpha * sine, cosine]) / np.hypot(alpha * sine, cosine)
    radius, azimuth = _unit_disk()
    first, second = radius * np.cos(azimuth), radius * np.sin(azimuth)
    mixed = 0.5 * (1 + z)
    second = (1 - mixed) * np.sqrt(1 - first**2) + mixed * second
    third = np.sqrt(np.maximum(1 - first**2 - second**2, 0))
    # The frame of the stretched direction: y, and the direction's normal in the plane of x and z.
    stretched = alpha * (third * x - second * z), alpha * first, third * z + second * x
    length = np.sqrt(sum(each**2 for each in stretched))
    normal = np.maximum(stretched[2], 0) / length
    return normal, np.clip(sine * stretched[0] / length + cosine * normal, 0, 1)


def _unshadowed(alpha: float, cosine: Floats) -> Floats:
    """Smith's part of the microfacets that are not hidden, 0 below the surface."""
    above = np.maximum(cosine, 0)
    return 2 * above / (above + np.sqrt(alpha**2 + (1 - alpha**2) * above**2))


def _fresnel(cosine: Floats, eta: float) -> tuple[Floats, Floats]:
    """Reflected part, and cosine of the refracted direction, 0 where all is reflected.

    `eta` is the index of refraction behind the surface over the one before it.
    """
    behind = np.sqrt(np.maximum(1 - (1 - cosine**2) / eta**2, 0))
    parallel = (eta * cosine - behind) / np.maximum(eta * cosine + behind, 1e-12)
    across = (cosine - eta * behind) / np.maximum(cosine + eta * behind, 1e-12)
    return (parallel**2 + across**2) / 2, behind
