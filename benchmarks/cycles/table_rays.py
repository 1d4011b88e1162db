"""Rays of exported point lights, from their tables by direction, for `measure.irradiance`."""

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from lumitree.core.device import on_device
from lumitree.output.blender.lights import PointLights, direction_tables, table_angles


def light_rays(lights: PointLights) -> Callable[[Any, int], tuple[Any, Any, Any]]:
    """The argument `rays` of `rays_irradiance`.

    Intensities are interpolated linearly between the texels, as Cycles does it.
    """
    height = 2 * lights.resolution
    tables = direction_tables(lights, np.eye(3), height)
    angles = table_angles(height)
    weight = (tables.sum(axis=-1) * angles[:, None]).ravel()
    ends = np.cumsum(weight) / weight.sum()
    texel_area = (np.pi / height) ** 2

    def rays(sampler: Any, count: int) -> tuple[Any, Any, Any]:
        chosen = np.searchsorted(ends, np.array(sampler.next_1d())).clip(0, len(ends) - 1)
        light, row, column = np.unravel_index(chosen, tables.shape[:3])
        first, second = (np.array(sampler.next_2d(), np.float64) for _ in range(2))
        # A sum of two uniform numbers has the density of linear interpolation.
        azimuth = (0.5 - (column + first.sum(axis=0) - 0.5) / (2 * height)) * 2 * np.pi
        # Beyond the first and the last centre the texel itself continues.
        across = (row + second.sum(axis=0) - 0.5).reshape(-1)
        across = np.where(across < 0, -across, across)
        across = np.where(across > height, 2 * height - across, across)
        latitude = (across / height - 0.5) * np.pi
        flat = np.cos(latitude)
        direction = np.stack(
            [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(latitude)], axis=-1
        )
        colour = tables[light, row, column]
        share = colour / colour.sum(axis=-1, keepdims=True) * weight.sum() / count
        flux = share * (flat * texel_area / angles[row])[:, None]
        vectors = lights.position[light], direction, flux
        return tuple(  # type: ignore[return-value]
            on_device(kind, np.ascontiguousarray(values, np.float32))
            for kind, values in zip((mi.Point3f, mi.Vector3f, mi.Color3f), vectors, strict=True)
        )

    return rays
