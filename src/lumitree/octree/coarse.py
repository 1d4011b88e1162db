"""A field of few leaves that transmits as much light as a deep one, for shadows.

Shadows need less detail than images, and a traversal of fewer leaves takes less time. What a cell
transmits is not the transmittance of its mean density: thin parts hide less than the same density
spread over the cell. So a cell gets the density with which it transmits what it does on average.
"""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lumitree.core.frames import LocalFrame
from lumitree.core.transmittance import Law, transmittance
from lumitree.octree.build import build_children
from lumitree.octree.leaves import leaf_cells

if TYPE_CHECKING:
    from lumitree.octree.field_data import FieldData

# Depth of the coarse field, and levels below it whose detail is averaged.
COARSE_DEPTH, _FINE_LEVELS = 5, 3
# A cell transmits at least this part of the light, so that its density is finite.
_LEAST = 1e-4
# Halvings of the range of a density, and local units that no side is below.
_BISECTIONS, _TINY = 40, 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class CoarseField:
    """Density alone, as `FieldData`: it emits nothing."""

    children: NDArray[np.int32]
    density: NDArray[np.float32]
    frame: LocalFrame
    luminaire: str
    tree_depth: int = COARSE_DEPTH
    law: Law = "exponential"
    l_max: int = 0
    max_radiance: float = 0.0
    light_factors: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def num_leaves(self) -> int:
        """Number of leaves, M."""
        return len(self.density)

    @property
    def coefficients(self) -> NDArray[np.float16]:
        """float16 [M, 3, 1] of zeros."""
        return np.zeros((self.num_leaves, 3, 1), np.float16)


def coarsened(asset: "FieldData", min_density: float = 0.0) -> CoarseField:
    """Field of depth `COARSE_DEPTH` with about the same mean transmittance.

    A cell that has leaves of the given field gets the density with which it transmits as much light
    along x, y and z together, by the area of the cell across each, as the leaves do on average. Of
    a cell that a face of the bounding box divides the part inside counts, to which rays are
    clipped. The law of the result is the exponential one, whatever the law of the given field.

    Args:
        asset: a field.
        min_density: leaves below this density (per local unit) count as empty.
    """
    cells, levels = leaf_cells(asset.children, asset.num_leaves)
    density = np.where(asset.density < min_density, 0, asset.density).astype(np.float64)
    resolution, side = 1 << _FINE_LEVELS, 2.0 / (1 << COARSE_DEPTH)
    half = asset.frame.half_extents
    # Leaves that are not below the coarse depth stay.
    stay = levels <= COARSE_DEPTH
    sides = _within(cells[stay], (2.0 / (1 << levels[stay]))[:, None], half)
    kept = transmittance(density[stay, None] * sides, asset.law, np)
    below = cells[~stay], levels[~stay] - COARSE_DEPTH, density[~stay]
    parents, index = np.unique(below[0] >> below[1][:, None], axis=0, return_inverse=True)
    grid = np.zeros((len(parents), resolution, resolution, resolution), np.float32)
    for steps in np.unique(below[1]):
        chosen = below[1] == steps
        _fill(grid, index[chosen].ravel(), below[0][chosen], int(steps), below[2][chosen])
    # Lengths [M, R, 3] of the grids' steps along each axis within the box.
    fine = parents[:, None, :] * resolution + np.arange(resolution)[:, None]
    steps = _within(fine, side / resolution, half)
    lines = [_through(grid, steps, axis, asset.law) for axis in range(3)]
    through = np.concatenate([kept, np.stack(lines, axis=-1)])
    sides = np.concatenate([sides, steps.sum(axis=1)])
    return CoarseField(
        children=build_children(
            np.concatenate([cells[stay], parents]),
            np.concatenate([levels[stay], np.full(len(parents), COARSE_DEPTH)]),
        ),
        density=_density(through, sides).astype(np.float32),
        frame=asset.frame,
        luminaire=asset.luminaire,
    )


def _within(
    cells: NDArray[np.int64], side: float | NDArray[np.float64], half_extents: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Sides [..., 3] of the parts of cells [..., 3] within the bounding box."""
    lower = np.maximum(cells * side - 1, -half_extents)
    upper = np.minimum((cells + 1) * side - 1, half_extents)
    return np.maximum(upper - lower, 0)


def _through(
    grid: NDArray[np.float32], steps: NDArray[np.float64], axis: int, law: Law
) -> NDArray[np.float64]:
    """Mean transmittance [M] of the lines through each grid [M, R, R, R] along an axis.

    `steps` [M, R, 3] has the lengths of the grid's steps along each axis.
    """
    lengths = [steps[..., each] for each in range(3)]
    along = lengths.pop(axis)
    depth = np.einsum("mabc,ma->mbc", np.moveaxis(grid, axis + 1, 1), along)
    area = lengths[0][:, :, None] * lengths[1][:, None, :]
    light = (transmittance(depth, law, np) * area).sum(axis=(1, 2))
    return light / np.maximum(area.sum(axis=(1, 2)), _TINY)


def _density(through: NDArray[np.float64], sides: NDArray[np.float64]) -> NDArray[np.float64]:
    """Density [M] of cells that transmit the parts `through` [M, 3] of the light along each axis.

    It solves Σ_i A_i exp(-density · a_i) = Σ_i A_i t_i by bisection, with the side a_i and the area
    across it A_i.
    """
    sides = np.maximum(sides, _TINY)
    area = np.prod(sides, axis=1, keepdims=True) / sides
    area /= area.sum(axis=1, keepdims=True)
    light = np.maximum((area * through).sum(axis=1), _LEAST)
    low, high = np.zeros(len(sides)), -np.log(_LEAST) / sides.min(axis=1)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        is_more = (area * np.exp(-middle[:, None] * sides)).sum(axis=1) > light
        low, high = np.where(is_more, middle, low), np.where(is_more, high, middle)
    return low


def _fill(
    grid: NDArray[np.float32],
    index: NDArray[np.int64],
    cells: NDArray[np.int64],
    steps: int,
    density: NDArray[np.float64],
) -> None:
    """Add leaves that are `steps` levels below the coarse depth to the grids of their cells."""
    if steps > _FINE_LEVELS:
        finer = steps - _FINE_LEVELS
        inner = cells >> finer & (1 << _FINE_LEVELS) - 1
        np.add.at(grid, (index, *inner.T), density / 8.0**finer)
        return
    side, inner = 1 << (_FINE_LEVELS - steps), cells & ((1 << steps) - 1)
    blocks = grid.reshape(len(grid), *(1 << steps, side) * 3)
    x, y, z = inner.T
    blocks[index, x, :, y, :, z, :] = density[:, None, None, None]
