"""The light field for receivers inside the lamp's box.

As `light_field`, whose symbols hold, for receivers among the cells. What they get of a cell
depends on their distance (`asset.light_field`).

Symbols
    C   cells that light leaves         Q   bins of direction a side, half of R
    J, s    see `asset.light_field`
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.light_field import LightField, dense, unpack
from lumitree.core.alias_table import AliasTable
from lumitree.core.device import on_device, parameter
from lumitree.core.octahedral import coarse_bin, coarse_solid_angles, solid_angles
from lumitree.core.photometry import luminance
from lumitree.octree.build import morton
from lumitree.rendering.sampling.cell_table import cell_rows
from lumitree.rendering.sampling.emitter_sampling import INSIDE, Target
from lumitree.rendering.sampling.light_bins import (
    ending_by_bin,
    smooth_bin,
    unpacked,
)
from lumitree.rendering.sampling.light_cells import LightCells
from lumitree.rendering.sampling.light_field import (
    DeviceLightField,
    left_part,
)
from lumitree.rendering.sampling.samples import scrambled

# Cells of receivers a side.
_RESOLUTION = 8
# Entries of the table, of 8 bytes: lamps with more cells have half as many cells a side.
_MAX_ENTRIES = 1 << 23
# Curves are looked up at this many distances, more densely where they are short.
_STEPS = 64
_NONE = 0xFFFFFFFF


def inside_light(asset: Asset, outside: DeviceLightField) -> InsideLight:
    """Light that an asset sends to receivers inside its box, shared by all instances of a lamp.

    `outside` is what it sends to others, from the same field.
    """
    if outside.inside is None:
        field = outside.field()
        assert field is not None
        outside.inside = InsideLight(field, asset.frame.half_extents, outside, asset.light_factors)
    return outside.inside


class InsideReceivers:
    """Cells of receivers in a box: as many a side, whatever its proportions."""

    def __init__(self, half_extents: NDArray[np.float64], resolution: int) -> None:
        self.resolution, self.count = resolution, resolution**3
        self._half = parameter(mi.Vector3f, *half_extents.tolist())

    def index(self, x: mi.Point3f) -> mi.UInt32:
        """Index of the cell of a point, or of the nearest cell."""
        side = self.resolution
        place = mi.Vector3i(dr.floor((mi.Vector3f(x) / self._half + 1) * (side / 2)))
        place = mi.Vector3u(dr.clip(place, 0, side - 1))
        return (place.z * side + place.y) * side + place.x

    def point(self, cell: mi.UInt32, sample: mi.Point2f, shell_sample: mi.Float) -> mi.Point3f:
        """Random point of a cell."""
        side = self.resolution
        place = mi.Vector3f(cell % side, cell // side % side, cell // side**2)
        within = mi.Vector3f(sample.x, sample.y, shell_sample)
        return mi.Point3f(((place + within) * (2 / side) - 1) * self._half)


class InsideLight:
    """Device copy of what a light field sends to receivers inside the box.

    Args:
        field: what is emitted. Without its part `inside`, receivers get what leaves the box.
    """

    def __init__(
        self,
        field: LightField,
        half_extents: NDArray[np.float64],
        outside: DeviceLightField,
        gain: tuple[float, float, float],
    ) -> None:
        inside, self._outside = field.inside, outside
        found = field.cells if inside is None else inside.cells
        count = len(found)
        self._resolution, self._coarse = field.resolution, field.resolution // 2
        self.cells = LightCells(half_extents, found, field.depth)
        rows = np.full(count, _NONE, np.uint32)
        rows[np.searchsorted(morton(found), morton(field.cells))] = np.arange(len(field.cells))
        self._rows = on_device(mi.UInt32, rows)
        outgoing = field.dense(luminance(unpack(field.intensity))) * solid_angles(field.resolution)
        flux = np.zeros(count)
        flux[rows != _NONE] = field.scale * outgoing.sum(axis=1)
        self._has_curves = inside is not None
        if inside is not None:
            bins = self._coarse**2
            packed, scale = ending_by_bin(field)
            self._packed = on_device(mi.UInt32, packed)
            self._rows_of_reach = on_device(mi.UInt32, dense(inside.lit, bins, inside.reach))
            self._gain = parameter(mi.Color3f, *(scale * factor for factor in gain))
            # By the square root of distance.
            self._steps = parameter(mi.Float, (_STEPS - 1) / math.sqrt(inside.distances[-1]))
            at = inside.distances[-1] * np.linspace(0, 1, _STEPS) ** 2
            self._reach = _resampled(inside.reach_curves, inside.distances, at)
            ending = dense(inside.lit, bins, luminance(unpack(inside.intensity)))
            flux += inside.scale * (ending * coarse_solid_angles(self._resolution)).sum(axis=1)
        many = _RESOLUTION**3 * count > _MAX_ENTRIES
        self._receivers = InsideReceivers(half_extents, _RESOLUTION // 2 if many else _RESOLUTION)
        rows = cell_rows(
            self._receivers,
            self.cells.corners,
            self._towards,
            outside.scale,
            # A cell may have no light but what ends nearer than the first distance.
            np.maximum(flux, 1e-6 * flux.max()),
            softening=2.0**-field.depth,
        )
        self._table = AliasTable(rows, (self._receivers.count + 1, count))

    def sample_point(
        self, x: mi.Point3f, sample: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.Vector3f, Target]:
        """As `DeviceLightField.sample_point`, of one candidate."""
        cell, chance = self._table.sample(self._receivers.index(x), sample.x, active)
        offset = mi.Vector3f(self.cells.point(cell, scrambled(sample), active) - x)
        target = Target.at(dr.norm(offset))
        target.cell, target.pmf, target.place = cell, chance, mi.UInt32(INSIDE)
        target.bins = smooth_bin(-offset, self._resolution)
        target.total = dr.sum(self._light(cell, target.bins, target.distance, active))
        volume = dr.gather(mi.Float, self.cells.volume, cell, active)
        target.total /= chance * dr.squared_norm(offset) + volume * self._outside.diffuse
        return offset / target.distance, target

    def contribution(self, target: Target, other: mi.Float, active: mi.Bool) -> mi.Color3f:
        """As `DeviceLightField.contribution`."""
        volume = dr.gather(mi.Float, self.cells.volume, target.cell, active)
        density = target.pmf * dr.square(target.distance) + other * volume
        light = self._light(target.cell, target.bins, target.distance, active)
        return dr.select(active & (density > 0), light * (target.factor / density), 0)

    def received(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        inverse: mi.Float,
        end: mi.Float,
        active: mi.Bool,
    ) -> mi.Color3f:
        """As `DeviceLightField.received`, for a ray from `entry` in the box on.

        Each cell's light is taken at the middle of the ray's way in it.
        """
        row = self._receivers.index(x)
        shared = mi.Bool(active) & (inverse > 0)
        distance, bins = dr.norm(entry - x), smooth_bin(-direction, self._resolution)

        def visit(state, cell, start, length, active):
            near = start + distance
            inverse_volume = dr.rcp(dr.gather(mi.Float, self.cells.volume, cell, active))
            chance = self._table.probability(row, cell, active & shared)
            left = left_part(chance * inverse_volume, inverse, near, length)
            middle = near + length / 2
            light = self._light(cell, bins, middle, active)
            return (state[0] + dr.select(active, light * (left * inverse_volume), 0),), active

        state, span = (mi.Color3f(0),), (mi.Float(0), end)
        return self.cells.octree.traverse(entry, direction, active, visit, state, span)[0]

    def _towards(self, cell, offset, distance):
        return self._light(cell, smooth_bin(offset, self._resolution), distance, mi.Bool(True))

    def _light(self, cell, index, distance, active):
        """Radiant intensity (mi.Color3f) of a cell in a bin of direction, at a distance."""
        row = dr.gather(mi.UInt32, self._rows, cell, active)
        leaves = active & (row != _NONE)
        light = dr.select(leaves, self._outside.emitted.intensity(row, index, leaves), 0)
        if not self._has_curves:
            return light
        packed = dr.gather(mi.UInt32, self._packed, cell * self._resolution**2 + index, active)
        entry = cell * self._coarse**2 + coarse_bin(index, self._resolution)
        reach = dr.gather(mi.UInt32, self._rows_of_reach, entry, active)
        # Linear between two columns of its curve.
        at = dr.minimum(dr.sqrt(distance) * self._steps, _STEPS - 1.001)
        step = mi.UInt32(at)
        first = reach * _STEPS + step
        low, high = (dr.gather(mi.Float, self._reach, first + i, active) for i in (0, 1))
        return light + self._gain * unpacked(packed) * dr.lerp(low, high, at - mi.Float(step))


def _resampled(
    curves: NDArray[np.float32], distances: NDArray[np.float32], at: NDArray[np.floating]
) -> mi.Float:
    """Curves [.., K] at other distances, on the device."""
    return on_device(mi.Float, np.stack([np.interp(at, distances, curve) for curve in curves]))
