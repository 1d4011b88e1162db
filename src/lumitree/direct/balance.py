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

from lumitree.asset.model import MAX_TREE_DEPTH
from lumitree.core.harmonics import Y_00
from lumitree.direct.field import LeafField
from lumitree.direct.rays import BALANCE_BATCH, RaySource

BALANCE_ROUNDS, _LINES = 4, 1 << 18
# The prior of a cell's ratio is as good as this many paths that agree with the field.
_PRIOR_PATHS = 30.0
_COARSEST_LEVEL = 3
_LARGEST_SHIFT = 2.0


def balance(
    field: LeafField,
    source: RaySource,
    max_radiance: float,
    batch: int = 0,
    finest_level: int = MAX_TREE_DEPTH,
) -> None:
    """Scale the emission of a field's leaves, channel by channel, in place.

    Args:
        batch: number that sets the rays apart from those of other calls.
        finest_level: cells below this level follow those above; few rays tell less of small ones
            than a descent has learned.
    """
    levels = range(_COARSEST_LEVEL, min(finest_level, field.tree_depth) + 1)
    parents = [_parents(field, level) for level in levels]
    for step in range(BALANCE_ROUNDS):
        sums, path = _light(field, source, max_radiance, BALANCE_BATCH + batch + step)
        ascribed, given, slope = sums
        factor = np.ones_like(given)
        prior = _PRIOR_PATHS * path
        for index, count in parents:
            n, d = (_sum(values, index, count) for values in (ascribed, given * factor))
            factor *= ((n + prior) / (d + prior))[index]
        # To first order the shift that multiplies what the leaf gives by the factor: near L_max the
        # sigmoid hardly moves.
        shift = np.log(factor) * given / np.maximum(slope, 1e-3 * given + 1e-30)
        coefficients = field.coefficient_array()
        coefficients[:, :, 0] += shift.clip(-_LARGEST_SHIFT, _LARGEST_SHIFT) / Y_00
        field.set_coefficients(coefficients)


def light_left_over(field: LeafField, source: RaySource, max_radiance: float, batch: int) -> float:
    """All light of the source over all that the field gives; 1 where either is nothing.

    Args:
        batch: as for `balance`.
    """
    seen, given = 0.0, 0.0
    for step in range(BALANCE_ROUNDS):
        rays = source.draw(_LINES, BALANCE_BATCH + batch + step, _all_lines)
        radiance, _, _ = field.integrate(rays.origin, rays.direction)
        seen += float(dr.sum(rays.light, axis=None)[0]) / max_radiance
        given += float(dr.sum(rays.share * radiance, axis=None)[0])
    return seen / given if seen > 0 and given > 0 else 1.0


def _all_lines(origin: Any, direction: Any) -> Any:
    return dr.full(mi.Bool, True, dr.width(origin))


def _light(
    field: LeafField, source: RaySource, max_radiance: float, batch: int
) -> tuple[NDArray[np.float64], float]:
    """N, D and the derivative of D by the logit [3, M, 3], and the light of a typical path."""
    rays = source.draw(_LINES, batch, field.meets)
    light = rays.light * dr.opaque(mi.Float, 1 / max_radiance)
    radiance, _, _ = field.integrate(rays.origin, rays.direction)
    ratio = light / dr.maximum(radiance, 1e-6)
    sums = dr.zeros(mi.Float, 12 * field.num_leaves)
    dr.eval(ratio)
    field.scatter_emission(rays.origin, rays.direction, ratio, rays.share, sums)
    rows = np.array(sums, np.float64).reshape(-1, 3, 4)[:, :, :3]
    carried = np.array(light)
    return rows.transpose(1, 0, 2), float(carried.sum() / max(1, np.count_nonzero(carried)))


def _parents(field: LeafField, level: int) -> tuple[NDArray[np.int64], int]:
    """Index of each leaf's cell of `level`, or of its own level where that is coarser."""
    shift = np.maximum(field.levels - level, 0)
    keys = np.column_stack([field.cells >> shift[:, None], field.levels - shift])
    cells, index = np.unique(keys, axis=0, return_inverse=True)
    return index.ravel(), len(cells)


def _sum(values: Any, index: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    return np.column_stack([np.bincount(index, channel, count) for channel in values.T])
