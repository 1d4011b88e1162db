"""Calibration of a field's emission against the light of the luminaire, by region and side.

The first estimate has errors that whole regions share, in the mean or towards one side, and that
single leaves have too few rays to correct. Here the logits of the leaves of a cell are shifted
together by a sum of x_k Y_k: Fisher scoring on the Poisson deviance of the light. It goes from
coarse cells to fine ones, each corrects what the coarser ones leave, and x is shrunk towards 0 by a
prior, so that cells with few paths follow the coarser ones. The strength of the prior follows from
the difference between two independent halves of the rays (docs/decisions/calibration.md).

Symbols
    g           w Phi (1 - Phi), derivative of a leaf's radiance in a ray by its logit
    r_k         sum over rays and a cell's leaves of Y_k · g · (light / L - share)
    M_jk        sum of Y_j Y_k · g (1 - Phi) · share
    x           (M + prior) x = r
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter
from lumitree.core.harmonics import Y_00, num_coefficients
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.octree.config import CalibrationConfig, FluxConfig
from lumitree.fit.octree.leaf_field import LeafField, emission_moments
from lumitree.fit.octree.rays import RaySource

# Keeps the prior of a region without light above 0.
_TINY = 1e-30


def calibrate(
    field: LeafField,
    source: RaySource,
    max_radiance: float,
    config: CalibrationConfig,
    stream: SeedStream,
    over: Callable[[], bool] | None = None,
) -> None:
    """Scale the emission of a field's leaves, by channel, region and side, in place.

    Args:
        max_radiance: L_max of the field.
        stream: purpose and step of the rays; all of its draws are used.
        over: no second round begins once it returns true; every round improves the field.
    """
    levels = [_cells(field, level) for level in range(config.finest_level + 1)]
    cell = levels[config.finest_level]
    member = np.unique(cell, return_index=True)[1]
    above = [index[member] for index in levels]
    harmonics = num_coefficients(min(config.max_band, field.l_max))
    for turn in range(config.rounds):
        if turn and over is not None and over():
            return
        streams = [dataclasses.replace(stream, draw=2 * turn + half) for half in range(2)]
        halves = [
            _moments(field, source, max_radiance, config, each, cell, harmonics) for each in streams
        ]
        (first, one), (second, other) = halves
        difference = first[..., 0] - second[..., 0]
        found = _solve(first + second, one + other, difference, above, config)
        # A factor of 1 + x Y on the emission is a shift of log(1 + x Y) of its logarithm.
        mean = np.maximum(1 + Y_00 * found[..., :1], config.min_factor)
        shift = np.concatenate([np.log(mean) / Y_00, found[..., 1:] / mean], axis=-1)
        # Less from round to round, so that the noise of all rounds but the first averages out.
        shift *= 1 / max(1, turn)
        coefficients = field.coefficient_array()
        limit = config.max_shift / Y_00
        coefficients[:, :, :harmonics] += shift.clip(-limit, limit)[cell]
        field.set_coefficients(coefficients)


def _solve(
    residual: NDArray[np.float64],
    matrix: NDArray[np.float64],
    difference: NDArray[np.float64],
    above: list[NDArray[np.int64]],
    config: CalibrationConfig,
) -> NDArray[np.float64]:
    """x of the cells [C, 3, K], summed over the levels.

    Args:
        residual, matrix: r [C, 3, K] and M [C, 3, K, K] of all rays.
        difference: of r_0 between two halves of the rays [C, 3].
        above: [C] for each level, index of the cell of that level that contains a cell.
    """
    total = np.zeros_like(residual)
    for level in range(config.coarsest_level, config.finest_level + 1):
        inside, region = above[level], above[level - config.region_levels]
        # The variance over the mean is what one of many equal paths brings. The mean is of the
        # light of the luminaire: a field that is too dark shows less.
        region_of = np.zeros(inside.max(initial=-1) + 1, np.int64)
        region_of[inside] = region
        noise = _sum(_sum(difference, inside) ** 2, region_of)
        light = _sum(matrix[..., 0, 0], region)
        light = light + np.maximum(Y_00 * _sum(residual[..., 0], region), 0)
        path = noise / np.maximum(light, _TINY)
        # The mean of Y Y^T over the sphere is 1 / (4 pi) on the diagonal.
        prior = (config.prior_paths * path[region_of] + _TINY) / (4 * np.pi)
        shrunk = _sum(matrix, inside) + prior[..., None, None] * np.eye(residual.shape[-1])
        found = np.linalg.solve(shrunk, _sum(residual, inside)[..., None])[inside]
        residual = residual - (matrix @ found)[..., 0]
        total += found[..., 0]
    return total


def _moments(
    field: LeafField,
    source: RaySource,
    max_radiance: float,
    config: CalibrationConfig,
    stream: SeedStream,
    cell: NDArray[np.int64],
    harmonics: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """r [C, 3, K] and M [C, 3, K, K] of the leaves' cells ([M]), from new rays."""
    rays = source.draw(config.rays, stream, field.meets, config.light_paths_per_ray)
    if not dr.width(rays.share):
        # If rays are few, none may meet a leaf.
        shape = int(cell.max()) + 1, 3, harmonics
        return np.zeros(shape), np.zeros((*shape, harmonics))
    light = rays.light * parameter(mi.Float, 1 / max_radiance)
    radiance, _, _ = field.integrate(rays.origin, rays.direction)
    ratio = light / dr.maximum(radiance, 1e-6)
    dr.eval(ratio)
    device_cell = on_device(mi.UInt32, cell)
    sums = emission_moments(
        field, rays.origin, rays.direction, ratio, rays.share, device_cell, harmonics
    )
    residual, products = np.split(sums, [harmonics], axis=-1)
    row, column = np.tril_indices(harmonics)
    matrix = np.zeros((*sums.shape[:2], harmonics, harmonics))
    matrix[..., row, column] = matrix[..., column, row] = products
    return residual, matrix


