"""The first octree, from statistics of random rays: where light stops, and what is seen there.

A leaf's density gives it the opacity that was seen: of the lines that enter it before their stop,
the share that stops there. Its emission is the least-squares fit of spherical harmonics to the
radiance of the paths that stop in it, most of which is brought by paths from the emitters.

The tree grows coarse to fine: the leaves of a level that stop any path are split for the next.

Symbols
    K   (l_max + 1)² coefficients a channel
    A   normal equations of a leaf, sum of Y Y^T over its stops, plus the regularisation
    b   sum of Y times radiance
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device
from lumitree.core.directions import halton_direction
from lumitree.core.frames import towards_viewer
from lumitree.core.harmonics import basis, basis_array, num_coefficients
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.core.transmittance import Law
from lumitree.direct.ray_source import Stops, TracedRays
from lumitree.direct.sums import ExactSum, total_of
from lumitree.octree.build import build_children
from lumitree.octree.traversal import Octree
from lumitree.transport.light_paths import LightPaths

_START_LEVEL = 5
# Lines in flight at once; bounds memory.
_BATCH = 1 << 20
# Directions at which a leaf's linear fit is turned into coefficients before the sigmoid.
_NUM_DIRECTIONS = 32
# Fitted radiance is kept within these bounds, in units of L_max, where the sigmoid can follow.
_DARKEST, _BRIGHTEST = 1e-5, 0.99
# A leaf's fit is drawn to its parent's, or to black where it has none, as if by this many paths
# that saw the parent's fit, and band l by l² times the second number more.
_PRIOR_PATHS, _PRIOR_BAND = 20.0, 200.0
# Optical depth across a leaf that counts as opaque, and the opacity from which a leaf is.
OPAQUE = 10.0
_SOLID = 0.9


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Leaves of one level: cells [M, 3], density [M] per local unit, coefficients [M, 3, K]."""

    cells: NDArray[np.int64]
    density: NDArray[np.float32]
    coefficients: NDArray[np.float32]


def grow(rays: TracedRays, tree_depth: int, lines_a_level: int) -> NDArray[np.int64]:
    """Cells [M, 3] of level `tree_depth` that may hold something: those whose parents stop paths.

    Args:
        rays: where lines come from.
        tree_depth: level of the cells.
        lines_a_level: lines traced to judge the cells of the last level but one; earlier levels
            have fewer cells and get fewer.
    """
    half = rays.luminaire.half_extents
    level = min(_START_LEVEL, tree_depth)
    side = 1 << level
    cells = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)
    cells = cells[inside_box(cells, level, half)]
    while level < tree_depth:
        octree = _tree(cells, level, half)
        lines = max(_BATCH, lines_a_level >> (2 * (tree_depth - 1 - level)))
        stops = _count_stops(rays, octree, len(cells), lines, level)
        cells = split(cells[stops > 0])
        level += 1
        cells = cells[inside_box(cells, level, half)]
    return cells


