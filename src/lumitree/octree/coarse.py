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
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)

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

    A cell that has leaves of the given field gets the density -ln(t) / a. Here a is its side, and t
    is the mean transmittance of the lines through it along x, y and z. The law of the result
    is therefore the exponential one, whatever the law of the given field.

    Args:
        asset: a field.
        min_density: leaves below this density (per local unit) count as empty.
    """
    cells, levels = leaf_cells(asset.children, asset.num_leaves)
    density = np.where(asset.density < min_density, 0, asset.density).astype(np.float64)
    resolution, side = 1 << _FINE_LEVELS, 2.0 / (1 << COARSE_DEPTH)
    # Leaves that are not below the coarse depth stay.
    stay = levels <= COARSE_DEPTH
    sides = 2.0 / (1 << levels[stay])
    kept = transmittance(density[stay] * sides, asset.law, np)
    below = cells[~stay], levels[~stay] - COARSE_DEPTH, density[~stay]
    parents, index = np.unique(below[0] >> below[1][:, None], axis=0, return_inverse=True)
    grid = np.zeros((len(parents), resolution, resolution, resolution), np.float32)
    for steps in np.unique(below[1]):
        chosen = below[1] == steps
        _fill(grid, index[chosen].ravel(), below[0][chosen], int(steps), below[2][chosen])
    depths = (grid.sum(axis=axis) * (side / resolution) for axis in (1, 2, 3))
    lines = [transmittance(depth, asset.law, np).mean(axis=(1, 2)) for depth in depths]
    through = np.concatenate([kept, np.mean(lines, axis=0)])
    sides = np.concatenate([sides, np.full(len(parents), side)])
    return CoarseField(
        children=build_children(
            np.concatenate([cells[stay], parents]),
            np.concatenate([levels[stay], np.full(len(parents), COARSE_DEPTH)]),
        ),
        density=(-np.log(np.maximum(through, _LEAST)) / sides).astype(np.float32),
        frame=asset.frame,
        luminaire=asset.luminaire,
    )


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
