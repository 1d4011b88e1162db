"""Where the light of a source starts: at a point, on a disk, or on a patch of a box."""

from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device
from lumitree.rendering.sampling.proxy import safe_inverse, slab


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

    def seen(self, origin: Any, direction: Any) -> tuple[Any, Any, Any] | None:
        """The source that a line shows; None where sources have no extent.

        Args:
            origin: mi.Point3f, on the line.
            direction: mi.Vector3f, unit direction that the light takes.

        Returns:
            mi.UInt32, index; mi.Float, area of the source across the line, by which its intensity
            is divided; mi.Bool, whether the line meets a source.
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

    def seen(self, origin: Any, direction: Any) -> None:
        """A line meets no point."""


class Disk:
    """One source: the disk of a sphere about the centre that faces the light's direction."""

    def __init__(self, radius: float) -> None:
        self._radius = radius
        self.num_bytes = 4

    def point(self, index: Any, towards: Any, sample1: Any, sample2: Any) -> Any:
        disk = self._radius * mi.warp.square_to_uniform_disk_concentric(sample2)
        height = dr.safe_sqrt(self._radius**2 - dr.squared_norm(disk))
        return mi.Point3f(mi.Frame3f(towards).to_world(mi.Vector3f(disk.x, disk.y, height)))

    def seen(self, origin: Any, direction: Any) -> tuple[Any, Any, Any]:
        offset = mi.Vector3f(origin)
        across = offset - dr.dot(offset, direction) * direction
        hit = dr.squared_norm(across) < self._radius**2
        return mi.UInt32(0), mi.Float(np.pi * self._radius**2), hit


class Patches:
    """About square patches of all faces of a box about the origin, numbered face by face.

    Args:
        half_extents: [3], of the box.
        count: patches along its longest side.

    Attributes:
        count: of all patches.
        normals: float64 [S, 3], outward.
    """

    def __init__(self, half_extents: NDArray[np.floating], count: int) -> None:
        half = np.asarray(half_extents, np.float64)
        grid = np.maximum(1, np.round(count * half / half.max())).astype(np.int64)
        # Of a face perpendicular to each axis, whose sides are the two axes that follow.
        patches = np.roll(grid, -1) * np.roll(grid, -2)
        self._half, self._grid = half, grid
        self._first = [int(start) for start in 2 * (np.cumsum(patches) - patches)]
        self.count = int(2 * patches.sum())
        faces = np.repeat(np.eye(3), 2, axis=0) * np.tile([-1.0, 1.0], 3)[:, None]
        self.normals = np.repeat(faces, np.repeat(patches, 2), axis=0)
        self.num_bytes = 24

    def point(self, index: Any, towards: Any, sample1: Any, sample2: Any) -> Any:
        point = mi.Point3f(0)
        for axis, first in enumerate(self._first):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            columns, face = int(self._grid[v]), int(self._grid[u] * self._grid[v])
            local = index - first
            positive, local = local >= face, local % face
            place = mi.Point3f(0)
            place[axis] = dr.select(positive, 1, -1)
            place[u] = (local // columns + sample2.x) / self._grid[u] * 2 - 1
            place[v] = (local % columns + sample2.y) / self._grid[v] * 2 - 1
            point = dr.select(index >= first, place, point)
        return point * mi.Vector3f(self._half)

    def seen(self, origin: Any, direction: Any) -> tuple[Any, Any, Any]:
        """As `Places.seen`: the patch through which light leaves the box along the line."""
        half = mi.Vector3f(self._half)
        enters, leaves = slab(-mi.Vector3f(origin), half, safe_inverse(direction))
        distance = dr.min(leaves)
        place = ((origin + distance * direction) / half + 1) / 2
        index, area = mi.UInt32(0), mi.Float(0)
        for axis, first in enumerate(self._first):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            rows, columns = int(self._grid[u]), int(self._grid[v])
            row = mi.UInt32(dr.clip(place[u] * rows, 0, rows - 1))
            column = mi.UInt32(dr.clip(place[v] * columns, 0, columns - 1))
            face = dr.select(direction[axis] > 0, first + rows * columns, first)
            size = 4 * self._half[u] * self._half[v] / (rows * columns)
            here = leaves[axis] == distance
            index = dr.select(here, face + row * columns + column, index)
            area = dr.select(here, size * dr.abs(direction[axis]), area)
        return index, area, (dr.max(enters) < distance) & (area > 0)
