"""The tables of `microfacet_albedo` on the device."""

from __future__ import annotations

import functools

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.device import on_device
from lumitree.lamp.microfacet_albedo import (
    SIZE,
    glass_albedo,
    hemisphere_mean,
    reflection_albedo,
)


class _Table:
    """A table [H, W, 2] over the unit square, linear between its entries."""

    def __init__(self, table: np.ndarray) -> None:
        values = mi.TensorXf(on_device(mi.Float, table), table.shape)
        self._texture = mi.Texture2f(values, use_accel=False)
        self._size = table.shape[1], table.shape[0]

    def __call__(self, first: mi.Float | float, second: mi.Float) -> tuple[mi.Float, mi.Float]:
        places = zip((first, second), self._size, strict=True)
        place = mi.Point2f(*((x * (size - 1) + 0.5) / size for x, size in places))
        values = self._texture.eval(place)
        return values[0], values[1]


class ReflectionLookup:
    """`reflection_albedo`: the two parts of the albedo."""

    def __init__(self) -> None:
        table = reflection_albedo()
        mean = hemisphere_mean(table)
        self._albedo = _Table(table)
        self._mean = _Table(np.stack([mean, mean], axis=1))

    def albedo(self, cosine: mi.Float, roughness: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Both parts for light from one direction."""
        return self._albedo(dr.sqrt(cosine), roughness)

    def mean(self, roughness: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Both parts for light from all directions."""
        return self._mean(0.5, roughness)


class GlassLookup:
    """`glass_albedo`, of one index of refraction."""

    def __init__(self, ior: float) -> None:
        found = glass_albedo(ior)
        # The sides one above the other; a lookup stays within one of them.
        self._albedo = _Table(found.table.reshape(2 * SIZE, SIZE, 2))
        mean = hemisphere_mean(found.table)[..., 1].T
        self._mean = _Table(np.stack([mean, mean], axis=1))
        self._transmittance = 1 - found.reflectance

    def albedo(
        self, inside: mi.Bool, cosine: mi.Float, roughness: mi.Float
    ) -> tuple[mi.Float, mi.Float]:
        """Reflected part and sum of both parts, for light from one side."""
        step = (SIZE - 1) / (2 * SIZE - 1)
        return self._albedo(dr.sqrt(cosine), dr.select(inside, 1 - step, 0) + step * roughness)

    def rebounds(
        self, inside: mi.Bool, roughness: mi.Float, squared: mi.Float
    ) -> tuple[mi.Float, mi.Float, mi.Float, mi.Float]:
        """Photons that microfacets scatter more than once, by the side that they arrive from.

        Parts that stay on their side and that cross; and means of 1 - E on their side and on the
        other one. `inside` is the denser medium; `squared` the square of the index of refraction.
        """
        lost = [dr.maximum(1 - mean, 1e-6) for mean in self._mean(0.5, roughness)]
        here, there = dr.select(inside, lost[1], lost[0]), dr.select(inside, lost[0], lost[1])
        # Equal radiance on both sides stays equal: n² times as many arrive from the denser medium.
        crossing = self._transmittance * dr.minimum(here, there)
        crossing = dr.select(inside, crossing / squared, crossing)
        return 1 - crossing / here, crossing / here, here, there


@functools.cache
def reflection_lookup(variant: str) -> ReflectionLookup:
    """The lookup for a variant of Mitsuba, which is set."""
    return ReflectionLookup()


@functools.lru_cache(maxsize=64)
def glass_lookup(variant: str, ior: float) -> GlassLookup:
    """The lookup for a variant of Mitsuba, which is set, and an index of refraction."""
    return GlassLookup(ior)
