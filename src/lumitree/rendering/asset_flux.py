"""Rays and flux that an asset emits, and the factors that give a lamp a flux and a colour."""

import dataclasses

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.light_field import LightField, unpack
from lumitree.core.device import as_rows, shared
from lumitree.core.octahedral import middle_directions, solid_angles
from lumitree.core.photometry import LUMENS_PER_WATT, blackbody_colour, luminance
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError, shown
from lumitree.rendering.device import DeviceAsset
from lumitree.trace.light_paths import RayBatch, seeded_sampler

# Rays that estimate the flux of a field, to about 0.1 to 0.5 %, in some tenths of a second.
FIELD_RAYS = 1 << 20


class AssetRays:
    """Rays of an asset, of its light field if it has one; `EmittedRays`."""

    def __init__(self, asset: Asset) -> None:
        self._device = DeviceAsset(asset)

    def draw(self, count: int, seed: int) -> RayBatch:
        """As `EmittedRays.draw`; each sample is a ray."""
        sampler = seeded_sampler(seed, count)
        samples = sampler.next_1d(), sampler.next_2d(), sampler.next_2d()
        origin, direction, flux = self._device.sample_ray(*samples)
        flux /= count
        dr.eval(origin, direction, flux)
        return RayBatch(origin, direction, flux)


def light_field_watts(field: LightField) -> NDArray[np.float64]:
    """Flux [3] of a light field: R, G and B, local units, without `Asset.light_factors`."""
    colours = unpack(field.intensity)
    # Exact sums over the bins that emit, channel by channel, which bounds memory.
    by_bin = [field.dense(colours[:, channel]).sum(axis=0) for channel in range(3)]
    return field.scale * (np.array(by_bin) @ solid_angles(field.resolution))


def intensity_by_bin(asset: Asset) -> NDArray[np.float64]:
    """Luminous intensity [R²] of an asset's light field by bin of direction, local units.

    It is the sum over all cells, with `Asset.light_factors`. Between the middles of bins it is
    linear (`core.octahedral.interpolated`).
    """
    field = asset.light_field
    assert field is not None
    colours = luminance(unpack(field.intensity) * asset.light_factors)
    return field.scale * field.dense(colours).sum(axis=0)


def axis_intensities(asset: Asset, axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Luminous intensity [6] of an asset towards three axes and against them, local units.

    Each is the mean over the half of all directions on its side, weighted by the square of the
    cosine. For an asset without a light field it is the same everywhere.

    Args:
        axes: [3, 3], orthonormal, one a row, local frame.
    """
    if asset.light_field is None:
        watts = shared(asset, "watts", lambda: asset_watts(asset) / asset.frame.scale**2)
        return np.full(6, luminance(watts) / (4 * np.pi))
    intensity = shared(asset, "intensity", lambda: intensity_by_bin(asset))
    resolution = asset.light_field.resolution
    cosine = middle_directions(resolution) @ axes.T
    squares = np.square(np.maximum(np.hstack([cosine, -cosine]), 0))
    squares *= solid_angles(resolution)[:, None]
    return intensity @ squares / squares.sum(axis=0)


def asset_watts(asset: Asset) -> NDArray[np.float64]:
    """Flux [3] that an asset emits, W: R, G and B, if lengths of its file are in metres.

    `Asset.light_factors` are included. The flux of the light field, which illuminates scenes, is
    exact. Without a light field it is estimated from 2²⁰ rays of the field, always with the same
    random numbers.
    """
    if asset.light_field is not None:
        return light_field_watts(asset.light_field) * asset.light_factors * asset.frame.scale**2
    rays = AssetRays(asset).draw(FIELD_RAYS, SeedStream(Purpose.ASSET_FLUX).seed(0))
    return as_rows(rays.flux).sum(axis=0) * asset.frame.scale**2


def asset_lumens(asset: Asset) -> float:
    """Luminous flux that an asset emits, lm; as `asset_watts`."""
    return float(luminance(asset_watts(asset)))


def with_light(asset: Asset, lumens: float | None, temperature: float | None) -> Asset:
    """The asset with the factors that give it a luminous flux and a colour temperature.

    Args:
        lumens: luminous flux, lm, if lengths of its file are in metres; None to keep it.
        temperature: colour temperature of the whole flux, K; None to keep the colour.

    Raises:
        LumitreeError: as for `factors_to`, or a factor is out of range.
    """
    if lumens is None and temperature is None:
        return asset
    factors = factors_to(asset_watts(asset), lumens, temperature, asset.luminaire)
    red, green, blue = (factors * asset.light_factors).tolist()
    return dataclasses.replace(asset, light_factors=(red, green, blue))


def factors_to(
    watts: NDArray[np.float64], lumens: float | None, temperature: float | None, name: str
) -> NDArray[np.float64]:
    """Factors [3] on R, G and B that give a lamp a luminous flux and a colour temperature.

    The factor for a temperature is c(T) / c: c(T) is the colour of a black body in linear sRGB, and
    c = watts / L the colour of the lamp's whole flux, both with luminance 1. So the luminous flux
    stays, and the whole flux has the chromaticity of the black body. It is a factor per channel;
    no chromatic adaptation is involved.

    Args:
        watts: [3] flux of the lamp, W.
        lumens: luminous flux, lm; None to keep it.
        temperature: colour temperature, K; None to keep the colour.

    Raises:
        LumitreeError: the lamp emits no light, or none in a channel that the temperature needs.
    """
    total = float(luminance(watts))
    if not total > 0:
        raise LumitreeError(f"{shown(name, 200)} emits no light, which no factor can change")
    factors = np.ones(3)
    if temperature is not None:
        wanted = np.array(blackbody_colour(temperature)) * total / LUMENS_PER_WATT
        for channel, have, want in zip(("red", "green", "blue"), watts, wanted, strict=True):
            if want > 0 and not have > 0:
                raise LumitreeError(
                    f"{shown(name, 200)} emits no {channel} light, which {temperature:g} K has; "
                    "leave out the temperature"
                )
        factors = np.divide(wanted, watts, out=np.zeros(3), where=watts > 0)
    return factors if lumens is None else factors * (lumens / total)
