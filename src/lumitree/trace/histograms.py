"""Histograms of light by the cell of a grid where it starts, and by direction."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.octahedral import bin_of, coarse_bin
from lumitree.core.photometry import luminance
from lumitree.trace.ending_segments import EndingSegments, grid_cell


def cell_codes(cells: NDArray[np.integer], depth: int) -> NDArray[np.int64]:
    """Codes [C] of the cells [C, 3] of a grid with 2**depth a side."""
    side = 1 << depth
    return cells.astype(np.int64) @ [1, side, side**2]


def coded_cells(codes: NDArray[np.int64], depth: int) -> NDArray[np.int64]:
    """Cells [C, 3] of `cell_codes`."""
    side = 1 << depth
    return np.stack([codes % side, codes // side % side, codes // side**2], axis=1)


class OccupiedCells:
    """Cells of a grid over [-1, 1]³ in the order in which light was first found in them.

    Args:
        depth: the grid has 2**depth cells a side.
    """

    def __init__(self, depth: int) -> None:
        self._depth = depth
        # Row of each cell of the grid, or -1.
        self._rows = np.full(1 << 3 * depth, -1)
        self._codes = np.zeros(0, np.int64)

    def __len__(self) -> int:
        return len(self._codes)

    @property
    def coordinates(self) -> NDArray[np.int64]:
        """[C, 3] coordinates of each."""
        return coded_cells(self._codes, self._depth)

    def rows(self, positions: Any) -> NDArray[np.int64]:
        """Rows [N] of the cells of positions (mi.Point3f); new cells get new rows."""
        side = 1 << self._depth
        cell = grid_cell(positions, side)
        code = np.array((cell.z * side + cell.y) * side + cell.x).astype(np.int64)
        new = np.unique(code[self._rows[code] < 0])
        self._rows[new] = len(self._codes) + np.arange(len(new))
        self._codes = np.append(self._codes, new)
        return self._rows[code]


class _Rows:
    """An array [C, ..] of which C grows; the memory of rows to come is used when they come."""

    def __init__(self, shape: tuple[int, ...], dtype: type[np.floating]) -> None:
        self._memory: NDArray[Any] = np.zeros((0, *shape), dtype)
        self.values = self._memory

    def grown(self, count: int) -> NDArray[Any]:
        """The values, with rows of 0 up to `count`."""
        if count > len(self._memory):
            memory = np.zeros((count + count // 4, *self.values.shape[1:]), self.values.dtype)
            memory[: len(self.values)] = self.values
            self._memory = memory
        self.values = self._memory[:count]
        return self.values


class _Light:
    """Flux by cell and bin of direction."""

    def __init__(self, depth: int, resolution: int) -> None:
        self._occupied, self._resolution = OccupiedCells(depth), resolution
        self._flux = _Rows((resolution**2, 3), np.float64)

    @property
    def cells(self) -> NDArray[np.int64]:
        """[C, 3] cells that have light."""
        return self._occupied.coordinates

    @property
    def flux(self) -> NDArray[np.float64]:
        """[C, R², 3] flux of the bins of each cell."""
        return self._flux.values

    def _places(
        self, origin: Any, direction: Any
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """The flux of all bins, [C R², 3]; and of rays, their place in it and their bin, [N]."""
        rows = self._occupied.rows(origin)
        bins = np.array(self._bin(direction)).astype(np.int64)
        flat = self._flux.grown(len(self._occupied)).reshape(-1, 3)
        return flat, rows * self._resolution**2 + bins, bins

    def _bin(self, direction: Any) -> Any:
        """Bin (mi.UInt32) of a direction."""
        return bin_of(direction, self._resolution)


class Histogram(_Light):
    """Flux of rays that leave the box."""

    def add(self, origin: Any, direction: Any, flux: NDArray[np.float64]) -> NDArray[np.int64]:
        """Add rays (mi.Point3f, mi.Vector3f, [3, N]) that start inside the grid.

        Returns:
            [N] bins of their directions.
        """
        flat, index, bins = self._places(origin, direction)
        for channel in range(3):
            flat[:, channel] += np.bincount(index, flux[channel], len(flat))
        return bins


class EndingHistogram(_Light):
    """Flux of segments that end on the luminaire, by cell, bin of direction and reach.

    Each bin of direction contains four bins of a light field with 2 Q bins a side.

    A cell takes 4 (K + 5) Q² bytes: with 26 distances, 1.3 times as many as of the exitant light of
    2 Q bins a side.
    """

    def __init__(self, depth: int, resolution: int, distances: NDArray[np.float32]) -> None:
        super().__init__(depth, resolution)
        self._side, self._distances = 2 / (1 << depth), distances
        self._by_reach = _Rows((resolution**2, len(distances) - 1), np.float32)

    @property
    def by_reach(self) -> NDArray[np.float32]:
        """[C, Q², K - 1] luminance of the segments that end between two distances."""
        return self._by_reach.values

    def _bin(self, direction: Any) -> Any:
        fine = 2 * self._resolution
        return coarse_bin(bin_of(direction, fine), fine)

    def add(self, segments: EndingSegments, flux: NDArray[np.float64], seed: int) -> None:
        """Add segments with a flux [3, N]; `seed` is of where in its cell each reach begins."""
        flat, index, _ = self._places(segments.origin, segments.direction)
        for channel in range(3):
            np.add.at(flat[:, channel], index, flux[channel])
        by_reach = self._by_reach.grown(len(self._occupied))
        steps = by_reach.shape[2]
        # Light starts anywhere in its cell, and so its reach is from there on.
        random = mi.PCG32(flux.shape[1], initstate=dr.opaque(mi.UInt64, seed))
        start = mi.Vector3f(random.next_float32(), random.next_float32(), random.next_float32())
        within = (mi.Vector3f(segments.origin) + 1) / self._side
        moved = (within - dr.floor(within) - start) * self._side
        reach = np.array(
            distances_passed(segments.reach + dr.dot(moved, segments.direction), self._distances)
        )
        reach = index * steps + np.minimum(reach, steps - 1)
        np.add.at(by_reach.reshape(-1), reach, luminance(flux.T).astype(np.float32))


def distances_passed(length: Any, distances: NDArray[np.float32]) -> Any:
    """How many of some distances after the first are at most a length (mi.Float): mi.UInt32."""
    passed = mi.UInt32(0)
    for each in distances[1:].tolist():
        passed += dr.select(length >= each, mi.UInt32(1), mi.UInt32(0))
    return passed
