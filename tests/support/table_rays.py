"""Rays of exported point lights, from their tables by direction, for `measure.irradiance`."""

import mitsuba as mi
import numpy as np

from lumitree.core.device import on_device
from lumitree.output.direction_tables import direction_tables, table_angles
from lumitree.output.point_lights import PointLights
from lumitree.trace.emitted_rays import RayBatch, seeded_sampler


class TableRays:
    """Rays of point lights; `EmittedRays`.

    Intensities are interpolated linearly between the texels, as Cycles does it.
    """

    def __init__(self, lights: PointLights) -> None:
        self._position, self._height = lights.position, 2 * lights.resolution
        self._tables = direction_tables(lights, np.eye(3), self._height)
        self._angles = table_angles(self._height)
        self._weight = (self._tables.sum(axis=-1) * self._angles[:, None]).ravel()

    def draw(self, count: int, seed: int) -> RayBatch:
        """As `EmittedRays.draw`."""
        tables, weight, height = self._tables, self._weight, self._height
        sampler = seeded_sampler(seed, count)
        ends = np.cumsum(weight) / weight.sum()
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
        texel_area = (np.pi / height) ** 2
        flux = share * (flat * texel_area / self._angles[row])[:, None]
        vectors = self._position[light], direction, flux
        return RayBatch(
            *(
                on_device(kind, np.ascontiguousarray(values, np.float32))
                for kind, values in zip((mi.Point3f, mi.Vector3f, mi.Color3f), vectors, strict=True)
            )
        )
