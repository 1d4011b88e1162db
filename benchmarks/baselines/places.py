"""Where the light of a source starts: at a point, on a disk, on a patch, or in a cell."""

from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device


class Places(Protocol):
    """The places of the sources of a set, by index."""

    num_bytes: int

    def point(self, index: Any, towards: Any, sample1: Any, sample2: Any) -> Any:
        """A point (mi.Point3f) of a source, uniform.

        Args:
            index: mi.UInt32.
            towards: mi.Vector3f, unit direction that the light takes.
            sample1, sample2: mi.Float and mi.Point2f, uniform.
        """
        ...


class Points:
    """Points: centres [S, 3]."""

    def __init__(self, centres: NDArray[np.floating]) -> None:
        self._centres = on_device(mi.Float, centres.astype(np.float32).ravel())
        # Three floats each.
        self.num_bytes = 12 * len(centres)

    def point(self, index: Any, towards: Any, sample1: Any, sample2: Any) -> Any:
        return dr.gather(mi.Point3f, self._centres, index)


class Disk:
    """One source: the disk of a sphere about the centre that faces the light's direction."""

    def __init__(self, radius: float) -> None:
        self._radius = radius
        self.num_bytes = 4

    def point(self, index: Any, towards: Any, sample1: Any, sample2: Any) -> Any:
        disk = self._radius * mi.warp.square_to_uniform_disk_concentric(sample2)
        height = dr.safe_sqrt(self._radius**2 - dr.squared_norm(disk))
        return mi.Point3f(mi.Frame3f(towards).to_world(mi.Vector3f(disk.x, disk.y, height)))


class Boxes:
    """Axis-aligned boxes, flat ones among them: lower and upper corners [S, 3].

    Args:
        bytes_each: of the description of a box.
    """

    def __init__(
        self, lower: NDArray[np.floating], upper: NDArray[np.floating], bytes_each: int
    ) -> None:
        self._lower, self._size = (
            on_device(mi.Float, each.astype(np.float32).ravel()) for each in (lower, upper - lower)
        )
        self.num_bytes = bytes_each * len(lower)

    def point(self, index: Any, towards: Any, sample1: Any, sample2: Any) -> Any:
        lower = dr.gather(mi.Point3f, self._lower, index)
        size = dr.gather(mi.Vector3f, self._size, index)
        return lower + size * mi.Vector3f(sample1, sample2.x, sample2.y)
