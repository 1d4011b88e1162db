"""Building the octree's node table from a list of leaves."""

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.arguments import check_count
from lumitree.errors import LumitreeError

MAX_TREE_DEPTH = 10
Integer = TypeVar("Integer", bound=np.integer)


def check_tree_depth(depth: int) -> None:
    """Refuse a level of the smallest leaves that is not in 1 to `MAX_TREE_DEPTH`."""
    check_count("tree depth", depth, 1, MAX_TREE_DEPTH)


def morton(cells: ArrayLike) -> NDArray[np.int64]:
    """Morton codes [M] of integer cell coordinates [M, 3] (x in the lowest bit)."""
    cells = np.asarray(cells, np.int64).reshape(-1, 3)
    codes = np.zeros(len(cells), np.int64)
    for bit in range(20):
        for axis in range(3):
            codes |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return codes


def child_cells(cells: NDArray[Integer]) -> NDArray[Integer]:
    """Coordinates [..., 8, 3] of the children of cells [..., 3], at their own level, by octant."""
    octant = np.arange(8)
    offsets = np.stack([octant & 1, octant >> 1 & 1, octant >> 2], axis=1)
    return (2 * cells[..., None, :] + offsets).astype(cells.dtype)


def build_children(cells: ArrayLike, levels: ArrayLike) -> NDArray[np.int32]:
    """Node table of an octree with the given leaves.

    Args:
        cells: integer coordinates [M, 3] of each leaf at its own level, 0 to 2**level - 1.
        levels: level [M] of each leaf, at least 1; the root is level 0.

    Returns:
        `children` int32 [N, 8] as `Asset` defines it; nodes breadth first, in Morton
        order within a level; leaf i keeps its index.

    Raises:
        LumitreeError: two leaves overlap.
    """
    codes, levels = morton(cells), np.asarray(levels, np.int64).reshape(-1)
    deepest = int(levels.max(initial=1))
    nodes = _nodes_by_level(codes, levels, deepest)
    offsets = np.cumsum([0] + [len(level) for level in nodes])
    children = np.zeros((offsets[-1], 8), np.int32)
    for level in range(1, deepest + 1):
        at_level = np.flatnonzero(levels == level)
        entries = [(codes[at_level], ~at_level)]
        if level < deepest:
            entries.append((nodes[level], offsets[level] + np.arange(len(nodes[level]))))
        child_codes = np.concatenate([code for code, _ in entries])
        values = np.concatenate([value for _, value in entries])
        if len(np.unique(child_codes)) < len(child_codes):
            raise LumitreeError(f"leaves overlap at level {level}; every leaf needs its own cell")
        parents = offsets[level - 1] + np.searchsorted(nodes[level - 1], child_codes >> 3)
        children[parents, child_codes & 7] = values
    return children


def _nodes_by_level(
    codes: NDArray[np.int64], levels: NDArray[np.int64], deepest: int
) -> list[NDArray[np.int64]]:
    """Sorted Morton codes of the interior nodes of levels 0 to deepest - 1."""
    nodes = [np.zeros(0, np.int64)] * deepest
    below = np.zeros(0, np.int64)
    for level in range(deepest - 1, -1, -1):
        below = np.unique(np.concatenate([below, codes[levels == level + 1]]) >> 3)
        nodes[level] = below
    nodes[0] = np.zeros(1, np.int64)
    return nodes
