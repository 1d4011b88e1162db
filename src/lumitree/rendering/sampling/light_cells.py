"""Cells of a grid from which light starts, on the device."""

from __future__ import annotations

from collections.abc import Sequence

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
        more: lower and upper corners [.., 3] of boxes that follow the cells.

    Attributes:
        octree: of the cells, whose leaves are numbered as they are.
        corners: mi.Float [C × 2 × 3], lower and upper corner of each cell or box.
        volume: mi.Float [C].
    """

    def __init__(
        self,
        half_extents: NDArray[np.float64],
        cells: NDArray[np.integer],
        depth: int,
        more: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]] = (),
    ) -> None:
        children = build_children(cells.astype(np.int64), np.full(len(cells), depth))
        self.octree = Octree(children, depth, half_extents)
        boxes = grid_boxes_inside(half_extents, cells, depth), *more
        lower, upper = (np.concatenate(each) for each in zip(*boxes, strict=True))
        self.corners = on_device(mi.Float, np.stack([lower, upper], axis=1))
        boxes = lower, (upper - lower).prod(axis=1), upper - lower, np.zeros(len(lower))
        self._boxes = on_device(mi.Float, np.column_stack(boxes))
        self.volume = on_device(mi.Float, (upper - lower).prod(axis=1))

    def point(
        self, cell: mi.UInt32, within: mi.Point3f, active: mi.Bool | bool = True
    ) -> mi.Point3f:
        """Point of a cell for numbers in [0, 1)³."""
        return self.point_and_volume(cell, within, active)[0]

    def point_and_volume(
        self, cell: mi.UInt32, within: mi.Point3f, active: mi.Bool | bool = True
    ) -> tuple[mi.Point3f, mi.Float]:
        """As `point`, and the volume of the cell."""
        # Four numbers are one load.
        lower, size = (dr.gather(mi.Vector4f, self._boxes, 2 * cell + i, active) for i in (0, 1))
        corner, side = mi.Point3f(lower.x, lower.y, lower.z), mi.Vector3f(size.x, size.y, size.z)
        return dr.fma(side, within, corner), lower.w
