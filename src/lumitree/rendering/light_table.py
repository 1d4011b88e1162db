"""The table from which a cell of light is sampled, and the cells of receivers that are its rows.

Each row is in proportion to the root mean square of the light that cells send to random receivers
of its cell of receivers, a part of it to the flux of cells.

Cells of receivers around a lamp are bins of direction from its centre (`core.octahedral`) times
shells of equal width in R / (g + R / 2), in which parallax is about linear; R is the radius of the
lamp's bounding sphere, and g the distance beyond the lamp's box on the way from the centre. In the
lamp's box, cells of receivers are a grid.
Receivers that are farther away get sums of cells (`light_levels`): `LevelChoice`.

Symbols
    C   cells that emit        L   levels of a light field
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import concatenate, on_device, parameter, random_numbers
from lumitree.core.octahedral import bin_of, direction_in_bin

# Part of the samples of a cell that is by flux alone.
_FLUX_FRACTION = 0.1
# Receivers in each of their cells that a row is made from.
_POINTS_PER_CELL = 16
# Levels beyond 0 at most; and the distances of receivers are multiplied by random numbers from 1 to
# 1 + `_BLEND`, so that there is no seam between levels.
MAX_SUMS, _BLEND = 4, 0.5
# intensity(cell, offset, distance): radiant intensity of a cell towards a receiver.
Intensity = Callable[["mi.UInt32", "mi.Vector3f", "mi.Float"], "mi.Color3f"]


class Receivers(Protocol):
    """Cells of a space in which there are receivers."""

    count: int

    def index(self, x: mi.Point3f) -> mi.UInt32:
        """Index of the cell of a point, or of the nearest cell."""
        ...

    def point(self, cell: mi.UInt32, sample: mi.Point2f, depth_sample: mi.Float) -> mi.Point3f:
        """Random point of a cell for three samples in [0, 1)."""
        ...


def cell_rows(
    receivers: Receivers,
    corners: mi.Float,
    intensity: Intensity,
    scale: mi.Float,
    flux: NDArray[np.float64],
    softening: float = 0.0,
) -> tuple[mi.Float, tuple[int, int]]:
    """Rows of an alias table: weights, flat, with which each cell is sampled.

    There is a row for each cell of receivers, and one more by flux alone.

    Args:
        receivers: cells of receivers.
        corners: mi.Float [C × 2 × 3], lower and upper corner of each.
        scale: the largest intensity.
        flux: [C] of the cells, any unit.
        softening: distance that is added to the distance from a cell to a receiver, in square: for
            receivers among the cells. Others, at all distances, count alike with 0.

    Returns:
        The weights; and the number of rows and C.
    """
    # Numbers on the device: lamps share the kernel.
    count, rows = parameter(mi.UInt32, len(flux)), receivers.count
    points = rows * _POINTS_PER_CELL
    random, point = random_numbers(points, 0), dr.arange(mi.UInt32, points)
    # One in each of 4 x 4 parts of the cell: light that is in one bin alone is not missed.
    part = mi.Point2f(point % 4, point // 4 % 4)
    sample = (part + mi.Point2f(random.next_float32(), random.next_float32())) / 4
    x = receivers.point(point // _POINTS_PER_CELL, sample, random.next_float32())
    cell = dr.arange(mi.UInt32, rows * len(flux))
    random = random_numbers(rows * len(flux), 1)
    soft = parameter(mi.Float, softening**2) if softening else None
    row, cell = cell // count, cell % count
    light = dr.sqrt(_mean_square(x, row, cell, corners, intensity, scale, soft, random))
    total = dr.gather(mi.Float, dr.block_sum(light, len(flux)), row)
    by_flux = on_device(mi.Float, flux / flux.sum())
    even = dr.gather(mi.Float, by_flux, cell)
    light = dr.lerp(dr.select(total > 0, light / total, even), even, _FLUX_FRACTION)
    return concatenate([light, by_flux]), (rows + 1, len(flux))


@dr.syntax
def _mean_square(
    points: mi.Point3f,
    row: mi.UInt32,
    cell: mi.UInt32,
    corners: mi.Float,
    intensity: Intensity,
    scale: mi.Float,
    soft: mi.Float | None,
    random: mi.PCG32,
) -> mi.Float:
    """Mean square of the light that cells send to receivers of rows, over `scale`.

    Args:
        points: `_POINTS_PER_CELL` receivers of each row.
        soft: added to squares of distances; None for receivers at all distances.
    """
    lower = dr.gather(mi.Point3f, corners, 2 * cell)
    upper = dr.gather(mi.Point3f, corners, 2 * cell + 1)
    done, total = mi.UInt32(0), mi.Float(0)
    # In a loop, since the table is made of some ten million terms, which need not be stored.
    while done < _POINTS_PER_CELL:
        x = dr.gather(mi.Point3f, points, row * _POINTS_PER_CELL + done)
        within = mi.Point3f(random.next_float32(), random.next_float32(), random.next_float32())
        offset = mi.Vector3f(x - dr.lerp(lower, upper, within))
        square = dr.squared_norm(offset)
        if soft is not None:
            square += soft
        # Not the mean over channels: its divisor would be a constant that depends on the width.
        light = dr.sum(intensity(cell, offset, dr.sqrt(square)))
        if soft is None:
            light *= dr.squared_norm(mi.Vector3f(x))
        # Relative to the largest intensity: squares of others may be out of range.
        light /= square * scale
        total += dr.square(light)
        done += 1
    return total / _POINTS_PER_CELL


class ReceiverCells:
    """Cells around a lamp in its local frame, numbered shell by shell from the outermost.

    Args:
        resolution: bins of direction a side.
        shell_width: of a shell in R / (g + R / 2).
        first_shell: receivers that are farther away are in this one.
    """

    def __init__(
        self,
        half_extents: NDArray[np.float64],
        resolution: int,
        num_shells: int,
        shell_width: float,
        first_shell: int = 0,
    ) -> None:
        self.resolution = resolution
        self.num_bins = resolution**2
        self.count = num_shells * self.num_bins
        self._width = shell_width
        self._shells = parameter(mi.Vector2u, first_shell, first_shell + num_shells - 1)
        self._scale = parameter(mi.Float, shell_width / float(np.linalg.norm(half_extents)))
        self._inverse = parameter(mi.Vector3f, *(1 / half_extents).tolist())

    def index(self, x: mi.Point3f, shells: mi.Vector2u | None = None) -> mi.UInt32:
        """Index of the cell of a point.

        `shells`: the first and the last one. Default: the shells of this object.
        """
        first, last = self._shells if shells is None else shells
        offset = mi.Vector3f(x)
        gap = dr.norm(offset) * (1 - dr.rcp(dr.max(dr.abs(offset) * self._inverse)))
        place = dr.rcp(dr.fma(dr.maximum(gap, 0), self._scale, self._width / 2))
        shell = dr.clip(mi.UInt32(dr.minimum(place, mi.Float(last))), first, last) - first
        return shell * self.num_bins + bin_of(offset, self.resolution, bevelled=False)

    def point(self, cell: mi.UInt32, sample: mi.Point2f, depth_sample: mi.Float) -> mi.Point3f:
        """Random point of a cell, outside the lamp's box."""
        direction, _ = direction_in_bin(
            cell % self.num_bins, sample, self.resolution, bevelled=False
        )
        place = mi.Float(cell // self.num_bins + self._shells.x) + depth_sample
        surface = dr.rcp(dr.max(dr.abs(direction) * self._inverse))
        # Far away nothing changes any more but the rounding.
        gap = (dr.rcp(dr.maximum(place, 0.02)) - self._width / 2) / self._scale
        return mi.Point3f(direction * (1.001 * surface + dr.maximum(gap, 0)))


class InsideReceivers:
    """Cells of receivers in a lamp's box: as many a side, whatever its proportions."""

    def __init__(self, half_extents: NDArray[np.float64], resolution: int) -> None:
        self.resolution, self.count = resolution, resolution**3
        self._half = parameter(mi.Vector3f, *half_extents.tolist())

    def index(self, x: mi.Point3f) -> mi.UInt32:
        """Index of the cell of a point, or of the nearest cell."""
        side = self.resolution
        place = mi.Vector3i(dr.floor((mi.Vector3f(x) / self._half + 1) * (side / 2)))
        place = mi.Vector3u(dr.clip(place, 0, side - 1))
        return (place.z * side + place.y) * side + place.x

    def point(self, cell: mi.UInt32, sample: mi.Point2f, depth_sample: mi.Float) -> mi.Point3f:
        """Random point of a cell."""
        side = self.resolution
        place = mi.Vector3f(cell % side, cell // side % side, cell // side**2)
        within = mi.Vector3f(sample.x, sample.y, depth_sample)
        return mi.Point3f(((place + within) * (2 / side) - 1) * self._half)


class LevelChoice:
    """The level of receivers: the coarsest one whose limit their distance exceeds.

    Args:
        half_extents: of the lamp's box.
        limits: [L - 1] distances from the box, local units, in increasing order, of the levels
            beyond level 0.
    """

    def __init__(self, half_extents: NDArray[np.float64], limits: NDArray[np.float64]) -> None:
        self._radius, self._limits = float(np.linalg.norm(half_extents)), limits
        self._half = parameter(mi.Vector3f, *half_extents.tolist())
        padded = limits.tolist() + [np.inf] * (MAX_SUMS - len(limits))
        self._on_device = [parameter(mi.Float, limit) for limit in padded]

    def sample(self, x: mi.Point3f, sample: mi.Float) -> mi.UInt32:
        """Level of a receiver, for a sample in [0, 1)."""
        outside = dr.maximum(dr.abs(mi.Vector3f(x)) - self._half, 0)
        distance = dr.norm(outside) * dr.fma(_BLEND, sample, 1)
        return sum((mi.UInt32(distance > limit) for limit in self._on_device), mi.UInt32(0))

    def shells(self, level: int, width: float, num_shells: int) -> tuple[int, int]:
        """First and last shell of this width (`ReceiverCells`) with receivers of a level."""
        starts = np.concatenate([[0.0], self._limits / (1 + _BLEND), [np.inf]])
        # g is at least the distance of a receiver from the box, and at most R more.
        radius, farthest = self._radius, np.append(self._limits, np.inf)[level] + self._radius
        shells = radius / (np.array([farthest, starts[level]]) + radius / 2) / width
        first, last = np.minimum(shells, num_shells - 1).astype(int).tolist()
        return first, last
