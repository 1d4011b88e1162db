"""Traversal of an octree on the device, from leaf to leaf along a ray.

Symbols
    grid        the finest cells of the octree, n = 2**tree_depth a side, n³ in all
    o, d        ray origin and direction in grid units; t stays in local units of length
    cell        integer grid coordinates of the finest cell the ray is in
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter
from lumitree.octree.build import LEAF, wide_levels, wide_nodes

# visit(state, leaf, start, length, active) -> state, active; shade(state, leaf, start, length,
# active) -> state: see `Octree.traverse`.
Visit = Callable[[Any, "mi.UInt32", "mi.Float", "mi.Float", "mi.Bool"], tuple[Any, "mi.Bool"]]
Shade = Callable[[Any, "mi.UInt32", "mi.Float", "mi.Float", "mi.Bool"], Any]
# First and last distance of a part of a line; None for all of it.
Span = tuple["mi.Float", "mi.Float"] | None
# Leaves of a ray that are shaded together.
_DEFERRED = 8
# A point that is so close to the proxy box's border is on it, local units.
_BORDER = 1e-5


class _Ray(NamedTuple):
    """A ray in grid units.

    Attributes:
        o, d: origin and direction.
        moving, inverse: by axis, whether d is not 0, and 1 / d there.
        rising: by axis, whether d is positive.
        octant: the same as `wide_nodes` numbers them.
        t_end: distance at which the ray leaves the proxy box.
    """

    o: mi.Vector3f
    d: mi.Vector3f
    moving: mi.Array3b
    inverse: mi.Vector3f
    rising: mi.Array3b
    octant: mi.UInt32
    t_end: mi.Float


class Octree:
    """Device copy of a node table.

    Args:
        children: int32 [N, 8] as `Asset` defines it.
        tree_depth: level of the smallest possible leaf.
        half_extents: [3] the proxy box, local units; the traversal stays within it.
    """

    def __init__(
        self,
        children: NDArray[np.int32],
        tree_depth: int,
        half_extents: NDArray[np.float64],
    ) -> None:
        self.tree_depth = tree_depth
        self._half = parameter(mi.Vector3f, *half_extents.tolist())
        # Device arrays cannot be empty: a level without nodes gets one that nothing refers to.
        self._nodes = [
            on_device(mi.Int32, level if len(level) else [0])
            for level in wide_nodes(children, tree_depth)
        ]
        dr.eval(self._nodes)

    @dr.syntax
    def traverse(
        self,
        origin: mi.Point3f,
        direction: mi.Vector3f,
        active: mi.Bool | bool,
        visit: Visit,
        state: Any,
        span: Span = None,
    ) -> Any:
        """Visit the leaves that the line crosses inside the proxy box, front to back.

        Args:
            origin: any point of the line, local units.
            direction: unit direction of travel, local frame.
            active: mask.
            visit: called with the state, the leaf's index, the distance from the
                origin at which the line enters it, the length of the line in it (local units)
                and the mask of rays that are in a leaf; returns the new state and the mask of
                rays that go on.
            state: tuple of Dr.Jit arrays, the first state of `visit`.
            span: distances from the origin of the part of the line that is meant; default: all.

        Returns:
            The last state.
        """
        ray, t_exit, ahead, active = self._enter(origin, direction, active, span)
        # Symbolic even where derivatives make the caller's loop an evaluated one: within a call of
        # an emitter there are no other loops, and Dr.Jit would warn of each.
        while dr.hint(active, mode="symbolic"):
            t = mi.Float(t_exit)
            entry, t_exit, ahead, leaves = self._step(ray, t, ahead, active)
            # A leaf may be the last cell of its ray.
            found = entry > 0
            state, onwards = visit(state, _leaf(entry), t, t_exit - t, found)
            active &= ~leaves & (~found | onwards)
        return state

    @dr.syntax
    def traverse_and_shade(
        self,
        origin: mi.Point3f,
        direction: mi.Vector3f,
        active: mi.Bool,
        visit: Visit,
        state: Any,
        shade: Shade,
        shaded: Any,
        span: Span = None,
    ) -> tuple[Any, Any]:
        """As `traverse`, and call `shade` for the same leaves in the same order.

        The rays of a packet meet their leaves at different steps, and all wait for one that is
        busy. So `visit` only decides how far a ray goes; `shade` does the rest, and is
        deferred until the rays have several leaves each.

        Returns:
            The last states of both.
        """
        ray, t_exit, ahead, active = self._enter(origin, direction, active, span)
        # In registers: Dr.Jit 1.5 has no local memory in functions that are called.
        queue = _DEFERRED * [(mi.UInt32(0), mi.Float(0), mi.Float(0))]
        while dr.hint(active, mode="symbolic"):
            count = mi.UInt32(0)
            seeking = mi.Bool(active)
            while dr.hint(seeking, mode="symbolic"):
                t = mi.Float(t_exit)
                entry, t_exit, ahead, leaves = self._step(ray, t, ahead, seeking)
                found, crossing = entry > 0, (_leaf(entry), t, t_exit - t)
                state, onwards = visit(state, *crossing, found)
                active &= ~leaves & (~found | onwards)
                queue = _with(queue, count, crossing, found)
                count += dr.select(found, mi.UInt32(1), 0)
                seeking = active & (count < _DEFERRED)
            while dr.hint(count > 0, mode="symbolic"):
                leaf, start, length = queue[0]
                shaded = shade(shaded, leaf, start, length, count > 0)
                queue = [*queue[1:], queue[-1]]
                count -= 1
        return state, shaded

    def _enter(self, origin, direction, active, span):
        """A ray in grid units, its first distance and cell, and whether it meets the proxy box."""
        size = 1 << self.tree_depth
        o, d = (origin + 1) * (size / 2), direction * (size / 2)
        moving = dr.abs(d) > 1e-18
        inverse = dr.rcp(dr.select(moving, d, 1))
        t, t_end, inside = self._clip(o, moving, inverse)
        if span is not None:
            t, t_end = dr.maximum(t, span[0]), dr.minimum(t_end, span[1])
        cell = mi.Vector3i(dr.clip(mi.Vector3i(dr.floor(o + t * d)), 0, size - 1))
        rising = d > 0
        octant = mi.Int32(rising.x) + 2 * mi.Int32(rising.y) + 4 * mi.Int32(rising.z)
        ray = _Ray(o, d, moving, inverse, rising, octant, t_end)
        return ray, mi.Float(t), cell, mi.Bool(active) & inside & (t < t_end)

    def _step(self, ray, t, cell, active):
        """Through the box that a ray enters at distance t in a cell.

        Returns:
            The box's entry of `wide_nodes`, the distance at which the ray leaves it, the cell that
            it enters then, and whether it has left the grid.
        """
        entry, lower, side = self._find_box(ray, cell, active)
        plane = mi.Vector3f(dr.select(ray.rising, lower + side, lower))
        t_planes = dr.select(ray.moving, (plane - ray.o) * ray.inverse, dr.inf)
        t_box = dr.minimum(dr.min(t_planes), ray.t_end)
        within = mi.Vector3i(dr.floor(ray.o + t_box * ray.d))
        within = dr.clip(within, lower, lower + side - 1)
        beyond = dr.select(ray.rising, lower + side, lower - 1)
        ahead = mi.Vector3i(dr.select(t_planes <= t_box, beyond, within))
        outside = dr.any((ahead < 0) | (ahead >= 1 << self.tree_depth))
        return entry, dr.maximum(t, t_box), ahead, outside | (t_box >= ray.t_end)

    def find_leaf(
        self, point: mi.Point3f, active: mi.Bool | bool = True
    ) -> tuple[mi.UInt32, mi.Bool]:
        """Index of the leaf that holds a point in the box, and whether one does."""
        size = 1 << self.tree_depth
        half = mi.Point3f(self._half)
        inside = mi.Bool(active) & dr.all(dr.abs(point) <= half + _BORDER)
        # The end of a lamp, such as a canopy's top, is on the border: within, not in the next cell.
        point = dr.clip(point, -half, half - _BORDER)
        return self.leaf_at(mi.Vector3i(dr.floor((point + 1) * (size / 2))), inside)

    def leaf_at(
        self, cell: mi.Vector3i, active: mi.Bool | bool = True
    ) -> tuple[mi.UInt32, mi.Bool]:
        """As `find_leaf` for a cell of the grid, which may be outside it."""
        inside = mi.Bool(active) & dr.all((cell >= 0) & (cell < 1 << self.tree_depth))
        entry, _ = self._find(cell, inside)
        return _leaf(entry), inside & (entry > 0)

    def _clip(self, o, moving, inverse):
        """Entry and exit distance of the proxy box, and whether the line meets it."""
        half, scale = self._half, (1 << self.tree_depth) / 2
        first = ((1 - half) * scale - o) * inverse
        second = ((1 + half) * scale - o) * inverse
        entry = dr.max(dr.select(moving, dr.minimum(first, second), -dr.inf))
        exit_ = dr.min(dr.select(moving, dr.maximum(first, second), dr.inf))
        beside = ~moving & ((o < (1 - half) * scale) | (o >= (1 + half) * scale))
        return entry, exit_, ~dr.any(beside)

    def _find(self, cell, active):
        """Entry of `wide_nodes` for a cell, and log2 of its node's cells' side (grid units)."""
        log_cell = self.tree_depth
        node, entry, log_side = mi.Int32(0), mi.Int32(0), mi.Int32(0)
        open_ = mi.Bool(active)
        for bits, entries in zip(wide_levels(self.tree_depth), self._nodes, strict=True):
            log_cell -= bits
            place = (cell >> log_cell) & ((1 << bits) - 1)
            index = (((node << bits) + place.z << bits) + place.y << bits) + place.x
            node = dr.gather(mi.Int32, entries, mi.UInt32(index), open_)
            entry = dr.select(open_, node, entry)
            log_side = dr.select(open_, log_cell, log_side)
            open_ &= (node >= 0) & (node < int(LEAF))
        return entry, log_side

    def _find_box(self, ray, cell, active):
        """Entry, lower corner and side (grid units) of the box that a ray enters in a cell.

        The box is a leaf, or an empty cube that begins with the cell.
        """
        entry, log_cell = self._find(cell, active)
        empty = entry < 0
        log_side = dr.select(empty, log_cell, entry & 15)
        more = dr.select(empty, (entry >> (3 * ray.octant)) & 7, 0) << log_side
        lower = (cell >> log_side) << log_side
        return entry, dr.select(ray.rising, lower, lower - more), more + (1 << log_side)


def _with(queue, place, item, active):
    """A list of tuples with another one in a place [index]."""
    return [
        tuple(dr.select(active & (place == i), *pair) for pair in zip(item, waiting, strict=True))
        for i, waiting in enumerate(queue)
    ]


def _leaf(entry):
    return mi.UInt32((entry & ~int(LEAF)) >> 4)
