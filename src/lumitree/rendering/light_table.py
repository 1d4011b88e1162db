"""The table from which a cell of light is sampled, and the cells of receivers that are its rows.

Each row is in proportion to the root mean square of the light that cells send to random receivers
of its cell of receivers, a part of it to the flux of cells.

Cells of receivers around a lamp are bins of direction from its centre (`core.octahedral`) times
shells of equal width in R / distance, in which parallax is linear; R is the radius of the lamp's
bounding sphere. The innermost shell has no end.

Symbols
    C   cells that emit
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import parameter
from lumitree.core.octahedral import bin_of, direction_in_bin

# Part of the samples of a cell that is by flux alone.
_FLUX_FRACTION = 0.1
# Receivers in each of their cells that a row is made from, and rows that are made at once.
_POINTS_PER_CELL = 16
_ROWS_AT_ONCE = 16
# intensity(cell, offset, distance): radiant intensity of a cell towards a receiver.
Intensity = Callable[["mi.UInt32", "mi.Vector3f", "mi.Float"], "mi.Color3f"]


class Receivers(Protocol):
    """Cells of a space in which there are receivers."""

    count: int

    def point(self, cell: mi.UInt32, sample: mi.Point2f, shell_sample: mi.Float) -> mi.Point3f:
        """Random point of a cell, as `receiver_cells.ReceiverCells.point`."""
        ...


def cell_rows(
    receivers: Receivers,
    corners: mi.Float,
    intensity: Intensity,
    scale: mi.Float,
    flux: NDArray[np.float64],
    softening: float = 0.0,
) -> Iterator[NDArray[np.float64]]:
    """Rows of an alias table: shares [.., C] of samples that each cell is to get.

    There is a row for each cell of receivers.

    One more row is by flux alone.

    Args:
        receivers: a multiple of 16 of their cells.
        corners: mi.Float [C × 2 × 3], lower and upper corner of each.
        scale: the largest intensity.
        softening: distance that is added to that from a cell to a receiver, in square: for
            receivers among the cells. Others, at all distances, count alike with 0.
    """
    maker = _Maker(receivers, corners, intensity, scale, flux, softening)
    return itertools.chain(maker.rows(), [flux[None]])


class _Maker:
    def __init__(
        self,
        receivers: Receivers,
        corners: mi.Float,
        intensity: Intensity,
        scale: mi.Float,
        flux: NDArray[np.float64],
        softening: float,
    ) -> None:
        self._receivers, self._corners, self._intensity = receivers, corners, intensity
        self._scale, self._shares = scale, flux / flux.sum()
        self._soft, self._softening = softening > 0, parameter(mi.Float, softening**2)
        # Number of cells, as a number on the device.
        self._count, self._opaque_count = len(flux), parameter(mi.UInt32, len(flux))

    def rows(self) -> Iterator[NDArray[np.float64]]:
        """Share [.., C] of samples that each cell is to get, for some cells of receivers each."""
        # All are begun before the first is waited for: each waiting costs time of the processor.
        firsts = range(0, self._receivers.count, _ROWS_AT_ONCE)
        for square in [self._square(first) for first in firsts]:
            light = np.sqrt(np.array(square, np.float64).reshape(_ROWS_AT_ONCE, -1))
            total = light.sum(axis=1, keepdims=True)
            shares = np.where(total > 0, light / np.maximum(total, 1e-300), self._shares)
            yield (1 - _FLUX_FRACTION) * shares + _FLUX_FRACTION * self._shares

    def _square(self, first: int) -> mi.Float:
        """`_mean_square` for random receivers in `_ROWS_AT_ONCE` cells from `first`."""
        points = _ROWS_AT_ONCE * _POINTS_PER_CELL
        rng = mi.PCG32(points, initstate=dr.opaque(mi.UInt64, first))
        row = dr.opaque(mi.UInt32, first) + dr.arange(mi.UInt32, points) // _POINTS_PER_CELL
        sample = mi.Point2f(rng.next_float32(), rng.next_float32())
        square = self._mean_square(self._receivers.point(row, sample, rng.next_float32()), first)
        dr.eval(square)
        return square

    @dr.syntax
    def _mean_square(self, points: mi.Point3f, seed: int) -> mi.Float:
        """Mean square of the light that cells send to each row's receivers, over `_scale`.

        There are `_POINTS_PER_CELL` receivers for each of `_ROWS_AT_ONCE` rows.
        """
        index = dr.arange(mi.UInt32, _ROWS_AT_ONCE * self._count)
        row, cell = index // self._opaque_count, index % self._opaque_count
        lower = dr.gather(mi.Point3f, self._corners, 2 * cell)
        upper = dr.gather(mi.Point3f, self._corners, 2 * cell + 1)
        rng = mi.PCG32(dr.width(index), initstate=dr.opaque(mi.UInt64, seed))
        done, total = mi.UInt32(0), mi.Float(0)
        # In a loop, since the table is made of some ten million terms, which need not be stored.
        while done < _POINTS_PER_CELL:
            x = dr.gather(mi.Point3f, points, row * _POINTS_PER_CELL + done)
            within = mi.Point3f(rng.next_float32(), rng.next_float32(), rng.next_float32())
            offset = mi.Vector3f(x - dr.lerp(lower, upper, within))
            square = dr.squared_norm(offset) + self._softening
            # Not the mean over channels: its divisor would be a constant that depends on the width.
            light = dr.sum(self._intensity(cell, offset, dr.sqrt(square)))
            if not self._soft:
                light *= dr.squared_norm(mi.Vector3f(x))
            # Relative to the largest intensity: squares of others may be out of range.
            light /= square * self._scale
            total += dr.square(light)
            done += 1
        return total / _POINTS_PER_CELL


class ReceiverCells:
    """Cells around a lamp in its local frame, numbered shell by shell from the outermost.

    Args:
        resolution: bins of direction a side.
        shell_width: of a shell in R / distance.
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
        self._radius = parameter(mi.Float, float(np.linalg.norm(half_extents)))
        self._half = parameter(mi.Point3f, *half_extents.tolist())

    def index(self, x: mi.Point3f, shells: mi.Vector2u | None = None) -> mi.UInt32:
        """Index of the cell of a point.

        `shells`: the first and the last one, if not those of this object.
        """
        first, last = self._shells if shells is None else shells
        offset = mi.Vector3f(x)
        nearness = self._radius * dr.rsqrt(dr.squared_norm(offset)) / self._width
        shell = dr.clip(mi.UInt32(dr.minimum(nearness, mi.Float(last))), first, last) - first
        return shell * self.num_bins + bin_of(offset, self.resolution, bevelled=False)

    def point(self, cell: mi.UInt32, sample: mi.Point2f, shell_sample: mi.Float) -> mi.Point3f:
        """Random point of a cell, outside the lamp's box."""
        direction, _ = direction_in_bin(
            cell % self.num_bins, sample, self.resolution, bevelled=False
        )
        shell = cell // self.num_bins + self._shells.x
        nearness = (mi.Float(shell) + shell_sample) * self._width
        surface = dr.min(self._half / dr.abs(direction))
        # Beyond 50 R nothing changes any more but the rounding.
        distance = dr.maximum(self._radius / dr.maximum(nearness, 0.02), 1.001 * surface)
        return mi.Point3f(direction * distance)
