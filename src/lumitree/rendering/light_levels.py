"""Levels of a light field: sums of 2 × 2 × 2 cells, for receivers that are farther away.

Level 0 is the grid of the field. A sum has the light of its cells in each bin of direction and each
channel. Its light starts in a box with the mean and the variance of the places where theirs does.

The level of a receiver depends on its distance and on a random number, so that there is no seam.

Symbols
    L   levels      C   cells of a level        R   bins of direction a side
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import LightField, unpack
from lumitree.octree.build import grid_boxes_inside, morton
from lumitree.rendering.light_table import MAX_SUMS

# Depth of the coarsest level.
_COARSEST = 2
# A level is for receivers at a distance from the lamp's box (local units) of at least `_LEAST` over
# the number of cells a side, and where the root mean square of its relative error is at most
# `_ERROR`.
_ERROR, _LEAST = 0.01, 24.0
# Errors are measured at this distance from the box, local units, as means over patches of its
# faces: so many a side, of so many points each. At single points they would be noise.
ERROR_DISTANCE, _PATCHES, POINTS = 4.0, 5, 4


@dataclasses.dataclass(frozen=True, eq=False)
class Level:
    """A light field in the cells of a grid.

    Attributes:
        cells: [C, 3] coordinates, in Morton order.
        depth: the grid has 2**depth cells a side.
        lower, upper: [C, 3] corners of the boxes in which light starts, local units.
        intensity: float32 [C, R², 3] radiant intensity, in the unit of the field's scale.
        flux: [C] luminous flux, any unit.
    """

    cells: NDArray[np.integer]
    depth: int
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    intensity: NDArray[np.float32]
    flux: NDArray[np.float64]


def light_sums(
    field: LightField, half_extents: NDArray[np.float64], flux: NDArray[np.float64]
) -> list[Level]:
    """The levels of a field beyond level 0, whose cells have the luminous flux [C]."""
    lower, upper = grid_boxes_inside(half_extents, field.cells, field.depth)
    intensity = field.dense(unpack(field.intensity).astype(np.float32))
    level, found = Level(field.cells, field.depth, lower, upper, intensity, flux), []
    while level.depth > _COARSEST and len(found) < MAX_SUMS:
        level = _summed(level, half_extents)
        found.append(level)
    return found


def _summed(level: Level, half_extents: NDArray[np.float64]) -> Level:
    first = np.flatnonzero(np.diff(morton(level.cells >> 1), prepend=-1))
    cells, depth = level.cells[first] >> 1, level.depth - 1

    def total(values):
        # As rows of numbers: sums of rows of colours take longer.
        rows = values.reshape(len(values), -1)
        return np.add.reduceat(rows, first, axis=0).reshape(-1, *values.shape[1:])

    flux, sums = level.flux[:, None], total(level.flux)
    middle, variance = (level.lower + level.upper) / 2, (level.upper - level.lower) ** 2 / 12
    mean = total(flux * middle) / sums[:, None]
    spread = total(flux * (variance + middle**2)) / sums[:, None] - mean**2
    lower, upper = grid_boxes_inside(half_extents, cells, depth)
    # The box stays within the cell, so that all of its points are in the lamp's box.
    half = np.minimum(np.sqrt(np.maximum(3 * spread, 0)), np.minimum(mean - lower, upper - mean))
    half = np.maximum(half, 5e-7)
    return Level(cells, depth, mean - half, mean + half, total(level.intensity), sums)


def level_limits(errors: NDArray[np.float64], depth: int) -> NDArray[np.float64]:
    """Distances from a lamp's box beyond which receivers get its levels beyond level 0.

    Args:
        errors: [L - 1] relative errors at the distance `ERROR_DISTANCE`, of the levels beyond 0.
        depth: of level 0.
    """
    # Errors are about in proportion to 1 / (distance + 1).
    found = errors / _ERROR * (ERROR_DISTANCE + 1) - 1
    sides = 2.0 ** np.arange(1, len(errors) + 1) / (1 << depth)
    return np.maximum.accumulate(np.maximum(found, _LEAST * sides))


def points_around(
    half_extents: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Receivers at `ERROR_DISTANCE` from a box, that face it: points and normals [.., 3].

    `POINTS` receivers that follow each other are a patch.
    """
    count = 2 * _PATCHES
    side = ((np.arange(count) + 0.5) / count * 2 - 1).reshape(-1, 2)
    places = np.broadcast_arrays(side[:, None, :, None], side[None, :, None, :])
    u, v = (each.ravel() for each in places)
    face = np.stack([np.ones_like(u), u, v], axis=1)
    unit = np.concatenate([sign * np.roll(face, axis, 1) for axis in range(3) for sign in (-1, 1)])
    normal = np.where(np.abs(unit) == 1, -unit, 0)
    return unit * (half_extents + ERROR_DISTANCE), normal
