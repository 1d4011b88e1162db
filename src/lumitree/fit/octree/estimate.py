"""The first field: an octree that grows where rays terminate, with the statistics of its leaves.

A leaf's density gives it the measured opacity: of the rays that enter it before they terminate, the
share that terminates there. Its emission is the least-squares fit of spherical harmonics to the
radiance of the rays that terminate in it, most of which is brought by light paths.

Symbols
    K   (l_max + 1)² coefficients a channel
    A   normal equations of a leaf, sum of Y Y^T over the rays that terminate in it, plus the prior
    b   sum of Y times radiance
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter
from lumitree.core.frames import halton_direction, towards_viewer
from lumitree.core.harmonics import basis, basis_array, num_coefficients
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.core.transmittance import Law
from lumitree.fit.octree.config import EstimateConfig
from lumitree.fit.octree.leaf_field import OPAQUE_DEPTH
from lumitree.fit.octree.rays import TerminatedRays, TracedRays
from lumitree.fit.octree.sums import ExactSum, total_of
from lumitree.octree.build import build_children, child_cells
from lumitree.octree.traversal import Octree
from lumitree.trace.light_paths import LightPaths

# Leaves whose emission is converted at once, by the memory it takes.
_LEAVES_AT_ONCE = 1 << 16


def grow(rays: TracedRays, level: int, config: EstimateConfig) -> NDArray[np.int64]:
    """Cells [M, 3] of a level that may be occupied: rays terminate in their parents.

    Args:
        rays: where rays come from.
        level: level of the cells.
        config: the level to start from, and how many rays to trace.
    """
    half = rays.luminaire.frame.half_extents
    current = min(config.start_level, level)
    side = 1 << current
    cells = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)
    cells = cells[inside_box(cells, current, half)]
    while current < level:
        num_rays = max(config.batch_rays, config.growth_rays >> (2 * (level - 1 - current)))
        terminated = _count_terminated(rays, cells, current, num_rays, config.batch_rays)
        cells = child_cells(cells[terminated > 0]).reshape(-1, 3)
        current += 1
        cells = cells[inside_box(cells, current, half)]
    return cells


def inside_box(
    cells: NDArray[np.int64], level: int, half_extents: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether cells [M, 3] reach into the proxy box."""
    side = 2 / (1 << level)
    low = cells * side - 1
    return np.all((low < half_extents) & (low + side > -half_extents), axis=1)


def octree_of(cells: NDArray[np.int64], level: int, half_extents: NDArray[np.float64]) -> Octree:
    """An octree whose leaves are cells [M, 3] of one level."""
    return Octree(build_children(cells, np.full(len(cells), level)), level, half_extents)


