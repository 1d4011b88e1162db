"""Emission scaled until light and field agree, everywhere at once and not leaf by leaf.

The first estimate is wrong in the same way over whole regions, of which single leaves see too
little to learn it. Expectation maximisation for emission (Shepp and Vardi 1982) multiplies a
leaf's emission by the light that is ascribed to it over the light it gives, and keeps the sum of
all light. Here the ratio is taken from coarse cells to fine, each drawn to 1 by a prior, so that
cells with few paths follow their neighbours. How much few is, two halves of the rays tell by how
far they are apart.

Symbols
    N, D        light ascribed to a leaf, sum of light · w Phi / L over rays; and what it gives,
                sum of share · w Phi; n and d are those of a cell
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.harmonics import Y_00
from lumitree.direct.field import LeafField
from lumitree.direct.rays import BALANCE_BATCH, RaySource

_ROUNDS, _LINES = 4, 1 << 17
# Draws of rays that either function makes.
BALANCE_DRAWS = 2 * _ROUNDS
# The prior of a cell's ratio is as good as this many paths that agree with the field. What a path
# brings is taken from cells this many levels up: of one cell alone it is too uncertain.
_PRIOR_PATHS, _REGION = 300.0, 3
_LARGEST_SHIFT = 2.0
_TINY = 1e-30


def balance(field: LeafField, source: RaySource, max_radiance: float, batch: int = 0) -> None:
    """Scale the emission of a field's leaves, channel by channel, in place.

    Args:
        batch: number that sets the rays apart from those of other calls.
    """
    cells = [_cells(field, level) for level in range(max(_REGION, field.tree_depth) + 1)]
    for step in range(_ROUNDS):
        first, second = (
            _light(field, source, max_radiance, batch + 2 * step + half) for half in range(2)
        )
        ascribed, given, slope = first + second
        apart = first - second
        factor = np.ones_like(given)
        for (region, regions), (cell, count) in zip(cells, cells[_REGION:], strict=False):
            n, d = (_sum(values, cell, count) for values in (ascribed, given * factor))
            around = np.empty(count, np.int64)
            around[cell] = region
            # Variance over mean of n - d: of equal paths, the light of one.
            noise = _sum(_sum(apart[0] - apart[1] * factor, cell, count) ** 2, around, regions)
            path = noise / np.maximum(_sum(d, around, regions), _TINY)
            prior = _PRIOR_PATHS * path[around] + _TINY
            factor *= ((n + prior) / (d + prior))[cell]
        # To first order the shift that multiplies what the leaf gives by the factor: near L_max the
        # sigmoid hardly moves.
        shift = np.log(factor) * given / np.maximum(slope, 1e-3 * given + _TINY)
        coefficients = field.coefficient_array()
        coefficients[:, :, 0] += shift.clip(-_LARGEST_SHIFT, _LARGEST_SHIFT) / Y_00
        field.set_coefficients(coefficients)


def light_left_over(field: LeafField, source: RaySource, max_radiance: float, batch: int) -> float:
    """All light of the source over all that the field gives; 1 where either is nothing.

    Args:
        batch: as for `balance`.
    """
    seen, given = 0.0, 0.0
    for step in range(BALANCE_DRAWS):
        rays = source.draw(_LINES, BALANCE_BATCH + batch + step, _all_lines)
        radiance, _, _ = field.integrate(rays.origin, rays.direction)
        seen += float(dr.sum(rays.light, axis=None)[0]) / max_radiance
        given += float(dr.sum(rays.share * radiance, axis=None)[0])
    return seen / given if seen > 0 and given > 0 else 1.0


def _all_lines(origin: Any, direction: Any) -> Any:
    return dr.full(mi.Bool, True, dr.width(origin))


def _light(
    field: LeafField, source: RaySource, max_radiance: float, batch: int
) -> NDArray[np.float64]:
    """N, D and the derivative of D by the logit [3, M, 3]."""
    rays = source.draw(_LINES, BALANCE_BATCH + batch, field.meets)
    light = rays.light * dr.opaque(mi.Float, 1 / max_radiance)
    radiance, _, _ = field.integrate(rays.origin, rays.direction)
    ratio = light / dr.maximum(radiance, 1e-6)
    sums = dr.zeros(mi.Float, 12 * field.num_leaves)
    dr.eval(ratio)
    field.scatter_emission(rays.origin, rays.direction, ratio, rays.share, sums)
    return np.array(sums, np.float64).reshape(-1, 3, 4)[:, :, :3].transpose(1, 0, 2)


def _cells(field: LeafField, level: int) -> tuple[NDArray[np.int64], int]:
    """Index of each leaf's cell of `level`, or of its own level where that is coarser."""
    own = np.minimum(field.levels, level)
    x, y, z = (field.cells >> (field.levels - own)[:, None]).T
    # One number a cell: sorting rows takes twenty times as long.
    _, index = np.unique(((own << 16 | x) << 16 | y) << 16 | z, return_inverse=True)
    return index, int(index.max(initial=-1)) + 1


def _sum(values: Any, index: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    return np.column_stack([np.bincount(index, channel, count) for channel in values.T])