def split(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """The eight children [8 M, 3] of every cell [M, 3], in octant order."""
    octants = np.array([(octant & 1, octant >> 1 & 1, octant >> 2) for octant in range(8)])
    return (2 * cells[:, None] + octants).reshape(-1, 3)


def estimate(
    rays: TracedRays,
    cells: NDArray[np.int64],
    tree_depth: int,
    l_max: int,
    law: Law,
    max_radiance: float,
    num_lines: int,
) -> Estimate:
    """Density and coefficients of the cells in which paths stop.

    Args:
        rays: where lines come from.
        cells: [M, 3] of level `tree_depth`.
        law: transmittance law that the density is for.
        max_radiance: L_max, radiance units of the luminaire's scene.
        num_lines: lines traced.
    """
    half = rays.luminaire.half_extents
    octree = _tree(cells, tree_depth, half)
    sums = _Sums(len(cells), l_max)
    for batch in range(-(-num_lines // _BATCH)):
        stream = SeedStream(Purpose.ESTIMATE, batch)
        sums.add(octree, rays.stops(_BATCH, stream))
        # Flux in units of the radiance of one of the lines.
        sums.add_light(octree, rays.light(_BATCH // 2, stream), _BATCH / rays.measure)
    # What no path crosses lies inside something: it is kept too, and made opaque.
    kept = dr.compress((sums.stops > 0) | (sums.entries == 0))
    cells = cells[np.array(kept)]
    sums = sums.take(kept)
    fit = sums.solve(_parents(sums, cells, tree_depth))
    return Estimate(
        cells,
        np.array(sums.density(2 / (1 << tree_depth), law)),
        np.array(_before_sigmoid(fit, l_max, max_radiance)).reshape(-1, 3, num_coefficients(l_max)),
    )


def _parents(sums: "_Sums", cells: NDArray[np.int64], level: int) -> list[list[Any]] | None:
    """Fits of the cells' parents, gathered for every cell; None above the start level."""
    if level <= _START_LEVEL:
        return None
    parents, index = np.unique(cells >> 1, axis=0, return_inverse=True)
    index = on_device(mi.UInt32, index)
    above = sums.sum_into(index, len(parents))
    fit = above.solve(_parents(above, parents, level - 1))
    return [[dr.gather(mi.Float, value, index) for value in channel] for channel in fit]


def inside_box(
    cells: NDArray[np.int64], level: int, half_extents: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether cells [M, 3] reach into the proxy box."""
    side = 2 / (1 << level)
    low = cells * side - 1
    return ((low < half_extents) & (low + side > -half_extents)).all(axis=1)


def _tree(cells: NDArray[np.int64], level: int, half_extents: NDArray[np.float64]) -> Octree:
    return Octree(build_children(cells, np.full(len(cells), level)), level, half_extents)


def _count_stops(
    rays: TracedRays, octree: Octree, num_cells: int, lines: int, level: int
) -> NDArray[np.float32]:
    count = dr.zeros(mi.Float, num_cells)
    for batch in range(-(-lines // _BATCH)):
        stops = rays.stops(_BATCH, SeedStream(Purpose.GROWTH, level, batch))
        leaf, found = octree.find_leaf(stops.point, stops.stopped)
        dr.scatter_add(count, mi.Float(1), leaf, found)
        dr.eval(count)
    return np.array(count)


class _Sums:
    """Statistics of every leaf: stops, entries, chords, and the normal equations of its fit."""

    def __init__(self, num_leaves: int, l_max: int) -> None:
        self.l_max = l_max
        self._count = num_coefficients(l_max)
        self._pairs = [(i, j) for i in range(self._count) for j in range(i + 1)]
        self.stops = dr.zeros(mi.Float, num_leaves)
        self.entries = dr.zeros(mi.Float, num_leaves)
        self.chords = dr.zeros(mi.Float, num_leaves)
        self._a = [dr.zeros(mi.Float, num_leaves) for _ in self._pairs]
        self._b = [dr.zeros(mi.Float, num_leaves) for _ in range(3 * self._count)]

    def add(self, octree: Octree, stops: Stops) -> None:
        """Count lines in."""
        stop, found = octree.find_leaf(stops.point, stops.stopped)
        dr.scatter_add(self.stops, mi.Float(1), stop, found)
        y = basis(*towards_viewer(stops.direction), self.l_max)
        lines = dr.width(stops.origin)
        self._a = [
            total + self._sum(y[i] * y[j], stop, found, lines)
            for total, (i, j) in zip(self._a, self._pairs, strict=True)
        ]
        self._add_radiance(y, stops.radiance, stop, found)

        end = dr.select(stops.stopped, dr.dot(stops.point - stops.origin, stops.direction), dr.inf)
        # No chord of a cube of side 2 is as long as 4.
        chords = ExactSum(dr.width(self.chords), 4.0 * lines)

        def visit(state, leaf, start, length, active):
            # A leaf that holds the stop is entered; what lies behind it is not seen.
            stops_here = found & (leaf == stop)
            enters = active & (length > 0) & (stops_here | (start + length < end))
            dr.scatter_add(self.entries, mi.Float(1), leaf, enters)
            chords.add(length, leaf, enters)
            return state, start + length < end

        octree.walk(stops.origin, stops.direction, mi.Bool(True), visit, (mi.Float(0),))
        self.chords += chords.values()
        dr.eval(self.stops, self.entries, self.chords, self._a, self._b)

    def add_light(self, octree: Octree, paths: LightPaths, scale: float) -> None:
        """Count light in, its flux times `scale`."""
        leaf, found = octree.find_leaf(paths.stop)
        y = basis(*towards_viewer(paths.direction), self.l_max)
        self._add_radiance(y, paths.flux * dr.opaque(mi.Float, scale), leaf, found)
        dr.eval(self._b)

    def _add_radiance(self, y: list[Any], radiance: Any, leaf: Any, active: Any) -> None:
        bound = total_of(dr.width(leaf), radiance)
        for index, total in enumerate(self._b):
            channel, k = divmod(index, self._count)
            self._b[index] = total + self._sum(y[k] * radiance[channel], leaf, active, bound)

    def _sum(self, value: Any, leaf: Any, active: Any, bound: float) -> Any:
        total = ExactSum(dr.width(self.stops), bound)
        total.add(value, leaf, active)
        return total.values()

    def take(self, leaves: Any) -> "_Sums":
        """Those of some leaves."""
        return self._mapped(dr.width(leaves), lambda values: dr.gather(mi.Float, values, leaves))

    def sum_into(self, parents: Any, num_parents: int) -> "_Sums":
        """Sums over the leaves of each parent; `parents` is each leaf's."""

        def add_up(values):
            total = ExactSum(num_parents, total_of(dr.width(parents), values))
            total.add(values, parents)
            return total.values()

        return self._mapped(num_parents, add_up)

    def _mapped(self, num_leaves: int, function: Callable[[Any], Any]) -> "_Sums":
        result = _Sums(num_leaves, self.l_max)
        result.stops, result.entries = function(self.stops), function(self.entries)
        result.chords = function(self.chords)
        result._a = [function(values) for values in self._a]
        result._b = [function(values) for values in self._b]
        dr.eval(result.stops, result.entries, result.chords, result._a, result._b)
        return result

    def density(self, side: float, law: Law) -> Any:
        """Density that gives a mean chord the opacity seen; `OPAQUE` where no path enters."""
        opacity = self.stops / dr.maximum(self.entries, 1)
        chord = self.chords / dr.maximum(self.entries, 1)
        depth = opacity if law == "linear" else -dr.log(dr.maximum(1 - opacity, 1e-6))
        rate = dr.minimum(depth / dr.maximum(chord, 1e-3 * side), OPAQUE / side)
        solid = (self.entries == 0) | (opacity > _SOLID)
        return dr.select(solid, OPAQUE / side, rate)

    def solve(self, prior: list[list[Any]] | None) -> list[list[Any]]:
        """Fits [3][K] of radiance by Cholesky's decomposition of each leaf's normal equations.

        Args:
            prior: [3][K] coefficients each leaf is drawn to; None for 0.
        """
        # The mean of Y Y^T over the sphere is 1 / (4 pi) on the diagonal.
        bands = [int(np.sqrt(k)) for k in range(self._count)]
        pull = [(_PRIOR_PATHS + _PRIOR_BAND * band**2) / (4 * np.pi) for band in bands]
        a = dict(zip(self._pairs, self._a, strict=True))
        lower: dict[tuple[int, int], Any] = {}
        for i in range(self._count):
            for j in range(i + 1):
                rest = a[i, j] - sum(lower[i, k] * lower[j, k] for k in range(j))
                lower[i, j] = dr.sqrt(rest + pull[i]) if i == j else rest / lower[j, j]
        solutions = []
        for channel in range(3):
            x: list[Any] = []
            for i in range(self._count):
                b = self._b[channel * self._count + i]
                if prior is not None:
                    b = b + pull[i] * prior[channel][i]
                x.append((b - sum(lower[i, k] * x[k] for k in range(i))) / lower[i, i])
            for i in reversed(range(self._count)):
                rest = sum(lower[k, i] * x[k] for k in range(i + 1, self._count))
                x[i] = (x[i] - rest) / lower[i, i]
            solutions.append(x)
        dr.eval(solutions)
        return solutions


def _before_sigmoid(fit: list[list[Any]], l_max: int, max_radiance: float) -> Any:
    """Coefficients [M · 3 · K] whose sigmoid follows a fit of radiance [3][K]."""
    directions = np.array([halton_direction(i + 1) for i in range(_NUM_DIRECTIONS)])
    values = basis_array(directions, l_max)
    back = np.linalg.pinv(values)
    count, leaves = values.shape[1], dr.width(fit[0][0])
    result = dr.zeros(mi.Float, leaves * 3 * count)
    row = dr.arange(mi.UInt32, leaves) * (3 * count)
    for channel, linear in enumerate(fit):
        before = [mi.Float(0)] * count
        for direction in range(_NUM_DIRECTIONS):
            radiance = sum(linear[k] * float(values[direction, k]) for k in range(count))
            x = dr.clip(radiance / max_radiance, _DARKEST, _BRIGHTEST)
            logit = dr.log(x / (1 - x))
            before = [before[k] + float(back[k, direction]) * logit for k in range(count)]
        for k in range(count):
            dr.scatter(result, before[k], row + (channel * count + k))
    dr.eval(result)
    return result
