"""Histograms of light by the cell of a grid where it starts, and by direction."""

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.octahedral import bin_of, coarse_bin
from lumitree.core.photometry import luminance
from lumitree.trace.segments import EndingSegments, grid_cell


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

    def of_straight_light(self) -> "BinnedRays":
        """The rays that are straight light."""
        at = self.straight
        return BinnedRays(self.codes[at], self.bins[at], at[at], self.flux[:, at])


def bin_rays(
    origin: Any,
    direction: Any,
    straight: Any,
    flux: NDArray[np.floating],
    depth: int,
    resolution: int,
) -> BinnedRays:
    """Rays (mi.Point3f, mi.Vector3f, mi.Bool, [3, N]) in a grid of 2**depth cells a side."""
    return _binned(origin, bin_of(direction, resolution), straight, flux, depth)


def _binned(
    origin: Any, bins: Any, straight: Any, flux: NDArray[np.floating], depth: int
) -> BinnedRays:
    side = 1 << depth
    cell = grid_cell(origin, side)
    code = (cell.z * side + cell.y) * side + cell.x
    every = np.broadcast_to(np.array(straight, bool), flux.shape[1:])
    return BinnedRays(np.array(code, np.uint32), np.array(bins, np.uint16), every, flux)


@dataclasses.dataclass(frozen=True)
class BinnedSegments:
    """Segments that end on the luminaire.

    Attributes:
        rays: by cell and direction.
        steps: [N] index of the distance after which each ends, see `distances_passed`.
    """

    rays: BinnedRays
    steps: NDArray[np.uint8]

    def of_straight_light(self) -> "BinnedSegments":
        """The segments that are straight light."""
        return BinnedSegments(self.rays.of_straight_light(), self.steps[self.rays.straight])


def bin_segments(
    segments: EndingSegments,
    flux: NDArray[np.floating],
    depth: int,
    resolution: int,
    distances: NDArray[np.float32],
    seed: int,
) -> BinnedSegments:
    """Segments with a flux [3, N]; `seed` is of where in its cell each reach begins."""
    # Light starts anywhere in its cell, and so its reach is from there on.
    side = 2 / (1 << depth)
    random = mi.PCG32(flux.shape[1], initstate=dr.opaque(mi.UInt64, seed))
    start = mi.Vector3f(random.next_float32(), random.next_float32(), random.next_float32())
    within = (mi.Vector3f(segments.origin) + 1) / side
    moved = (within - dr.floor(within) - start) * side
    steps = np.array(
        distances_passed(segments.reach + dr.dot(moved, segments.direction), distances)
    )
    bins = coarse_bin(bin_of(segments.direction, 2 * resolution), 2 * resolution)
    rays = _binned(segments.origin, bins, segments.straight, flux, depth)
    return BinnedSegments(rays, np.minimum(steps, len(distances) - 2).astype(np.uint8))


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

    def rows(self, codes: NDArray[np.integer]) -> NDArray[np.int64]:
        """Rows [N] of cells by their codes [N]; new cells get new rows."""
        new = np.unique(codes[self._rows[codes] < 0]).astype(np.int64)
        self._rows[new] = len(self._codes) + np.arange(len(new))
        self._codes = np.append(self._codes, new)
        return self._rows[codes]


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
        self._occupied = OccupiedCells(depth)
        self._depth, self._resolution = depth, resolution
        self._flux = _Rows((resolution**2, 3), np.float64)

    @property
    def cells(self) -> NDArray[np.int64]:
        """[C, 3] cells that have light."""
        return self._occupied.coordinates

    @property
    def flux(self) -> NDArray[np.float64]:
        """[C, R², 3] flux of the bins of each cell."""
        return self._flux.values

    def flux_without(self, part: "_Light") -> NDArray[np.float64]:
        """`flux` less the flux of a part of the same rays."""
        return self._without(part, self.flux, part.flux)

    def _without(self, part: "_Light", whole: NDArray[Any], taken: NDArray[Any]) -> NDArray[Any]:
        """Values [C, ..] less values of the cells of a part."""
        rest = whole.copy()
        rows = self._occupied.rows(cell_codes(part.cells, self._depth))
        # Sums are rounded.
        rest[rows] = np.maximum(rest[rows] - taken, 0)
        return rest

    def _places(self, rays: BinnedRays) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """The flux of all bins, [C R², 3]; and of rays, their place in it, [N]."""
        rows = self._occupied.rows(rays.codes)
        flat = self._flux.grown(len(self._occupied)).reshape(-1, 3)
        return flat, rows * self._resolution**2 + rays.bins


class Histogram(_Light):
    """Flux of rays that leave the box."""

    def add(self, origin: Any, direction: Any, flux: NDArray[np.float64]) -> None:
        """Add rays (mi.Point3f, mi.Vector3f, [3, N]) that start inside the grid."""
        self.add_binned(bin_rays(origin, direction, False, flux, self._depth, self._resolution))

    def add_binned(self, rays: BinnedRays) -> None:
        """Add rays of `bin_rays` with the same grid and bins."""
        flat, index = self._places(rays)
        for channel in range(3):
            flat[:, channel] += np.bincount(index, rays.flux[channel], len(flat))


class EndingHistogram(_Light):
    """Flux of segments that end on the luminaire, by cell, bin of direction and reach.

    Each bin of direction contains four bins of a light field with 2 Q bins a side.

    A cell takes 4 (K + 5) Q² bytes: with 26 distances, 1.3 times as many as of the exitant light of
    2 Q bins a side.
    """

    def __init__(self, depth: int, resolution: int, num_distances: int) -> None:
        super().__init__(depth, resolution)
        self._by_reach = _Rows((resolution**2, num_distances - 1), np.float32)

    @property
    def by_reach(self) -> NDArray[np.float32]:
        """[C, Q², K - 1] luminance of the segments that end between two distances."""
        return self._by_reach.values

    def by_reach_without(self, part: "EndingHistogram") -> NDArray[np.float32]:
        """`by_reach` less the luminance of a part of the same segments."""
        return self._without(part, self.by_reach, part.by_reach)

    def add_binned(self, segments: BinnedSegments) -> None:
        """Add segments of `bin_segments` with the same grid, bins and distances."""
        flux = segments.rays.flux
        flat, index = self._places(segments.rays)
        for channel in range(3):
            np.add.at(flat[:, channel], index, flux[channel])
        by_reach = self._by_reach.grown(len(self._occupied))
        reach = index * by_reach.shape[2] + segments.steps
        np.add.at(by_reach.reshape(-1), reach, luminance(flux.T).astype(np.float32))


def distances_passed(length: Any, distances: NDArray[np.float32]) -> Any:
    """How many of some distances after the first are at most a length (mi.Float): mi.UInt32."""
    passed = mi.UInt32(0)
    for each in distances[1:].tolist():
        passed += dr.select(length >= each, mi.UInt32(1), mi.UInt32(0))
    return passed
