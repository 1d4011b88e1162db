"""Where the leaves of an octree are."""

import numpy as np
from numpy.typing import NDArray

from lumitree.octree.build import child_cells


def leaf_cells(
    children: NDArray[np.int32], num_leaves: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells of the leaves.

    Args:
        children: int32 [N, 8] as `Asset` defines it.
        num_leaves: M.

    Returns:
        Integer coordinates [M, 3] at each leaf's own level, and the levels [M].
    """
    cells, levels = np.zeros((num_leaves, 3), np.int64), np.zeros(num_leaves, np.int64)
    nodes, corners, level = np.array([0]), np.zeros((1, 3), np.int64), 1
    while len(nodes):
        below = children[nodes]
        inner = child_cells(corners)
        leaf, node = below < 0, below > 0
        cells[~below[leaf]], levels[~below[leaf]] = inner[leaf], level
        nodes, corners, level = below[node], inner[node], level + 1
    return cells, levels


def boxes_inside(
    half_extents: NDArray[np.float64], cells: NDArray[np.int64], levels: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower and upper corners [M, 3] of the parts of cells that are inside the proxy box.

    Args:
        half_extents: [3] of the box, local units.
        cells, levels: as `leaf_cells` returns them.
    """
    side = 2.0 / (1 << levels)[:, None]
    lower, upper = cells * side - 1, (cells + 1) * side - 1
    return np.maximum(lower, -half_extents), np.minimum(upper, half_extents)


def grid_boxes_inside(
    half_extents: NDArray[np.float64], cells: NDArray[np.integer], depth: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`boxes_inside` of cells [M, 3] of a grid with 2**depth a side, none of them flat.

    Cells on the border may have a side of 0, which float32 need not divide by; theirs is 1e-6.
    """
    lower, upper = boxes_inside(half_extents, cells.astype(np.int64), np.full(len(cells), depth))
    return lower, np.maximum(upper, lower + 1e-6)
