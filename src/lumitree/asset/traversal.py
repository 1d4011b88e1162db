"""A ray's walk from leaf to leaf of an octree on the device.

Symbols
    grid        the finest cells of the octree, n = 2**tree_depth a side, n³ in all
    o, d        ray origin and direction in grid units; t stays in local units of length
    cell        integer grid coordinates of the finest cell the ray is in
"""

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

# The descent to a cell starts from a table of this level: 8**5 entries stay in the cache.
_TOP_LEVEL = 5
# visit(state, leaf, start, length, active) -> state, active: see `Octree.walk`.
Visit = Callable[[Any, Any, Any, Any, Any], tuple[Any, Any]]


class Octree:
    """Device copy of a node table.

    Args:
        children: int32 [N, 8] as `LuminaireAsset` defines it.
        tree_depth: level of the smallest possible leaf.
        half_extents: [3] the proxy box, local units; the walk stays within it.
    """

    def __init__(
        self,
        children: NDArray[np.int32],
        tree_depth: int,
        half_extents: NDArray[np.float64],
    ) -> None:
        self.tree_depth = tree_depth
        self._half_extents = half_extents
        self._children = mi.Int32(children.ravel())
        self._top_level = min(_TOP_LEVEL, tree_depth)
        entries, sides = _top(children, self._top_level)
        self._top_entries = mi.Int32(entries)
        self._top_sides = mi.Int32(sides << (tree_depth - self._top_level))
        dr.eval(self._children, self._top_entries, self._top_sides)

    @dr.syntax
    def walk(self, origin: Any, direction: Any, active: Any, visit: Visit, state: Any) -> Any:
        """Visit the leaves that the line crosses inside the proxy box, front to back.

        Args:
            origin: mi.Point3f, any point of the line, local units.
            direction: mi.Vector3f, unit direction of travel, local frame.
            active: mi.Bool mask.
            visit: called with the state, the leaf's index (mi.UInt32), the distance from the
                origin at which the line enters it, the length of the line in it (local units)
                and the mask of rays that are in a leaf; returns the new state and the mask of
                rays that go on.
            state: tuple of Dr.Jit arrays, what `visit` starts with.

        Returns:
            The last state.
        """
        size = 1 << self.tree_depth
        o = (origin + 1) * (size / 2)
        d = direction * (size / 2)
        moving = dr.abs(d) > 1e-18
        inverse = dr.rcp(dr.select(moving, d, 1))
        t, t_end, inside = self._clip(o, moving, inverse)
        active = active & inside & (t < t_end)
        t_exit = mi.Float(t)
        ahead = mi.Vector3i(dr.clip(mi.Vector3i(dr.floor(o + t * d)), 0, size - 1))
        child = mi.Int32(0)

        while active:
            # To the next leaf first, so that the rays of a packet meet their leaves together.
            seeking = mi.Bool(active)
            while seeking:
                t = mi.Float(t_exit)
                child, lower, side = self._find_cell(ahead, seeking)
                plane = mi.Vector3f(dr.select(d > 0, lower + side, lower))
                t_planes = dr.select(moving, (plane - o) * inverse, dr.inf)
                t_cell = dr.minimum(dr.min(t_planes), t_end)
                stepped = dr.clip(mi.Vector3i(dr.floor(o + t_cell * d)), lower, lower + side - 1)
                beyond = dr.select(d > 0, lower + side, lower - 1)
                ahead = mi.Vector3i(dr.select(t_planes <= t_cell, beyond, stepped))
                t_exit = dr.maximum(t, t_cell)
                active &= (t_cell < t_end) & dr.all((ahead >= 0) & (ahead < size))
                seeking &= active & (child >= 0)
            # A leaf may be the last cell of its ray.
            found = child < 0
            state, onwards = visit(state, mi.UInt32(~child), t, t_exit - t, found)
            child = mi.Int32(0)
            active &= found & onwards
        return state

    def find_leaf(self, point: Any, active: Any = True) -> tuple[Any, Any]:
        """Index (mi.UInt32) of the leaf that holds a point in local units, and whether one does."""
        size = 1 << self.tree_depth
        cell = mi.Vector3i(dr.floor((point + 1) * (size / 2)))
        inside = mi.Bool(active) & dr.all((cell >= 0) & (cell < size))
        child, _, _ = self._find_cell(cell, inside)
        return mi.UInt32(~child), inside & (child < 0)

    def _clip(self, o, moving, inverse):
        """Entry and exit distance of the proxy box, and whether the line meets it."""
        half = mi.Vector3f(*self._half_extents.tolist())
        scale = (1 << self.tree_depth) / 2
        first = ((1 - half) * scale - o) * inverse
        second = ((1 + half) * scale - o) * inverse
        entry = dr.max(dr.select(moving, dr.minimum(first, second), -dr.inf))
        exit_ = dr.min(dr.select(moving, dr.maximum(first, second), dr.inf))
        beside = ~moving & ((o < (1 - half) * scale) | (o >= (1 + half) * scale))
        return entry, exit_, ~dr.any(beside)

    def _find_cell(self, cell, active):
        """Deepest node's child entry that holds `cell`, its lower corner and side (grid units).

        Descends from the table of the upper levels; an empty entry of any level is as large as
        that level's cells, which is how empty space is skipped.
        """
        depth, top = self.tree_depth, self._top_level
        place = cell >> (depth - top)
        index = mi.UInt32(place.x + ((place.y + (place.z << top)) << top))
        node = dr.gather(mi.Int32, self._top_entries, index, active)
        side = dr.gather(mi.Int32, self._top_sides, index, active)
        open_ = mi.Bool(active) & (node > 0)
        for level in range(top + 1, depth + 1):
            shift = depth - level
            bits = (cell >> shift) & 1
            octant = bits.x + 2 * bits.y + 4 * bits.z
            child = dr.gather(mi.Int32, self._children, mi.UInt32(node * 8 + octant), open_)
            node = dr.select(open_, child, node)
            side = dr.select(open_, 1 << shift, side)
            open_ &= child > 0
        return node, cell & ~(side - 1), side


def _top(children: NDArray[np.int32], level: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Where the descent from the root stands at `level`, for all cells of that level, x fastest.

    Returns:
        Entries of `children` [8**level] and the sides of their cells in cells of `level`.
    """
    cells = np.arange(1 << level)
    z, y, x = np.meshgrid(cells, cells, cells, indexing="ij")
    entry = np.zeros(x.shape, np.int32)
    side = np.full(x.shape, 1 << level, np.int32)
    open_ = np.ones(x.shape, bool)
    for shift in reversed(range(level)):
        octant = (x >> shift & 1) + 2 * (y >> shift & 1) + 4 * (z >> shift & 1)
        entry = np.where(open_, children[entry.clip(0), octant], entry)
        side = np.where(open_, 1 << shift, side)
        open_ &= entry > 0
    return entry.ravel(), side.ravel()
