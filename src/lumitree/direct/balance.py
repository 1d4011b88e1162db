"""Emission scaled until light and field agree, everywhere at once and not leaf by leaf.

The first estimate is wrong in the same way over whole regions, of which single leaves see too
little to learn it: as a whole, or towards one side. Expectation maximisation for emission (Shepp
and Vardi 1982) multiplies a leaf's emission by the light that is ascribed to it over the light it
gives. Here the leaves of a cell share a factor that depends on direction, 1 + sum_k x_k Y_k: the
least-squares fit to that ratio. It is found from coarse cells to fine, each for what those before
it leave, and drawn to 1 by a prior, so that cells with few paths follow their neighbours. How much
few is, two halves of the rays tell by how far they are apart.

Symbols
    N_k         light ascribed to a cell along Y_k, sum of Y_k · light · w Phi / L over rays
    M_jk        what it gives along both, sum of Y_j Y_k · share · w Phi; along Y_j, M_j0 / Y_0
    x           coefficients of the factor: (M + prior) x = N - M_0 / Y_0
"""

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device
from lumitree.core.harmonics import Y_00, num_coefficients
from lumitree.direct.field import LeafField
from lumitree.direct.rays import BALANCE_BATCH, RaySource

_ROUNDS, _LINES = 4, 1 << 17
# Draws of rays that either function makes.
BALANCE_DRAWS = 2 * _ROUNDS
# Levels of the cells: finer ones see too little, and coarser ones are most of the lamp.
_COARSEST, _FINEST = 3, 5
# Harmonics of a factor: bands 0 and 1.
_HARMONICS = 4
# The prior of a cell's factor is as good as this many paths that agree with the field. What a path
# brings is taken from cells this many levels up: of one cell alone it is too uncertain.
_PRIOR_PATHS, _REGION = 1000.0, 3
# Bounds of a round: the factor's mean over directions, and the shift before the sigmoid.
_SMALLEST_FACTOR, _LARGEST_SHIFT = 0.1, 2.0
# Least slope of the sigmoid over its value: close to L_max it hardly moves.
_SMALLEST_SLOPE = 0.1
_TINY = 1e-30


class _Light(NamedTuple):
    """N [C, 3, K] and M [C, 3, K, K] of cells, and the slope of what they give [C, 3]."""

    ascribed: NDArray[np.float64]
    given: NDArray[np.float64]
    slope: NDArray[np.float64]

    @property
    def left(self) -> NDArray[np.float64]:
        """N - M_0 / Y_0 [C, 3, K]."""
        return self.ascribed - self.given[..., 0] / Y_00

    @property
    def total(self) -> NDArray[np.float64]:
        """What is given in all directions [C, 3]."""
        return self.given[..., 0, 0] / Y_00**2


def balance(field: LeafField, source: RaySource, max_radiance: float, batch: int = 0) -> None:
    """Scale the emission of a field's leaves, channel by channel, in place.

    Args:
        batch: number that sets the rays apart from those of other calls.
    """
    levels = [_cells(field, level) for level in range(_FINEST + 1)]
    cell = levels[_FINEST]
    member = np.unique(cell, return_index=True)[1]
    above = [index[member] for index in levels]
    harmonics = min(_HARMONICS, num_coefficients(field.l_max))
    for step in range(_ROUNDS):
        first, second = (
            _light(field, source, max_radiance, batch + 2 * step + half, cell, harmonics)
            for half in range(2)
        )
        both = _Light(*(a + b for a, b in zip(first, second, strict=True)))
        factor = _factor(both, first.left[..., 0] - second.left[..., 0], above)
        mean = np.maximum(1 + Y_00 * factor[..., :1], _SMALLEST_FACTOR)
        change = np.concatenate([np.log(mean) / Y_00, factor[..., 1:] / mean], axis=-1)
        # To first order the shift before the sigmoid that does the same.
        slope = np.maximum(both.slope / (both.total + _TINY), _SMALLEST_SLOPE)
        shift = change / slope[..., None]
        # Less from round to round, so that the noise of all rounds but the first averages out.
        shift *= 1 / max(1, step)
        coefficients = field.coefficient_array()
        limit = _LARGEST_SHIFT / Y_00
        coefficients[:, :, :harmonics] += shift.clip(-limit, limit)[cell]
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


def _factor(
    light: _Light, apart: NDArray[np.float64], above: list[NDArray[np.int64]]
) -> NDArray[np.float64]:
    """x of the cells [C, 3, K], summed over the levels.

    Args:
        light: of both halves of the rays.
        apart: by how much the halves differ in Y_0 · (N_0 - D_0) [C, 3].
        above: [C] for each level, which of its cells a cell lies in.
    """
    left, factor = light.left, np.zeros_like(light.ascribed)
    for level in range(_COARSEST, _FINEST + 1):
        inside, region = above[level], above[level - _REGION]
        # Variance over mean of N - D: of equal paths, the light of one.
        around = np.zeros(inside.max(initial=-1) + 1, np.int64)
        around[inside] = region
        noise = _sum(_sum(apart / Y_00, inside) ** 2, around)
        path = noise / np.maximum(_sum(light.total, region), _TINY)
        # The mean of Y Y^T over the sphere is 1 / (4 pi) on the diagonal.
        prior = (_PRIOR_PATHS * path[around] + _TINY) / (4 * np.pi)
        matrix = _sum(light.given, inside) + prior[..., None, None] * np.eye(left.shape[-1])
        found = np.linalg.solve(matrix, _sum(left, inside)[..., None])[inside]
        left = left - (light.given @ found)[..., 0]
        factor += found[..., 0]
    return factor


def _light(
    field: LeafField,
    source: RaySource,
    max_radiance: float,
    batch: int,
    cell: NDArray[np.int64],
    harmonics: int,
) -> _Light:
    """What the cells of the leaves ([M]) are ascribed and give, by new rays."""
    rays = source.draw(_LINES, BALANCE_BATCH + batch, field.meets)
    light = rays.light * dr.opaque(mi.Float, 1 / max_radiance)
    radiance, _, _ = field.integrate(rays.origin, rays.direction)
    ratio = light / dr.maximum(radiance, 1e-6)
    dr.eval(ratio)
    sums = field.emission_moments(
        rays.origin, rays.direction, ratio, rays.share, on_device(mi.UInt32, cell), harmonics
    )
    lower = np.tril_indices(harmonics)
    ascribed, products, slope = np.split(sums, [harmonics, harmonics + len(lower[0])], axis=-1)
    given = np.zeros((*sums.shape[:2], harmonics, harmonics))
    given[..., lower[0], lower[1]] = given[..., lower[1], lower[0]] = products
    return _Light(ascribed, given, slope[..., 0])


def _cells(field: LeafField, level: int) -> NDArray[np.int64]:
    """Index of each leaf's cell of `level`, or of its own level where that is coarser."""
    own = np.minimum(field.levels, level)
    x, y, z = (field.cells >> (field.levels - own)[:, None]).T
    # One number a cell: sorting rows takes twenty times as long.
    return np.unique(((own << 16 | x) << 16 | y) << 16 | z, return_inverse=True)[1]


def _sum(values: NDArray[np.float64], index: NDArray[np.int64]) -> NDArray[np.float64]:
    """Sums [G, ...] of values [C, ...] that have the same index."""
    columns = values.reshape(len(index), -1).T
    sums = np.column_stack([np.bincount(index, column) for column in columns])
    return sums.reshape(-1, *values.shape[1:])
