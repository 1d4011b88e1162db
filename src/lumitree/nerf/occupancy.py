"""Where a luminaire can be at all: the visual hull of its masks, and lookups in it.

Symbols
    grid         boolean cells over the proxy box; outside of the true ones density is 0
    bin          one of K equal pieces of a ray's chord through the box, occupied or not
    footprint    pixels of a view onto which a cell projects
"""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.files import atomic_path
from lumitree.errors import LumitreeError

# Cells along the box's longest side, whose length is 2 local units.
HULL_RESOLUTION = 128


class Occupancy(NamedTuple):
    """Cells [nx, ny, nz] that may hold something, over the box of `half_extents` [3]."""

    cells: jax.Array | NDArray[np.bool_]
    half_extents: jax.Array | NDArray[np.float32]


def full_occupancy(half_extents: ArrayLike) -> Occupancy:
    """A grid of one cell, the whole box: nothing is skipped."""
    return Occupancy(np.ones((1, 1, 1), bool), np.asarray(half_extents, np.float32))


def visual_hull(
    views: Iterable[tuple[NDArray[np.float64], NDArray[np.bool_]]],
    half_width: float,
    half_extents: ArrayLike,
    resolution: int = HULL_RESOLUTION,
) -> Occupancy:
    """Cells that no view sees to be empty, plus one cell all around.

    A cell is carved if in some view every pixel of its footprint, and of a margin of one pixel,
    is background. No cell that a captured ray hit is carved; the cell all around makes the
    lookup at a bin's centre hold for the whole bin.

    Args:
        views: pairs of `proxy_from_camera` [4, 4] and mask [H, H], true where a ray hit anything.
        half_width: half the side of the views, local units.
        half_extents: [3] proxy box, local units.
        resolution: cells along two local units.
    """
    half = np.asarray(half_extents, np.float64)
    shape = np.maximum(np.ceil(half * resolution), 1).astype(int)
    # Only the survivors are projected, so the cost falls with every view.
    alive = np.stack(np.unravel_index(np.arange(shape.prod()), shape)).astype(np.int16)
    for pose, mask in views:
        size = mask.shape[0]
        # Pixels a local unit; rows count down along the camera's y.
        scale = size / (2 * half_width)
        row, row_reach = _footprint(alive, shape, half, -scale * pose[:, 1], pose, size)
        column, column_reach = _footprint(alive, shape, half, scale * pose[:, 0], pose, size)
        near = _max_filter(_max_filter(mask, row_reach).T, column_reach).T
        # A view says nothing about what it does not show.
        kept = (row < 0) | (row >= size) | (column < 0) | (column >= size)
        kept[~kept] = near[row[~kept], column[~kept]]
        alive = alive[:, kept]
    cells = np.zeros(shape, bool)
    cells[tuple(alive)] = True
    return Occupancy(_dilate(cells), half.astype(np.float32))


def contains(occupancy: Occupancy, positions: jax.Array) -> jax.Array:
    """Whether positions [..., 3] lie in the box and in a cell that may hold something."""
    shape = jnp.array(occupancy.cells.shape)
    unit = positions / occupancy.half_extents
    index = jnp.clip(jnp.floor((unit + 1) / 2 * shape).astype(jnp.int32), 0, shape - 1)
    flat = (index[..., 0] * shape[1] + index[..., 1]) * shape[2] + index[..., 2]
    cell = jnp.ravel(occupancy.cells).at[flat].get(mode="promise_in_bounds")
    # Rounding may put the ends of a chord a little outside of the box.
    return cell & (jnp.max(jnp.abs(unit), axis=-1) <= 1 + 1e-5)


def box_interval(
    origins: jax.Array, directions: jax.Array, half_extents: jax.Array | NDArray[np.float32]
) -> tuple[jax.Array, jax.Array]:
    """Distances [R] at which rays [R, 3] enter and leave the box; both 0 where they miss it."""
    parallel = jnp.abs(directions) < 1e-9
    slope = 1 / jnp.where(parallel, 1e-9, directions)
    first, second = (-half_extents - origins) * slope, (half_extents - origins) * slope
    near = jnp.max(jnp.minimum(first, second), axis=-1)
    far = jnp.min(jnp.maximum(first, second), axis=-1)
    hit = (far > near) & (far > 0)
    return jnp.where(hit, jnp.maximum(near, 0), 0), jnp.where(hit, far, 0)


