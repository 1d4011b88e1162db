"""Node tables of octrees: built of a list of leaves, and as wide nodes for rays.

A ray finds its next leaf in few steps in wide nodes: the binary levels of an octree are joined into
one to four wide ones. A node of 2**b cells a side has a number for each cell that describes it. A
cell of a leaf that is larger than a cell names the leaf and its size. An empty cell says how far a
ray may go in each of the eight octants of directions before something may come: the side of the
largest empty cube of cells that has the cell in the corner where the ray comes from.

    empty   bit 31 set; bits 3 o to 3 o + 2 hold the cube's side less 1 for octant o of directions
            (bit 0 of o: the ray's x rises, bit 1: y, bit 2: z)
    leaf    bit 30 set; index · 16 + log2 of its side in cells of the whole tree's last level
    node    else: index of the node of the next wide level
"""

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


EMPTY, LEAF = np.int32(-(1 << 31)), np.int32(1 << 30)
MAX_LEAVES = 1 << 26
# 32³ entries of the first node stay in the cache. Larger nodes below it (8³, 2 kB) save steps, but
# outgrow the cache, which costs more.
_FIRST_BITS, _BITS = 5, 2
_LONGEST = 8


def wide_levels(tree_depth: int) -> list[int]:
    """Bits of each wide level."""
    first = min(_FIRST_BITS, tree_depth)
    rest = tree_depth - first
    return [first] + [_BITS] * (rest // _BITS) + [rest % _BITS] * bool(rest % _BITS)


def wide_nodes(children: NDArray[np.int32], tree_depth: int) -> list[NDArray[np.int32]]:
    """Entries of each wide level, x fastest, one node after another.

    Args:
        children: int32 [N, 8] as `Asset` defines it.
        tree_depth: level of the smallest possible leaf.

    Raises:
        LumitreeError: there are more than `MAX_LEAVES`.
    """
    if ~int(children.min()) >= MAX_LEAVES:
        raise LumitreeError(
            f"an octree of {~int(children.min()) + 1} leaves; at most {MAX_LEAVES} can be rendered"
        )
    nodes, below, levels = np.zeros(1, np.int32), tree_depth, []
    for bits in wide_levels(tree_depth):
        below -= bits
        child, log_side = _descend(children, nodes, bits)
        nodes = child[child > 0]
        entries = np.where(child < 0, (~child << 4 | (log_side + below)) | LEAF, 0)
        entries[child > 0] = np.arange(len(nodes))
        entries |= _skips(child == 0)
        levels.append(entries.astype(np.int32).ravel())
    return levels


def _descend(
    children: NDArray[np.int32], nodes: NDArray[np.int32], bits: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Entries of `children` [N, z, y, x] `bits` levels below nodes [N], or where the descent ended.

    Also log2 of their sides in cells of the last level.
    """
    cells = np.arange(1 << bits)
    z, y, x = np.meshgrid(cells, cells, cells, indexing="ij")
    child = np.broadcast_to(nodes[:, None, None, None], (len(nodes), *x.shape)).astype(np.int32)
    log_side = np.full(child.shape, bits, np.int32)
    open_ = np.ones(child.shape, bool)
    for shift in reversed(range(bits)):
        octant = (x >> shift & 1) + 2 * (y >> shift & 1) + 4 * (z >> shift & 1)
        child = np.where(open_, children[child.clip(0), octant], child)
        log_side[open_] = shift
        open_ &= child > 0
    return child, log_side


def _skips(empty: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Entries of the empty cells of nodes [N, z, y, x], 0 for others."""
    entries = np.where(empty, EMPTY, 0).astype(np.int32)
    for octant in range(8):
        rising = np.array([octant >> 2 & 1, octant >> 1 & 1, octant & 1])
        cube = empty
        for _ in range(min(_LONGEST, empty.shape[1]) - 1):
            # A cube is empty if the eight cubes one smaller are that start in its corner cells.
            for axis, rises in enumerate(rising, start=1):
                cube = cube & _neighbour(cube, axis, bool(rises))
            entries += cube.astype(np.int32) << (3 * octant)
    return entries


def _neighbour(cube: NDArray[np.bool_], axis: int, rises: bool) -> NDArray[np.bool_]:
    """Values of the next cells along an axis; False beyond the node."""
    moved = np.zeros_like(cube)
    here, there = [slice(None)] * 4, [slice(None)] * 4
    here[axis], there[axis] = slice(None, -1), slice(1, None)
    if not rises:
        here, there = there, here
    moved[tuple(here)] = cube[tuple(there)]
    return moved
