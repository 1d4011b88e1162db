"""A tree of boxes, in the order in which a ray visits them without a stack."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Numbers of a node: centre and half extents of its box; the row that follows its subtree; and the
# number of the box that it is, -1 for a node with children.
NODE_NUMBERS = 8
# Boxes are larger by this part of their extents, so that rounding loses none.
_SLACK = 1e-5


def box_tree(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Nodes [2 N - 1, `NODE_NUMBERS`] of a binary tree over N ≥ 1 boxes, in depth-first order.

    A node is followed by its first child, so a ray that meets it continues with the next row, and
    one that misses it with the row that follows its subtree.
    """
    rows: list[NDArray[np.float64]] = []

    def add(members: NDArray[np.int64]) -> None:
        corner, other = low[members].min(axis=0), high[members].max(axis=0)
        half = (other - corner) / 2 * (1 + _SLACK)
        box = members[0] if len(members) == 1 else -1
        row = np.array([*(corner + other) / 2, *half, 0, box])
        rows.append(row)
        if len(members) > 1:
            centres = low[members] + high[members]
            axis = np.ptp(centres, axis=0).argmax()
            members = members[np.argsort(centres[:, axis], kind="stable")]
            middle = len(members) // 2
            add(members[:middle])
            add(members[middle:])
        row[6] = len(rows)

    add(np.arange(len(low)))
    return np.array(rows)