def _cells(field: LeafField, level: int) -> NDArray[np.int64]:
    """Index of each leaf's cell of `level`, or of the leaf's level where that is coarser."""
    at = np.minimum(field.levels, level)
    x, y, z = (field.cells >> (field.levels - at)[:, None]).T
    # One number a cell: sorting rows takes twenty times as long.
    return np.unique(((at << 16 | x) << 16 | y) << 16 | z, return_inverse=True)[1]


def _sum(values: NDArray[np.float64], index: NDArray[np.int64]) -> NDArray[np.float64]:
    """Sums [G, ...] of values [C, ...] that have the same index."""
    columns = values.reshape(len(index), -1).T
    sums = np.column_stack([np.bincount(index, column) for column in columns])
    return sums.reshape(-1, *values.shape[1:]).astype(np.float64, copy=False)


class FluxCorrection(NamedTuple):
    """Factor on L_max that gives the field the total flux of the source; 1 where either is 0.

    `beyond` is the part of the source's flux that is radiance above L_max, which no field has.
    """

    factor: float
    beyond: float


def flux_correction(
    field: LeafField,
    source: RaySource,
    max_radiance: float,
    config: FluxConfig,
    step: int,
    over: Callable[[], bool] | None = None,
) -> FluxCorrection:
    """The flux correction of a field with L_max `max_radiance`, made by `step` steps of descent.

    No second draw is made once `over` returns true; with fewer draws the factor is less precise.
    """
    traced, shown, beyond = 0.0, 0.0, 0.0

    def every(origin: mi.Point3f, direction: mi.Vector3f) -> mi.Bool:
        return dr.full(mi.Bool, True, dr.width(origin))

    for draw in range(config.draws):
        if draw and over is not None and over():
            break
        stream = SeedStream(Purpose.FLUX_CORRECTION, step, draw)
        rays = source.draw(config.rays, stream, every, config.light_paths_per_ray)
        radiance, _, _ = field.integrate(rays.origin, rays.direction)
        traced += float(dr.sum(rays.light, axis=None)[0]) / max_radiance
        shown += float(dr.sum(rays.share * radiance, axis=None)[0])
        # Light paths, whose share is 0, bring light of no known radiance.
        above = rays.light * parameter(mi.Float, 1 / max_radiance) - rays.share
        seen = dr.select(rays.share > 0, dr.maximum(above, 0), 0)
        beyond += float(dr.sum(seen, axis=None)[0])
    factor = traced / shown if traced > 0 and shown > 0 else 1.0
    return FluxCorrection(factor, beyond / traced if traced > 0 else 0.0)
