"""Where the leaves of an octree are."""

import numpy as np
from numpy.typing import NDArray


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
    octants = np.array([(octant & 1, octant >> 1 & 1, octant >> 2) for octant in range(8)])
    cells, levels = np.zeros((num_leaves, 3), np.int64), np.zeros(num_leaves, np.int64)
    nodes, corners, level = np.array([0]), np.zeros((1, 3), np.int64), 1
    while len(nodes):
        below = children[nodes]
        inner = 2 * corners[:, None] + octants
        leaf, node = below < 0, below > 0
        cells[~below[leaf]], levels[~below[leaf]] = inner[leaf], level
        nodes, corners, level = below[node], inner[node], level + 1
    return cells, levels
