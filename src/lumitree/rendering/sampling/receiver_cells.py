"""Cells of the space around a lamp, by direction from its centre and by distance.

A table that depends on the receiver has one row for each cell. Cells are bins of direction
(`core.octahedral`) times shells of equal width in R / distance, in which parallax is linear; R is
the radius of the lamp's bounding sphere. The innermost shell has no end.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import parameter
from lumitree.core.octahedral import bin_of, direction_in_bin


class ReceiverCells:
    """Cells around a lamp in its local frame, numbered shell by shell from the outermost.

    Args:
        resolution: bins of direction a side.
        shell_width: of a shell in R / distance.
        first_shell: receivers that are farther away are in this one.
    """

    def __init__(
        self,
        half_extents: NDArray[np.float64],
        resolution: int,
        num_shells: int,
        shell_width: float,
        first_shell: int = 0,
    ) -> None:
        self.resolution = resolution
        self.num_bins = resolution**2
        self.count = num_shells * self.num_bins
        self._width = shell_width
        self._shells = parameter(mi.Vector2u, first_shell, first_shell + num_shells - 1)
        self._radius = parameter(mi.Float, float(np.linalg.norm(half_extents)))
        self._half = parameter(mi.Point3f, *half_extents.tolist())

    def index(self, x: mi.Point3f, shells: mi.Vector2u | None = None) -> mi.UInt32:
        """Index of the cell of a point.

        `shells`: the first and the last one, if not those of this object.
        """
        first, last = self._shells if shells is None else shells
        offset = mi.Vector3f(x)
        nearness = self._radius * dr.rsqrt(dr.squared_norm(offset)) / self._width
        shell = dr.clip(mi.UInt32(dr.minimum(nearness, mi.Float(last))), first, last) - first
        return shell * self.num_bins + bin_of(offset, self.resolution, bevelled=False)

    def point(self, cell: mi.UInt32, sample: mi.Point2f, shell_sample: mi.Float) -> mi.Point3f:
        """Random point of a cell, outside the lamp's box."""
        direction, _ = direction_in_bin(
            cell % self.num_bins, sample, self.resolution, bevelled=False
        )
        shell = cell // self.num_bins + self._shells.x
        nearness = (mi.Float(shell) + shell_sample) * self._width
        surface = dr.min(self._half / dr.abs(direction))
        # Beyond 50 R nothing changes any more but the rounding.
        distance = dr.maximum(self._radius / dr.maximum(nearness, 0.02), 1.001 * surface)
        return mi.Point3f(direction * distance)
