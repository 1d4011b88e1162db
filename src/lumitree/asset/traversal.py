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
        dr.eval(self._children)

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
        cell = mi.Vector3i(dr.clip(mi.Vector3i(dr.floor(o + t * d)), 0, size - 1))

        while active:
            child, lower, side = self._find_cell(cell, active)
            plane = mi.Vector3f(dr.select(d > 0, lower + side, lower))
            t_planes = dr.select(moving, (plane - o) * inverse, dr.inf)
            t_exit = dr.minimum(dr.min(t_planes), t_end)
            length = dr.maximum(t_exit - t, 0)

            state, onwards = visit(state, mi.UInt32(~child), t, length, active & (child < 0))

            stepped = dr.clip(mi.Vector3i(dr.floor(o + t_exit * d)), lower, lower + side - 1)
            beyond = dr.select(d > 0, lower + side, lower - 1)
            cell = mi.Vector3i(dr.select(t_planes <= t_exit, beyond, stepped))
            t = dr.maximum(t, t_exit)
            active &= (t_exit < t_end) & onwards & dr.all((cell >= 0) & (cell < size))
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

        Descends from the root; an empty entry of any level is as large as that level's cells,
        which is how empty space is skipped.
        """
        depth = self.tree_depth
        node = mi.Int32(0)
        side = mi.Int32(1 << depth)
        open_ = mi.Bool(active)
        for level in range(1, depth + 1):
            shift = depth - level
            bits = (cell >> shift) & 1
            octant = bits.x + 2 * bits.y + 4 * bits.z
            child = dr.gather(mi.Int32, self._children, mi.UInt32(node * 8 + octant), open_)
            node = dr.select(open_, child, node)
            side = dr.select(open_, 1 << shift, side)
            open_ &= child > 0
        return node, cell & ~(side - 1), side
