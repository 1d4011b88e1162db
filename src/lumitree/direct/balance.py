"""Emission scaled until light and field agree, everywhere at once and not leaf by leaf.

The first estimate is wrong in the same way over whole regions, of which single leaves see too
little to learn it. Expectation maximisation for emission (Shepp and Vardi 1982) multiplies a
leaf's emission by the light that is ascribed to it over the light it gives, and keeps the sum of
all light. Here the ratio is taken from coarse cells to fine, each drawn to 1 by a prior, so that
cells with few paths follow their neighbours.

Symbols
    N, D        light ascribed to a leaf, sum of light · w Phi / L over rays; and what it gives,
                sum of share · w Phi
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.harmonics import basis_array
from lumitree.direct.field import LeafField
from lumitree.direct.rays import BALANCE_BATCH, RaySource

_ROUNDS, _LINES = 4, 1 << 18
# The prior of a cell's ratio is as good as this many paths that agree with the field.
_PRIOR_PATHS = 8.0
_COARSEST_LEVEL = 3
_BRIGHTEST = 0.995


def balance(field: LeafField, source: RaySource, max_radiance: float, batch: int = 0) -> None:
    """Scale the emission of a field's leaves, channel by channel, in place.

    Args:
        batch: number that sets the rays apart from those of other calls.
    """
    constant = float(basis_array(np.array([[0.0, 0.0, 1.0]]), 0)[0, 0])
    parents = [_parents(field, level) for level in range(_COARSEST_LEVEL, field.tree_depth + 1)]
    for step in range(_ROUNDS):
        ascribed, given, path = _light(field, source, max_radiance, BALANCE_BATCH + batch + step)
        factor = np.ones_like(given)
        prior = _PRIOR_PATHS * path
        for index, count in parents:
            n, d = (_sum(values, index, count) for values in (ascribed, given * factor))
            factor *= ((n + prior) / (d + prior))[index]
        coefficients = field.coefficient_array()
        # The sigmoid of the mean over directions is to become that many times as large.
        emission = 1 / (1 + np.exp(-constant * coefficients[:, :, 0].astype(np.float64)))
        wanted = np.clip(emission * factor, 1e-6, _BRIGHTEST)
        coefficients[:, :, 0] += (_logit(wanted) - _logit(emission.clip(1e-6, 1 - 1e-6))) / constant
        field.set_coefficients(coefficients)


def _logit(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.log(values / (1 - values))


def _light(
    field: LeafField, source: RaySource, max_radiance: float, batch: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """N and D [M, 3], and the light of a typical path."""
    rays = source.draw(_LINES, batch, field.meets)
    light = rays.light * dr.opaque(mi.Float, 1 / max_radiance)
    radiance, _, _ = field.integrate(rays.origin, rays.direction)
    sums = []
    for value in (light / dr.maximum(radiance, 1e-6), mi.Color3f(rays.share)):
        total = dr.zeros(mi.Float, 4 * field.num_leaves)
        dr.eval(value)
        field.scatter_emission(rays.origin, rays.direction, value, total)
        sums.append(np.array(total, np.float64).reshape(-1, 4)[:, :3])
    carried = np.array(light)
    return sums[0], sums[1], float(carried.sum() / max(1, np.count_nonzero(carried)))


def _parents(field: LeafField, level: int) -> tuple[NDArray[np.int64], int]:
    """Index of each leaf's cell of `level`, or of its own level where that is coarser."""
    shift = np.maximum(field.levels - level, 0)
    keys = np.column_stack([field.cells >> shift[:, None], field.levels - shift])
    cells, index = np.unique(keys, axis=0, return_inverse=True)
    return index.ravel(), len(cells)


def _sum(values: Any, index: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    return np.column_stack([np.bincount(index, channel, count) for channel in values.T])