def _count_terminated(
    rays: TracedRays, cells: NDArray[np.int64], level: int, num_rays: int, batch_rays: int
) -> NDArray[np.float32]:
    """How many of some random rays terminate in each cell [M]."""
    octree = octree_of(cells, level, rays.luminaire.frame.half_extents)
    count = dr.zeros(mi.Float, len(cells))
    for batch in range(-(-num_rays // batch_rays)):
        drawn = rays.draw_terminated(batch_rays, SeedStream(Purpose.GROWTH, level, batch))
        leaf, found = octree.find_leaf(drawn.point, drawn.terminated)
        dr.scatter_add(count, mi.Float(1), leaf, found)
        dr.eval(count)
    return np.array(count)


class LeafStatistics:
    """Sums over rays for every leaf of an octree.

    Attributes:
        terminated: [M], number of rays that terminate in the leaf.
        entered: [M], number of rays that enter it before they terminate, or in it.
        chords: [M], summed lengths of those rays in the leaf, local units.
    """

    def __init__(self, num_leaves: int, l_max: int, config: EstimateConfig) -> None:
        self._l_max, self._config = l_max, config
        self._count = num_coefficients(l_max)
        self._pairs = [(i, j) for i in range(self._count) for j in range(i + 1)]
        self.terminated = dr.zeros(mi.Float, num_leaves)
        self.entered = dr.zeros(mi.Float, num_leaves)
        self.chords = dr.zeros(mi.Float, num_leaves)
        self._a = [dr.zeros(mi.Float, num_leaves) for _ in self._pairs]
        self._b = [dr.zeros(mi.Float, num_leaves) for _ in range(3 * self._count)]

    def add_rays(self, octree: Octree, rays: TerminatedRays) -> None:
        """Add rays."""
        last, found = octree.find_leaf(rays.point, rays.terminated)
        dr.scatter_add(self.terminated, mi.Float(1), last, found)
        y = basis(*towards_viewer(rays.direction), l_max=self._l_max)
        num_rays = dr.width(rays.origin)
        self._a = [
            total + self._sum(y[i] * y[j], last, found, num_rays)
            for total, (i, j) in zip(self._a, self._pairs, strict=True)
        ]
        self._add_radiance(y, rays.radiance, last, found)

        end = dr.select(rays.terminated, dr.dot(rays.point - rays.origin, rays.direction), dr.inf)
        # No chord of a cube of side 2 is as long as 4.
        chords = ExactSum(dr.width(self.chords), 4.0 * num_rays)

        def visit(state, leaf, start, length, active):
            # The leaf of the termination point is entered, and none behind it.
            terminates_here = found & (leaf == last)
            enters = active & (length > 0) & (terminates_here | (start + length < end))
            dr.scatter_add(self.entered, mi.Float(1), leaf, enters)
            chords.add(length, leaf, enters)
            return state, start + length < end

        octree.traverse(rays.origin, rays.direction, mi.Bool(True), visit, (mi.Float(0),))
        self.chords += chords.values()
        dr.eval(self.terminated, self.entered, self.chords, self._a, self._b)

    def add_light_paths(self, octree: Octree, paths: LightPaths, scale: float) -> None:
        """Add the flux of light paths, times `scale`."""
        leaf, found = octree.find_leaf(paths.termination)
        # Light travels towards the viewer.
        y = basis(*paths.direction, l_max=self._l_max)
        self._add_radiance(y, paths.flux * parameter(mi.Float, scale), leaf, found)
        dr.eval(self._b)

    def _add_radiance(
        self, y: list[mi.Float], radiance: mi.Color3f, leaf: mi.UInt32, active: mi.Bool
    ) -> None:
        bound = total_of(dr.width(leaf), radiance)
        for index, total in enumerate(self._b):
            channel, k = divmod(index, self._count)
            self._b[index] = total + self._sum(y[k] * radiance[channel], leaf, active, bound)

    def _sum(self, value: mi.Float, leaf: mi.UInt32, active: mi.Bool, bound: float) -> mi.Float:
        total = ExactSum(dr.width(self.terminated), bound)
        total.add(value, leaf, active)
        return total.values()

    def take(self, leaves: mi.UInt32) -> LeafStatistics:
        """The statistics of some leaves."""
        return self._mapped(dr.width(leaves), lambda values: dr.gather(mi.Float, values, leaves))

    def sum_into(self, parents: mi.UInt32, num_parents: int) -> LeafStatistics:
        """Sums over the leaves of each parent; `parents` [M] is each leaf's."""

        def add_up(values):
            total = ExactSum(num_parents, total_of(dr.width(parents), values))
            total.add(values, parents)
            return total.values()

        return self._mapped(num_parents, add_up)

    def _mapped(self, num_leaves: int, function: Callable[[mi.Float], mi.Float]) -> LeafStatistics:
        result = LeafStatistics(num_leaves, self._l_max, self._config)
        result.terminated, result.entered = function(self.terminated), function(self.entered)
        result.chords = function(self.chords)
        result._a = [function(values) for values in self._a]
        result._b = [function(values) for values in self._b]
        dr.eval(result.terminated, result.entered, result.chords, result._a, result._b)
        return result

    def density(self, side: float, law: Law) -> mi.Float:
        """Density [M] that gives a mean chord the measured opacity.

        Leaves that no ray enters are opaque.

        Args:
            side: of a leaf, local units.
            law: transmittance law that the density is for.
        """
        opacity = self.terminated / dr.maximum(self.entered, 1)
        chord = self.chords / dr.maximum(self.entered, 1)
        depth = opacity if law == "linear" else -dr.log(dr.maximum(1 - opacity, 1e-6))
        rate = dr.minimum(depth / dr.maximum(chord, 1e-3 * side), OPAQUE_DEPTH / side)
        opaque = (self.entered == 0) | (opacity > self._config.opaque_from)
        return dr.select(opaque, OPAQUE_DEPTH / side, rate)

    def fit_radiance(self, prior: list[list[mi.Float]] | None) -> list[list[mi.Float]]:
        """Fits [3][K] of radiance by Cholesky's decomposition of each leaf's normal equations.

        Each leaf is shrunk towards the coefficients `prior` [3][K]; None for 0.
        """
        # The mean of Y Y^T over the sphere is 1 / (4 pi) on the diagonal.
        base, per_band = self._config.prior_paths, self._config.prior_band_paths
        bands = [int(np.sqrt(k)) for k in range(self._count)]
        weight = [(base + per_band * band**2) / (4 * np.pi) for band in bands]
        a = dict(zip(self._pairs, self._a, strict=True))
        lower: dict[tuple[int, int], mi.Float] = {}
        for i in range(self._count):
            for j in range(i + 1):
                rest = a[i, j] - sum(lower[i, k] * lower[j, k] for k in range(j))
                lower[i, j] = dr.sqrt(rest + weight[i]) if i == j else rest / lower[j, j]
        solutions = []
        for channel in range(3):
            x: list[mi.Float] = []
            for i in range(self._count):
                b = self._b[channel * self._count + i]
                if prior is not None:
                    b = b + weight[i] * prior[channel][i]
                x.append((b - sum(lower[i, k] * x[k] for k in range(i))) / lower[i, i])
            for i in reversed(range(self._count)):
                rest = sum(lower[k, i] * x[k] for k in range(i + 1, self._count))
                x[i] = (x[i] - rest) / lower[i, i]
            solutions.append(x)
        dr.eval(solutions)
        return solutions


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Leaves of one level: cells [M, 3], density [M] per local unit, coefficients [M, 3, K]."""

    cells: NDArray[np.int64]
    density: NDArray[np.float32]
    coefficients: NDArray[np.float32]


def estimate(
    rays: TracedRays,
    cells: NDArray[np.int64],
    level: int,
    l_max: int,
    law: Law,
    max_radiance: float,
    config: EstimateConfig,
) -> Estimate:
    """Density and coefficients of the cells in which rays terminate, or which none enters.

    Args:
        rays: where rays come from.
        cells: [M, 3] of one level.
        level: that level.
        l_max: highest band of the coefficients.
        law: transmittance law that the density is for.
        max_radiance: L_max, radiance units of the luminaire's scene.
        config: how many rays, and the priors.
    """
    octree = octree_of(cells, level, rays.luminaire.frame.half_extents)
    statistics = LeafStatistics(len(cells), l_max, config)
    size = config.batch_rays
    for batch in range(-(-config.rays // size)):
        stream = SeedStream(Purpose.ESTIMATE, batch)
        statistics.add_rays(octree, rays.draw_terminated(size, stream))
        # Flux in units of the radiance of one ray.
        paths = rays.light_paths(max(1, round(config.light_paths_per_ray * size)), stream)
        statistics.add_light_paths(octree, paths, size / rays.measure)
    # A cell that no ray enters is inside of something: it is kept, and made opaque.
    kept = dr.compress((statistics.terminated > 0) | (statistics.entered == 0))
    cells = cells[np.array(kept)]
    statistics = statistics.take(kept)
    fit = statistics.fit_radiance(_parent_fits(statistics, cells, level, config.start_level))
    return Estimate(
        cells,
        np.array(statistics.density(2 / (1 << level), law)),
        _coefficients_of_logits(fit, l_max, max_radiance, config),
    )


def _parent_fits(
    statistics: LeafStatistics, cells: NDArray[np.int64], level: int, start_level: int
) -> list[list[mi.Float]] | None:
    """Fits [3][K] of the cells' parents, gathered for every cell; None up to the start level."""
    if level <= start_level:
        return None
    parents, index = np.unique(cells >> 1, axis=0, return_inverse=True)
    index = on_device(mi.UInt32, index)
    above = statistics.sum_into(index, len(parents))
    fit = above.fit_radiance(_parent_fits(above, parents, level - 1, start_level))
    return [[dr.gather(mi.Float, value, index) for value in channel] for channel in fit]


def _coefficients_of_logits(
    fit: list[list[mi.Float]], l_max: int, max_radiance: float, config: EstimateConfig
) -> NDArray[np.float32]:
    """Coefficients [M, 3, K] whose sigmoid follows a fit of radiance [3][K]."""
    directions = [halton_direction(i + 1) for i in range(config.logit_directions)]
    values = basis_array(np.array(directions), l_max)
    inverse = np.linalg.pinv(values)
    leaves = dr.width(fit[0][0])
    result = np.empty((leaves, 3, values.shape[1]), np.float32)
    for channel, linear in enumerate(fit):
        rows = np.stack([np.broadcast_to(np.array(each), leaves) for each in linear])
        for first in range(0, leaves, _LEAVES_AT_ONCE):
            some = slice(first, first + _LEAVES_AT_ONCE)
            # Not by BLAS, whose sums depend on its threads.
            radiance = np.einsum("dk,km->dm", values, rows[:, some])
            emission = np.clip(radiance / max_radiance, config.min_emission, config.max_emission)
            logit = np.log(emission / (1 - emission))
            result[some, channel] = np.einsum("kd,dm->mk", inverse, logit)
    return result