def occupied_bins(
    occupancy: Occupancy, origins: jax.Array, directions: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Which of the K bins of every ray's chord are occupied.

    K is the grid's longest side: half a bin is then less than a cell along each axis, so the
    one lookup at a bin's centre misses nothing of a hull that was widened by one cell.

    Args:
        occupancy: the grid.
        origins, directions: [R, 3], local frame; directions of travel, unit length.

    Returns:
        Occupied [R, K], distance [R] at which the ray enters, and length of a bin [R].
    """
    num_bins = max(occupancy.cells.shape)
    near, far = box_interval(origins, directions, occupancy.half_extents)
    length = (far - near) / num_bins
    centres = near[:, None] + (jnp.arange(num_bins) + 0.5) * length[:, None]
    positions = origins[:, None, :] + centres[..., None] * directions[:, None, :]
    return contains(occupancy, positions) & (length > 0)[:, None], near, length


def save_occupancy(path: str | os.PathLike[str], occupancy: Occupancy) -> None:
    """Write the cells as packed bits beside their shape and box (`.npz`), atomically."""
    cells = np.asarray(occupancy.cells)
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(
            file,
            bits=np.packbits(cells),
            shape=np.array(cells.shape, np.int32),
            half_extents=np.asarray(occupancy.half_extents),
        )


def load_occupancy(path: str | os.PathLike[str]) -> Occupancy:
    """Read what `save_occupancy` wrote.

    Raises:
        LumitreeError: the file is missing or damaged.
    """
    try:
        with np.load(Path(path), allow_pickle=False) as file:
            shape = tuple(int(count) for count in file["shape"])
            count = int(np.prod(shape))
            cells = np.unpackbits(file["bits"], count=count).astype(bool).reshape(shape)
            return Occupancy(cells, file["half_extents"].astype(np.float32))
    except Exception as error:
        raise LumitreeError(
            f"{path} is not a readable occupancy grid ({type(error).__name__}); train again"
        ) from None


def _footprint(
    cells: NDArray[np.int16],
    shape: NDArray[np.int_],
    half: NDArray[np.float64],
    slope: NDArray[np.float64],
    pose: NDArray[np.float64],
    size: int,
) -> tuple[NDArray[np.int32], int]:
    """Where cells fall along one axis of a view.

    Args:
        cells: [3, N] indices in a grid of `shape` over the box of half extents `half`.
        slope: [4] pixels a local unit along x, y and z.
        pose: `proxy_from_camera`.
        size: pixels a side of the view.

    Returns:
        Pixel of each cell's centre [N], and how many pixels its footprint with its margin reaches.
    """
    pixel = np.full(cells.shape[1], size / 2 - slope[:3] @ pose[:3, 3], np.float32)
    for index, count, extent, factor in zip(cells, shape, half, slope[:3], strict=True):
        centres = ((np.arange(count) + 0.5) / count * 2 - 1) * extent * factor
        pixel += centres.astype(np.float32)[index]
    reach = int(np.ceil(np.abs(slope[:3]) @ (half / shape))) + 1
    return np.floor(pixel).astype(np.int32), reach


def _max_filter(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Whether anything is set within `reach` rows, by differences of running sums."""
    sums = np.cumsum(mask, axis=0, dtype=np.int32)
    sums = np.concatenate([np.zeros_like(sums[:1]), sums])
    rows = np.arange(mask.shape[0])
    return sums[np.minimum(rows + reach + 1, len(rows))] > sums[np.maximum(rows - reach, 0)]


def _dilate(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells with their 26 neighbours."""
    for axis in range(3):
        front = np.moveaxis(cells, axis, 0)
        wide = front.copy()
        wide[1:] |= front[:-1]
        wide[:-1] |= front[1:]
        cells = np.moveaxis(wide, 0, axis)
    return cells
