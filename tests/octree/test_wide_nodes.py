"""Wide nodes against the octree that they stand for."""

import numpy as np
import pytest

from lumitree.octree.build import EMPTY, LEAF, wide_levels, wide_nodes
from support.fields import random_asset
from support.reference_field import leaf_boxes


@pytest.mark.parametrize("depth", range(1, 12))
def test_wide_levels_add_up(depth):
    assert sum(wide_levels(depth)) == depth


def leaf_grid(asset):
    """Index of the leaf in every finest cell [x, y, z], -1 where there is none."""
    size = 1 << asset.tree_depth
    grid = np.full((size,) * 3, -1)
    lower, upper = ((corner + 1) / 2 * size for corner in leaf_boxes(asset))
    for index, (low, high) in enumerate(zip(lower.astype(int), upper.astype(int), strict=True)):
        grid[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = index
    return grid


def look_up(levels, bits, depth, cell):
    """Entry for a finest cell, and the log2 of its node's cells' side."""
    node, below = 0, depth
    for entries, b in zip(levels, bits, strict=True):
        below -= b
        x, y, z = (cell >> below) & ((1 << b) - 1)
        entry = entries[(node << 3 * b) + (z << 2 * b) + (y << b) + x]
        if entry < 0 or entry & LEAF:
            break
        node = entry
    return entry, below


@pytest.mark.parametrize("depth", [1, 2, 3, 6, pytest.param(7, marks=pytest.mark.slow)])
def test_every_cell_names_its_leaf_or_an_empty_cube(depth):
    asset = random_asset(5, tree_depth=depth)
    grid = leaf_grid(asset)
    levels, bits = wide_nodes(asset.children, depth), wide_levels(depth)
    random = np.random.default_rng(0)
    empties = 0
    for cell in random.integers(0, 1 << depth, (400, 3)):
        entry, below = look_up(levels, bits, depth, cell)
        leaf = grid[tuple(cell)]
        if leaf >= 0:
            assert (entry & ~LEAF) >> 4 == leaf
            corner = cell >> (entry & 15) << (entry & 15)
            whole = tuple(slice(a, a + (1 << (entry & 15))) for a in corner)
            assert np.all(grid[whole] == leaf)
            continue
        assert entry & EMPTY
        empties += 1
        cells, node_side = grid_of_node(grid, cell, below, bits, depth)
        for octant in range(8):
            side = 1 + (entry >> 3 * octant & 7)
            expected = largest_empty_cube(cells, (cell >> below) % node_side, octant)
            assert side == min(expected, 8)
    assert empties > 0


def grid_of_node(grid, cell, below, bits, depth):
    """Whether something is in each cell of the node that holds `cell`, and its cells a side."""
    side = 1 << bits[list(np.cumsum(bits)).index(depth - below)]
    corner = (cell >> below) // side * side << below
    whole = grid[tuple(slice(a, a + (side << below)) for a in corner)] >= 0
    blocks = whole.reshape(side, 1 << below, side, 1 << below, side, 1 << below)
    return blocks.any(axis=(1, 3, 5)), side


def largest_empty_cube(full, place, octant):
    rising = [octant >> axis & 1 for axis in range(3)]
    side = 1
    while True:
        low = [p if r else p - side for p, r in zip(place, rising, strict=True)]
        high = [p + side + 1 if r else p + 1 for p, r in zip(place, rising, strict=True)]
        if min(low) < 0 or max(high) > len(full):
            return side
        if full[tuple(slice(a, b) for a, b in zip(low, high, strict=True))].any():
            return side
        side += 1
