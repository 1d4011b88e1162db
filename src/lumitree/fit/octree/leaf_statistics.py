"""Statistics of the rays that cross and terminate in each leaf, and what follows from them.

Symbols
    K   (l_max + 1)² coefficients a channel
    A   normal equations of a leaf, sum of Y Y^T over the rays that terminate in it, plus the prior
    b   sum of Y times radiance
"""

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.frames import towards_viewer
from lumitree.core.harmonics import basis, num_coefficients
from lumitree.core.transmittance import Law
from lumitree.fit.octree.config import EstimateConfig
from lumitree.fit.octree.leaf_field import OPAQUE_DEPTH
from lumitree.fit.octree.sums import ExactSum, total_of
from lumitree.fit.octree.termination import TerminatedRays
from lumitree.octree.traversal import Octree
from lumitree.trace.light_paths import LightPaths


class LeafStatistics:
    """Sums over rays for every leaf of an octree.

    Attributes:
        terminated: mi.Float [M], number of rays that terminate in the leaf.
        entered: mi.Float [M], number of rays that enter it before they terminate, or in it.
        chords: mi.Float [M], summed lengths of those rays in the leaf, local units.
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
        self._add_radiance(y, paths.flux * dr.opaque(mi.Float, scale), leaf, found)
        dr.eval(self._b)

    def _add_radiance(self, y: list[Any], radiance: Any, leaf: Any, active: Any) -> None:
        bound = total_of(dr.width(leaf), radiance)
        for index, total in enumerate(self._b):
            channel, k = divmod(index, self._count)
            self._b[index] = total + self._sum(y[k] * radiance[channel], leaf, active, bound)

    def _sum(self, value: Any, leaf: Any, active: Any, bound: float) -> Any:
        total = ExactSum(dr.width(self.terminated), bound)
        total.add(value, leaf, active)
        return total.values()

    def take(self, leaves: Any) -> "LeafStatistics":
        """The statistics of some leaves (mi.UInt32)."""
        return self._mapped(dr.width(leaves), lambda values: dr.gather(mi.Float, values, leaves))

    def sum_into(self, parents: Any, num_parents: int) -> "LeafStatistics":
        """Sums over the leaves of each parent; `parents` (mi.UInt32 [M]) is each leaf's."""

        def add_up(values):
            total = ExactSum(num_parents, total_of(dr.width(parents), values))
            total.add(values, parents)
            return total.values()

        return self._mapped(num_parents, add_up)

    def _mapped(self, num_leaves: int, function: Callable[[Any], Any]) -> "LeafStatistics":
        result = LeafStatistics(num_leaves, self._l_max, self._config)
        result.terminated, result.entered = function(self.terminated), function(self.entered)
        result.chords = function(self.chords)
        result._a = [function(values) for values in self._a]
        result._b = [function(values) for values in self._b]
        dr.eval(result.terminated, result.entered, result.chords, result._a, result._b)
        return result

    def density(self, side: float, law: Law) -> Any:
        """Density (mi.Float [M]) that gives a mean chord the measured opacity.

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

    def fit_radiance(self, prior: list[list[Any]] | None) -> list[list[Any]]:
        """Fits [3][K] of radiance by Cholesky's decomposition of each leaf's normal equations.

        Each leaf is shrunk towards the coefficients `prior` [3][K]; None for 0.
        """
        # The mean of Y Y^T over the sphere is 1 / (4 pi) on the diagonal.
        base, per_band = self._config.prior_paths, self._config.prior_band_paths
        bands = [int(np.sqrt(k)) for k in range(self._count)]
        weight = [(base + per_band * band**2) / (4 * np.pi) for band in bands]
        a = dict(zip(self._pairs, self._a, strict=True))
        lower: dict[tuple[int, int], Any] = {}
        for i in range(self._count):
            for j in range(i + 1):
                rest = a[i, j] - sum(lower[i, k] * lower[j, k] for k in range(j))
                lower[i, j] = dr.sqrt(rest + weight[i]) if i == j else rest / lower[j, j]
        solutions = []
        for channel in range(3):
            x: list[Any] = []
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
