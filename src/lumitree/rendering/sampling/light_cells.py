"""Cells of a grid from which light starts, on the device."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device
from lumitree.octree.build import build_children
from lumitree.octree.leaves import grid_boxes_inside
from lumitree.octree.traversal import Octree


class LightCells:
    """The parts of cells that are inside a lamp's box; light starts anywhere in them.

    Args:
        cells: [C, 3] coordinates, in Morton order.
        depth: the grid has 2**depth cells a side.

    Attributes:
        octree: of the cells, whose leaves are numbered as they are.
        corners: mi.Float [C × 2 × 3], lower and upper corner of each.
        volume: mi.Float [C].
    """

    def __init__(
        self, half_extents: NDArray[np.float64], cells: NDArray[np.integer], depth: int
    ) -> None:
        children = build_children(cells.astype(np.int64), np.full(len(cells), depth))
        self.octree = Octree(children, depth, half_extents)
        lower, upper = grid_boxes_inside(half_extents, cells, depth)
        self.corners = on_device(mi.Float, np.stack([lower, upper], axis=1))
        self.volume = on_device(mi.Float, (upper - lower).prod(axis=1))

    def point(
        self, cell: mi.UInt32, within: mi.Point3f, active: mi.Bool | bool = True
    ) -> mi.Point3f:
        """Point of a cell for numbers in [0, 1)³."""
        lower = dr.gather(mi.Point3f, self.corners, 2 * cell, active)
        upper = dr.gather(mi.Point3f, self.corners, 2 * cell + 1, active)
        return dr.lerp(lower, upper, within)
