"""Histograms of light by the cell of a grid where it starts, and by direction.

The grid has 2**depth cells a side over the cube [-1, 1]³ of the local frame. A `Histogram` grows
with the cells in which light starts.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.octahedral import bin_of
from lumitree.core.photometry import luminance


def grid_cell(position: mi.Point3f, side: mi.Float | int) -> mi.Point3i:
    """Cell of a position in a grid of `side` cells a side; the nearest, if outside."""
    return dr.clip(mi.Point3i(dr.floor((position + 1) * (side / 2))), 0, mi.Int32(side) - 1)


def cell_codes(cells: NDArray[np.integer], depth: int) -> NDArray[np.int64]:
    """Codes [C] of the cells [C, 3] of a grid with 2**depth a side."""
    side = 1 << depth
    return cells.astype(np.int64) @ [1, side, side**2]


def coded_cells(codes: NDArray[np.int64], depth: int) -> NDArray[np.int64]:
    """Cells [C, 3] of `cell_codes`."""
    side = 1 << depth
    return np.stack([codes % side, codes // side % side, codes // side**2], axis=1)


@dataclasses.dataclass(frozen=True)
class BinnedRays:
    """Rays by the cell of a grid in which they start, and by direction.

    Attributes:
        codes: [N] `cell_codes` of their cells.
        bins: [N] octahedral bins of their directions.
        straight: [N] whether each is straight light.
        flux: [3, N].
    """

    codes: NDArray[np.uint32]
    bins: NDArray[np.uint16]
    straight: NDArray[np.bool_]
    flux: NDArray[np.floating]


def bin_rays(
    origin: mi.Point3f,
    direction: mi.Vector3f,
    straight: mi.Bool | bool,
    flux: NDArray[np.floating],
    depth: int,
    resolution: int,
) -> BinnedRays:
    """Rays with a flux [3, N] in a grid of 2**depth cells and R octahedral bins a side."""
    return with_bins(origin, bin_of(direction, resolution), straight, flux, depth)


def with_bins(
    origin: mi.Point3f,
    bins: mi.UInt32,
    straight: mi.Bool | bool,
    flux: NDArray[np.floating],
    depth: int,
) -> BinnedRays:
    """As `bin_rays`, with the bins of directions."""
    side = 1 << depth
    cell = grid_cell(origin, side)
    code = (cell.z * side + cell.y) * side + cell.x
    every = np.broadcast_to(np.array(straight, bool), flux.shape[1:])
    return BinnedRays(np.array(code, np.uint32), np.array(bins, np.uint16), every, flux)


@dataclasses.dataclass(frozen=True)
class BinnedSegments:
    """Segments that end on the luminaire: `BinnedRays`, and how far they reach.

    Attributes:
        rays: by cell and direction.
        steps: [N] index of the distance after which each ends, see `segments.distances_passed`.
    """

    rays: BinnedRays
    steps: NDArray[np.uint8]


class Histogram:
    """Flux of rays by the cell where they start and by direction.

    Cells are in the order in which light was first found in them.

    Args:
        depth: the grid has 2**depth cells a side.
        resolution: R bins of direction a side.
    """

    def __init__(self, depth: int, resolution: int) -> None:
        self._depth, self._resolution = depth, resolution
        # Row of each cell of the grid, or -1.
        self._rows: NDArray[np.int64] = np.full(1 << 3 * depth, -1)
        self._codes = np.zeros(0, np.int64)
        self._flux = np.zeros((0, resolution**2, 3))

    @property
    def cells(self) -> NDArray[np.int64]:
        """[C, 3] cells that have light."""
        return coded_cells(self._codes, self._depth)

    @property
    def flux(self) -> NDArray[np.float64]:
        """[C, R², 3] flux of the bins of each cell."""
        return self._flux[: len(self._codes)]

    def add(self, origin: mi.Point3f, direction: mi.Vector3f, flux: NDArray[np.float64]) -> None:
        """Add rays with a flux [3, N] that start inside the grid."""
        self.add_binned(bin_rays(origin, direction, False, flux, self._depth, self._resolution))

    def add_binned(self, rays: BinnedRays) -> None:
        """Add rays of `bin_rays` with the same grid and bins."""
        index = self._places(rays)
        self._flux = self._grown(self._flux)
        _add(self.flux, index, rays.flux)

    def _places(self, rays: BinnedRays) -> NDArray[np.int64]:
        """Index [N] of the bin of each ray among all bins; new cells get new rows."""
        codes = rays.codes
        new = np.unique(codes[self._rows[codes] < 0]).astype(np.int64)
        self._rows[new] = len(self._codes) + np.arange(len(new))
        self._codes = np.append(self._codes, new)
        return self._rows[codes] * self._resolution**2 + rays.bins

    def _grown(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values with at least one row for each cell; the memory is used when cells are found."""
        count = len(self._codes)
        if count <= len(values):
            return values
        grown = np.zeros((count + count // 4, *values.shape[1:]), values.dtype)
        grown[: len(values)] = values
        return grown


class LightHistogram(Histogram):
    """Flux of light paths, and the part of it that is bent: not straight."""

    def __init__(self, depth: int, resolution: int) -> None:
        super().__init__(depth, resolution)
        self._bent = np.zeros_like(self._flux)

    @property
    def bent(self) -> NDArray[np.float64]:
        """[C, R², 3] flux of the bent light of the bins of each cell."""
        return self._bent[: len(self._codes)]

    def add_binned(self, rays: BinnedRays) -> None:
        """As `Histogram.add_binned`."""
        index, bent = self._places(rays), ~rays.straight
        self._flux, self._bent = self._grown(self._flux), self._grown(self._bent)
        _add(self.flux, index, rays.flux)
        _add(self.bent, index[bent], rays.flux[:, bent])


class EndingHistogram(LightHistogram):
    """Flux of segments that end on the luminaire, by cell, bin of direction and reach.

    Each of the Q² bins of direction contains four bins of a light field with R = 2 Q bins a side.

    A cell takes 8 (K + 5) Q² bytes: with 26 distances K, 1.3 times as many as exitant light.
    """

    def __init__(self, depth: int, resolution: int, num_distances: int) -> None:
        super().__init__(depth, resolution)
        self._by_reach = np.zeros((0, resolution**2, num_distances - 1), np.float32)
        self._straight_by_reach = np.zeros_like(self._by_reach)

    @property
    def by_reach(self) -> NDArray[np.float32]:
        """[C, Q², K - 1] luminance of the segments that end between two distances."""
        return self._by_reach[: len(self._codes)]

    @property
    def bent_by_reach(self) -> NDArray[np.float32]:
        """The part of `by_reach` that is bent light."""
        # Sums are rounded.
        return np.maximum(self.by_reach - self._straight_by_reach[: len(self._codes)], 0)

    def add_segments(self, segments: BinnedSegments) -> None:
        """Add segments of `bin_segments` with the same grid, bins and distances."""
        rays = segments.rays
        self.add_binned(rays)
        self._by_reach = self._grown(self._by_reach)
        self._straight_by_reach = self._grown(self._straight_by_reach)
        index = self._places(rays) * self._by_reach.shape[2] + segments.steps
        light = luminance(rays.flux.T).astype(np.float32)
        np.add.at(self._by_reach.reshape(-1), index, light)
        np.add.at(self._straight_by_reach.reshape(-1), index[rays.straight], light[rays.straight])


def _add(values: NDArray[np.float64], index: NDArray[np.int64], flux: NDArray[np.floating]) -> None:
    """Add flux [3, N] to the bins of an index [N] among the values [C, R², 3], in place."""
    flat = values.reshape(-1, 3)
    for channel in range(3):
        flat[:, channel] += np.bincount(index, flux[channel], len(flat))
