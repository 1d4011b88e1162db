"""Bins of directions by the octahedral map.

The sphere is projected on an octahedron, whose lower half is folded out into the corners of a
square, which is cut into `resolution`² bins.
"""

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray


def octahedral(direction: Any) -> Any:
    """Octahedral coordinates in [-1, 1]² of a direction of any length."""
    n = direction / dr.sum(dr.abs(direction))
    folded = mi.Vector2f(
        dr.copysign(1 - dr.abs(n.y), n.x),
        dr.copysign(1 - dr.abs(n.x), n.y),
    )
    return dr.select(n.z < 0, folded, mi.Vector2f(n.x, n.y))


def bin_of(direction: Any, resolution: int, offset: Any = None) -> Any:
    """Index (mi.UInt32) of the bin of a direction of any length.

    Args:
        direction: mi.Vector3f.
        resolution: bins a side.
        offset: mi.Vector2f from -1 to 1, added to the place on the map, in bins.
    """
    uv = octahedral(direction)
    if offset is not None:
        uv = _on_map(uv + offset * (2 / resolution))
    cell = mi.Point2u(dr.clip(mi.Point2i((uv + 1) * (resolution / 2)), 0, resolution - 1))
    return cell.y * resolution + cell.x


def direction_in_bin(bin_index: Any, sample: Any, resolution: int) -> tuple[Any, Any]:
    """Unit direction in a bin, uniform in octahedral coordinates, and its density there.

    `sample` may be outside the unit square, by at most 1, and the direction then is in a neighbour.
    """
    cell = mi.Point2f(bin_index % resolution, bin_index // resolution)
    uv = _on_map(mi.Vector2f((cell + sample) * (2 / resolution) - 1))
    z = 1 - dr.abs(uv.x) - dr.abs(uv.y)
    fold = dr.maximum(-z, 0)
    v = mi.Vector3f(uv.x - dr.copysign(fold, uv.x), uv.y - dr.copysign(fold, uv.y), z)
    direction = dr.normalize(v)
    return direction, bin_density(direction, resolution)


def _on_map(uv: Any) -> Any:
    """Octahedral coordinates of a place beyond the map: each side meets its own other half."""
    uv = dr.select(dr.abs(uv.x) > 1, mi.Vector2f(dr.copysign(2, uv.x) - uv.x, -uv.y), uv)
    return dr.select(dr.abs(uv.y) > 1, mi.Vector2f(-uv.x, dr.copysign(2, uv.y) - uv.y), uv)


def interpolated(values: NDArray[Any], direction: NDArray[Any]) -> NDArray[np.float64]:
    """Values [N] in directions [N, 3], linear between the middles of bins.

    It is the mean of `bin_of` over an `offset` from -1/2 to 1/2.

    Args:
        values: [R²] by bin.
        direction: of any length.
    """
    bins, weights = bilinear_bins(np.asarray(direction, np.float64), math.isqrt(len(values)))
    return (values[bins] * weights).sum(axis=1)


def bin_density(direction: Any, resolution: int) -> Any:
    """Density per steradian of `direction_in_bin`, given the bin.

    Area on the octahedron and solid angle differ by the cube of the distance from the origin.
    """
    return (resolution**2 / 4) / dr.sum(dr.abs(direction)) ** 3


def solid_angles(resolution: int) -> NDArray[np.float64]:
    """Solid angle [R²] of each bin, sr, if directions between the middles of bins share in them.

    A direction counts for a bin with the bilinear weight of its place on the map, which is the
    chance with which an `offset` of `bin_of`, from -1/2 to 1/2, gives this bin. So intensities that
    are flux over solid angle keep the flux, if they are linear between the middles of bins.
    """
    # Points a side of a bin: as dense on the map for many bins as for few.
    fine = min(8, max(2, 1024 // resolution))
    density = np.linalg.norm(_on_octahedron(resolution * fine), axis=-1) ** -3
    density = bordered(density, fine // 2)
    rising = (np.arange(fine) + 0.5) / fine
    weights = np.hstack([rising, rising[::-1]])
    windows = np.lib.stride_tricks.sliding_window_view(density, (2 * fine, 2 * fine))
    sums = np.einsum("ijkl,k,l->ij", windows[::fine, ::fine], weights, weights).ravel()
    return sums * (4 * np.pi / sums.sum())


def bordered(values: NDArray[Any], width: int) -> NDArray[Any]:
    """Values [R + 2 width, R + 2 width, ...] on the map and beyond its sides.

    Beyond a side of the map is the other half of the same side.

    Args:
        values: [R, R, ...] by row and column, as bins are numbered.
        width: of the border.
    """
    first, last = values[:width][::-1, ::-1], values[-width:][::-1, ::-1]
    rows = np.concatenate([first, values, last])
    first, last = rows[:, :width][::-1, ::-1], rows[:, -width:][::-1, ::-1]
    return np.concatenate([first, rows, last], axis=1)


def bilinear_bins(
    direction: NDArray[np.float64], resolution: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The bins [N, 4] around directions on the map, and their bilinear weights [N, 4].

    Values with these weights are linear between the middles of bins; see `solid_angles`.

    Args:
        direction: [N, 3], of any length above 0.
        resolution: bins a side.
    """
    x, y, z = (direction / np.abs(direction).sum(axis=1, keepdims=True)).T
    u = np.where(z < 0, np.copysign(1 - np.abs(y), x), x)
    v = np.where(z < 0, np.copysign(1 - np.abs(x), y), y)
    bins = bordered(np.arange(resolution**2).reshape(resolution, resolution), 1)
    # The middle of bin 0 is at 1 in the map with its border.
    column, row = ((each + 1) * (resolution / 2) + 0.5 for each in (u, v))
    left, top = (np.clip(each.astype(np.int64), 0, resolution) for each in (column, row))
    right, bottom = column - left, row - top
    found = [bins[top + i, left + j] for i in (0, 1) for j in (0, 1)]
    weights = [a * b for a in (1 - bottom, bottom) for b in (1 - right, right)]
    return np.stack(found, axis=1), np.stack(weights, axis=1)


def middle_directions(resolution: int) -> NDArray[Any]:
    """Unit direction [R², 3] in the middle of each bin."""
    points = _on_octahedron(resolution).reshape(-1, 3)
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def _on_octahedron(resolution: int) -> NDArray[Any]:
    """Points [R, R, 3] of the octahedron in the middle of each bin."""
    centres = (np.arange(resolution) + 0.5) * (2 / resolution) - 1
    u, v = np.meshgrid(centres, centres)
    z = 1 - np.abs(u) - np.abs(v)
    fold = np.maximum(-z, 0)
    return np.stack([u - np.copysign(fold, u), v - np.copysign(fold, v), z], axis=-1)
