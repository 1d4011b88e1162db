"""The light field on the device: the radiant intensity of its cells, and rays that leave it.

Symbols
    C   cells        R   bins of direction a side
"""

from __future__ import annotations

import math
import weakref

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.light_field import LightField, divided, pack_lit, unpack
from lumitree.core.device import on_device, parameter
from lumitree.core.octahedral import direction_in_bin, solid_angles
from lumitree.core.photometry import luminance
from lumitree.rendering.sampling.light_bins import bins_around, unpacked
from lumitree.rendering.sampling.light_cells import LightCells
from lumitree.rendering.sampling.light_levels import (
    POINTS,
    LevelChoice,
    level_limits,
    light_sums,
    points_around,
)
from lumitree.rendering.sampling.samples import sample_row, scrambled

_LIGHTS: weakref.WeakKeyDictionary[LightField, dict[tuple[object, ...], EmittedLight]] = (
    weakref.WeakKeyDictionary()
)


def emitted_light(asset: Asset, *, levels: bool = False) -> EmittedLight:
    """Device copy of what an asset's light field emits, shared by all that use the asset."""
    assert asset.light_field is not None
    lights, key = (
        _LIGHTS.setdefault(asset.light_field, {}),
        (str(mi.variant()), asset.light_factors, levels),
    )
    if key not in lights:
        # Mitsuba creates plugins in parallel: of two copies, the first is kept.
        light = EmittedLight(
            asset.light_field, asset.frame.half_extents, asset.light_factors, levels=levels
        )
        return lights.setdefault(key, light)
    return lights[key]


