"""Nodes of many cells, in which a ray finds its next leaf in few steps.

The binary levels of an octree are joined into one to four wide ones: a node of 2**b cells a side
holds, for each cell, a number that says what is there. A cell of a leaf that is larger than a cell
names the leaf and its size. An empty cell says how far a ray may go in each of the eight octants
of directions before something may come: the side of the largest empty cube of cells that has the
cell in the corner where the ray comes from.

    empty   bit 31 set; bits 3 o to 3 o + 2 hold the cube's side less 1 for octant o of directions
            (bit 0 of o: the ray's x rises, bit 1: y, bit 2: z)
    leaf    bit 30 set; index · 16 + log2 of its side in cells of the whole tree's last level
    node    else: index of the node of the next wide level
"""

import numpy as np
from numpy.typing import NDArray

from lumitree.errors import LumitreeError

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
