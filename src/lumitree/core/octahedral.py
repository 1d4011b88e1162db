"""Bins of directions by the octahedral map.

The sphere is projected on an octahedron, whose lower half is folded out into the corners of a
square, which is cut into `resolution`² bins.

Light fields are linear in the square between the middles of bins, but what is smooth over the
sphere has a kink at the edges of the octahedron. So for light fields the edges are *bevelled*: the
surface interpolates linearly, in the square, between the octahedron's points at the middles of
bins. It differs from the octahedron where four middles are on two of its faces:

*   Where x or y is 0, for half a bin to either side, it is a flat strip. Where two strips end, at
    ±x and ±y, half a bin of the square has no directions.
*   Where z is 0, two of four middles are on the edge. The surface between them is a hyperbolic
    paraboloid.

Symbols
    R       bins a side
    s, t    place between four middles of bins, 0 to 1
"""

from __future__ import annotations

import functools
import math
from typing import TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", bound=np.generic)


def octahedral(direction: mi.Vector3f, bevels: int = 0) -> mi.Vector2f:
    """Octahedral coordinates in [-1, 1]² of a direction of any length.

    Args:
        bevels: R, if edges are bevelled as for light fields; 0 if they are not.
    """
    x, y, z = dr.abs(direction)
    distance = x + y + z
    if bevels:
        width = 1 / bevels
        distance = dr.maximum(distance, (dr.maximum(x, y) + z) * (1 / (1 - width)))
        distance = dr.maximum(distance, z * (1 / (1 - 2 * width)))
    place = mi.Vector2f(x, y) / distance
    if bevels:
        place = _from_paraboloid(place, bevels)
    folded = 1 - mi.Vector2f(place.y, place.x)
    place = dr.select(direction.z < 0, folded, place)
    return mi.Vector2f(dr.copysign(place.x, direction.x), dr.copysign(place.y, direction.y))


def _between_middles(place: mi.Vector2f, resolution: int) -> tuple[mi.Vector2f, mi.Bool]:
    """(s, t) of a place of the upper half in positive coordinates; and whether it is at z = 0."""
    scaled = place * (resolution / 2) - 0.5
    first = dr.floor(scaled)
    crossed = (first.x + first.y + 2 == resolution / 2) & (dr.minimum(first.x, first.y) >= 0)
    return scaled - first, crossed


def _from_paraboloid(place: mi.Vector2f, resolution: int) -> mi.Vector2f:
    """Place on the map of a place on the octahedron, where they differ at z = 0.

    With a = 1 - 2 x and b = 1 - 2 y of the place (x, y) on the octahedron, the place on the map is
    (x + 2 a q / R, y + 2 b q / R), where q = (s + a q) (t + b q).
    """
    between, crossed = _between_middles(place, resolution)
    slope = 1 - 2 * place
    product = between.x * between.y
    half = 1 - between.x * slope.y - between.y * slope.x
    root = dr.safe_sqrt(half * half - 4 * slope.x * slope.y * product)
    moved = dr.select(crossed, product / (half + root) * (4 / resolution), 0)
    return place + moved * slope


def bin_of(
    direction: mi.Vector3f,
    resolution: int,
    offset: mi.Vector2f | None = None,
    *,
    bevelled: bool = True,
) -> mi.UInt32:
    """Index of the bin of a direction of any length.

    Args:
        resolution: bins a side.
        offset: from -1 to 1, added to the place on the map, in bins.
        bevelled: whether edges are bevelled, as for light fields.
    """
    uv = octahedral(direction, resolution if bevelled else 0)
    if offset is not None:
        uv = _on_map(uv + offset * (2 / resolution))
    cell = mi.Point2u(dr.clip(mi.Point2i((uv + 1) * (resolution / 2)), 0, resolution - 1))
    return cell.y * resolution + cell.x