class EmittedLight:
    """Device copy of the intensities of a light field, in the lamp's local frame.

    Args:
        gain: [3] factors on R, G and B, not all 0.
        levels: whether there are levels beyond 0.

    Attributes:
        scale: mi.Float, unit of intensities.
        cells: the cells of all levels (`light_levels`), the finest first.
        levels: coordinates of the cells of each level.
        choice: of the level of receivers.
        by_cell: [C] luminous flux of the cells of each level, any unit.
    """

    def __init__(
        self,
        field: LightField,
        half_extents: NDArray[np.float64],
        gain: tuple[float, float, float] = (1.0, 1.0, 1.0),
        *,
        levels: bool = False,
    ) -> None:
        self._count, self._resolution = len(field.cells), field.resolution
        bins = field.dense(luminance(unpack(field.intensity)))
        flux = np.asarray(bins * solid_angles(field.resolution), np.float64)
        by_cell = flux.sum(axis=1)
        sums = light_sums(field, half_extents, by_cell) if levels else []
        self.levels = [field.cells, *(level.cells for level in sums)]
        self.by_cell = [by_cell, *(level.flux for level in sums)]
        more = [(level.lower, level.upper) for level in sums]
        self.cells = LightCells(half_extents, field.cells, field.depth, more)
        # Sums may be larger than the unit of the field. A power of two changes no mantissa.
        largest = max((float(level.intensity.max()) for level in sums), default=1.0)
        unit = 2.0 ** max(math.ceil(math.log2(largest)), 0)
        packed = [field.dense(divided(field.intensity, unit))]
        packed += [pack_lit(level.intensity, unit) for level in sums]
        self._packed = on_device(mi.UInt32, np.concatenate(packed))
        self.scale = dr.opaque(mi.Float, field.scale * unit * max(gain))
        self._colour = parameter(mi.Color3f, *(factor / max(gain) for factor in gain))
        cumulated = np.cumsum(flux, axis=1)
        self._bin_chances = on_device(mi.Float, cumulated / cumulated[:, -1:])
        self._cell_chances = on_device(mi.Float, np.cumsum(by_cell / by_cell.sum()))
        self._ends = np.cumsum([0, *map(len, self.levels)]).tolist()
        errors = self._level_errors(half_extents) if levels else np.zeros(0)
        self.choice = LevelChoice(half_extents, level_limits(errors, field.depth))

    def _level_errors(self, half_extents: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative differences of the irradiance of levels beyond 0, as of `level_limits`."""
        x, n = (on_device(mi.Point3f, each) for each in points_around(half_extents))
        found = []
        for level in range(len(self.levels)):
            random = mi.PCG32(dr.width(x), initstate=dr.opaque(mi.UInt64, level))
            light = self.irradiance(x, mi.Vector3f(n), random, mi.Bool(True), level)
            found.append(luminance(np.array(light).T).reshape(-1, POINTS).mean(axis=1))
        first, *sums = found
        error = np.array([np.sqrt(np.square(each - first).mean()) for each in sums])
        # Of a lamp whose light is all straight, next to nothing is bent.
        return error / first.mean() if first.any() else np.zeros(len(sums))

    def intensity(self, cell: mi.UInt32, index: mi.UInt32, active: mi.Bool | bool) -> mi.Color3f:
        """Radiant intensity of a bin of a cell."""
        packed = dr.gather(mi.UInt32, self._packed, cell * self._resolution**2 + index, active)
        return self._colour * (self.scale * unpacked(packed))

    @dr.syntax
    def irradiance(
        self, x: mi.Point3f, n: mi.Vector3f, random: mi.PCG32, active: mi.Bool, level: int = 0
    ) -> mi.Color3f:
        """Irradiance of receivers outside the box that nothing shadows: Σ I cos θ / r².

        Each cell of a level has its light in one random point. The mean over the points is its
        light.
        """
        first, end = (parameter(mi.UInt32, each) for each in self._ends[level : level + 2])
        total, cell = mi.Color3f(0), dr.zeros(mi.UInt32, dr.width(x)) + first
        while active & (cell < end):
            within = mi.Point3f(random.next_float32(), random.next_float32(), random.next_float32())
            offset = mi.Vector3f(self.cells.point(cell, within, active) - x)
            projected = dr.dot(n, offset)
            faces = active & (projected > 0)
            light = mi.Color3f(0)
            for bins, weight in bins_around(-offset, self._resolution):
                light += weight * self.intensity(cell, bins, faces)
            squared = dr.squared_norm(offset)
            total += dr.select(faces, light * projected * dr.rsqrt(squared) / squared, 0)
            cell += 1
        return total

    def sample_ray(
        self,
        choice: mi.Float,
        sample1: mi.Point2f,
        sample2: mi.Point2f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Color3f]:
        """Ray along which light leaves the lamp: a point of it inside the box, direction, and flux.

        The direction is a unit vector along which the light travels. The mean of the flux (local
        units) over all samples is the lamp's flux.
        """
        bins = self._resolution**2
        cell = sample_row(self._cell_chances, mi.UInt32(0), self._count, choice, active)
        index = sample_row(self._bin_chances, cell * bins, bins, sample1.x, active)
        within = scrambled(sample2)
        point = self.cells.point(cell, within, active)
        # Other bits of the same samples, which the point does not depend on.
        jitter = scrambled(mi.Point2f(sample2.y, sample1.y))
        spread = scrambled(mi.Point2f(sample1.y, sample2.y)) - 0.5
        # As of `smooth_bin`: a bin has a part of the light of directions in its neighbours.
        sample = mi.Point2f(jitter.x + spread.x, jitter.y + spread.y)
        direction, density = direction_in_bin(index, sample, self._resolution)
        chance = self._chance(self._cell_chances, mi.UInt32(0), cell, active)
        chance *= self._chance(self._bin_chances, cell * bins, index, active)
        flux = self.intensity(cell, index, active) / (chance * density)
        return point, direction, dr.select(active & (chance > 0), flux, 0)

    def _chance(self, cumulated, first, index, active):
        """Chance with which `sample_row` returns an index."""
        upper = dr.gather(mi.Float, cumulated, first + index, active)
        inner = active & (index > 0)
        return upper - dr.gather(mi.Float, cumulated, first + index - 1, inner)