def direction_in_bin(
    bin_index: mi.UInt32, sample: mi.Point2f, resolution: int, *, bevelled: bool = True
) -> tuple[mi.Vector3f, mi.Float]:
    """Unit direction in a bin, uniform in octahedral coordinates, and its density there.

    `sample` may be outside the unit square, by at most 1, and the direction then is in a neighbour.
    The density per steradian is given the bin; it is infinite where the map has no directions.
    """
    cell = mi.Point2f(bin_index % resolution, bin_index // resolution)
    uv = _on_map(mi.Vector2f((cell + sample) * (2 / resolution) - 1))
    place = dr.abs(uv)
    lower = place.x + place.y > 1
    place = dr.select(lower, 1 - mi.Vector2f(place.y, place.x), place)
    x, y, z = place.x, place.y, dr.maximum(1 - place.x - place.y, 0)
    # Solid angle over area on the map, times the cube of the distance from the centre.
    solid = mi.Float(1)
    if bevelled:
        x, y, z, solid = _bevelled(place, resolution)
    point = mi.Vector3f(dr.copysign(x, uv.x), dr.copysign(y, uv.y), dr.select(lower, -z, z))
    length = dr.norm(point)
    return point / length, (resolution**2 / 4) * length**3 / solid


def _bevelled(place: mi.Vector2f, resolution: int) -> tuple[mi.Float, mi.Float, mi.Float, mi.Float]:
    """Point of the bevelled octahedron of a place in positive coordinates, and its triple product.

    That is p · (∂p/∂u × ∂p/∂v), 0 where the map has no directions.
    """
    width = 1 / resolution
    z = 1 - dr.maximum(place.x, width) - dr.maximum(place.y, width)
    solid = 1 - dr.select(place.x < width, width, 0) - dr.select(place.y < width, width, 0)
    (s, t), crossed = _between_middles(place, resolution)
    fold = dr.select(crossed, s * t * (2 * width), 0)
    x, y = place.x - fold, place.y - fold
    of_crossed = x * (1 - s + t) + y * (1 + s - t) + z * (1 - s - t)
    solid = dr.select(crossed, of_crossed, dr.select(z < 0, 0, solid))
    return x, y, dr.maximum(z, 0), solid


def _on_map(uv: mi.Vector2f) -> mi.Vector2f:
    """Octahedral coordinates of a place beyond the map: the halves of each side meet."""
    uv = dr.select(dr.abs(uv.x) > 1, mi.Vector2f(dr.copysign(2, uv.x) - uv.x, -uv.y), uv)
    return dr.select(dr.abs(uv.y) > 1, mi.Vector2f(-uv.x, dr.copysign(2, uv.y) - uv.y), uv)


def interpolated(
    values: NDArray[np.floating], direction: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Values [N] in directions [N, 3], linear between the middles of bins.

    It is the mean of `bin_of` over an `offset` from -1/2 to 1/2.

    Args:
        values: [R²] by bin.
        direction: of any length.
    """
    bins, weights = bilinear_bins(np.asarray(direction, np.float64), math.isqrt(len(values)))
    return (values[bins] * weights).sum(axis=1)


@functools.lru_cache(maxsize=8)
def solid_angles(resolution: int) -> NDArray[np.float64]:
    """Solid angle [R²] of each bin, sr, if directions between the middles of bins share in them.

    A direction counts for a bin with the bilinear weight of its place on the map, which is the
    probability with which an `offset` of `bin_of`, from -1/2 to 1/2, gives this bin. So intensities
    that are flux over solid angle keep the flux, if they are linear between the middles of bins.
    """
    fine = _parts(resolution)
    density = bordered(parts_of_bins(resolution, fine)[1], fine // 2)
    rising = (np.arange(fine) + 0.5) / fine
    weights = np.hstack([rising, rising[::-1]])
    windows = np.lib.stride_tricks.sliding_window_view(density, (2 * fine, 2 * fine))
    sums = np.einsum("ijkl,k,l->ij", windows[::fine, ::fine], weights, weights).ravel()
    sums *= 4 * np.pi / sums.sum()
    # All callers share it.
    sums.setflags(write=False)
    return sums


def bin_solid_angles(resolution: int) -> NDArray[np.float64]:
    """Solid angle [R²] of the directions of each bin, sr."""
    fine = _parts(resolution)
    density = parts_of_bins(resolution, fine)[1]
    sums = density.reshape(resolution, fine, resolution, fine).sum(axis=(1, 3)).ravel()
    return sums * (4 * np.pi / sums.sum())


def _parts(resolution: int) -> int:
    """Points a side of a bin: as dense on the map for many bins as for few."""
    return min(8, max(2, 1024 // resolution))


def coarse_bin(index: mi.UInt32, resolution: int) -> mi.UInt32:
    """Index of the one of (R / 2)² bins that contains one of R²."""
    return index // (2 * resolution) * (resolution // 2) + index % resolution // 2


def coarse_solid_angles(resolution: int) -> NDArray[np.float64]:
    """Solid angle [R² / 4] of the directions of each `coarse_bin`, sr."""
    half = resolution // 2
    return bin_solid_angles(resolution).reshape(half, 2, half, 2).sum(axis=(1, 3)).ravel()


def intensity_of_histogram(flux: NDArray[np.float64]) -> NDArray[np.float64]:
    """Intensities of the bins of a histogram, with the flux of each channel.

    Even light gets even intensities, since the flux of a bin comes only from directions in it.

    Args:
        flux: [C, R², 3], by cell, bin of `bin_of` and channel.
    """
    resolution = math.isqrt(flux.shape[1])
    intensity = flux / bin_solid_angles(resolution)[:, None]
    have, wanted = solid_angles(resolution) @ intensity.sum(axis=0), flux.sum(axis=(0, 1))
    intensity *= np.divide(wanted, have, out=np.zeros_like(have), where=have > 0)
    return intensity


def bordered(values: NDArray[Number], width: int) -> NDArray[Number]:
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
    x, y, z = np.abs(direction).T
    width = 1 / resolution
    distance = np.maximum(x + y + z, (np.maximum(x, y) + z) / (1 - width))
    place = np.stack([x, y]) / np.maximum(distance, z / (1 - 2 * width))
    (s, t), crossed = _between_middles_array(place, resolution)
    # As in `_from_paraboloid`.
    a, b = slope = 1 - 2 * place
    half = 1 - s * b - t * a
    root = np.sqrt(np.maximum(half**2 - 4 * a * b * s * t, 0))
    divisor = resolution * np.where(crossed, half + root, 1)
    place += np.where(crossed, 4 * s * t / divisor, 0) * slope
    place = np.where(direction[:, 2] < 0, 1 - place[::-1], place)
    u, v = np.copysign(place, direction[:, :2].T)
    bins = bordered(np.arange(resolution**2).reshape(resolution, resolution), 1)
    # The middle of bin 0 is at 1 in the map with its border.
    column, row = ((each + 1) * (resolution / 2) + 0.5 for each in (u, v))
    left, top = (np.clip(each.astype(np.int64), 0, resolution) for each in (column, row))
    right, bottom = column - left, row - top
    found = [bins[top + i, left + j] for i in (0, 1) for j in (0, 1)]
    weights = [a * b for a in (1 - bottom, bottom) for b in (1 - right, right)]
    return np.stack(found, axis=1), np.stack(weights, axis=1)


def middle_directions(resolution: int) -> NDArray[np.float64]:
    """Unit direction [R², 3] in the middle of each bin."""
    return parts_of_bins(resolution, 1)[0].reshape(-1, 3)


def parts_of_bins(resolution: int, parts: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bins that are divided into parts of equal size on the map.

    Args:
        resolution: bins a side, R.
        parts: of a bin, a side.

    Returns:
        Unit direction [R parts, R parts, 3] in the middle of each part, by row and column; and the
        solid angle there over area on the map [R parts, R parts].
    """
    size, width = resolution * parts, 1 / resolution
    centres = (np.arange(size) + 0.5) * (2 / size) - 1
    u, v = np.meshgrid(centres, centres)
    lower = np.abs(u) + np.abs(v) > 1
    x = np.where(lower, 1 - np.abs(v), np.abs(u))
    y = np.where(lower, 1 - np.abs(u), np.abs(v))
    z = 1 - np.maximum(x, width) - np.maximum(y, width)
    solid = np.where(z < 0, 0, 1 - width * (x < width) - width * (y < width))
    # As in `_bevelled`.
    (s, t), crossed = _between_middles_array(np.stack([x, y]), resolution)
    fold = np.where(crossed, s * t * (2 * width), 0)
    x, y = x - fold, y - fold
    solid = np.where(crossed, x * (1 - s + t) + y * (1 + s - t) + z * (1 - s - t), solid)
    height = np.where(lower, -1, 1) * np.maximum(z, 0)
    points = np.stack([np.copysign(x, u), np.copysign(y, v), height], axis=-1)
    length = np.linalg.norm(points, axis=-1)
    return points / length[..., None], solid / length**3


def _between_middles_array(
    place: NDArray[np.float64], resolution: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """As `_between_middles`, of places [2, ...]."""
    scaled = place * (resolution / 2) - 0.5
    first = np.floor(scaled)
    return scaled - first, (first.sum(axis=0) + 2 == resolution / 2) & (first.min(axis=0) >= 0)
