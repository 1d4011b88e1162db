"""Occupancy grid of a luminaire, from the visual hull of its masks, and lookups in it.

Symbols
    grid         boolean cells over the bounding box; density is 0 outside of the true cells
    bin          one of K equal intervals of a ray within the box, occupied or not
"""

import math
import os
from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.files import atomic_path
from lumitree.core.reading import read_arrays
from lumitree.core.visual_hull import visual_hull
from lumitree.errors import LumitreeError

# Number of cells along the longest side of the box, whose length is 2 local units.
HULL_RESOLUTION = 128


class Occupancy(NamedTuple):
    """Grid [nx, ny, nz] of cells that may be occupied, over the box of `half_extents` [3]."""

    cells: jax.Array | NDArray[np.bool_]
    half_extents: jax.Array | NDArray[np.float32]


def full_occupancy(half_extents: ArrayLike) -> Occupancy:
    """Grid whose only cell is the whole box, so that no part of it is skipped."""
    return Occupancy(np.ones((1, 1, 1), bool), np.asarray(half_extents, np.float32))


def dilated_hull(
    views: Iterable[tuple[NDArray[np.float64], NDArray[np.bool_]]],
    half_width: float,
    half_extents: ArrayLike,
    resolution: int = HULL_RESOLUTION,
) -> Occupancy:
    """The visual hull, dilated by one cell; arguments as for `core.visual_hull`.

    Because of the dilation, the lookup at the centre of a bin is valid for the whole bin.
    """
    cells = visual_hull(views, half_width, half_extents, resolution)
    return Occupancy(_dilate(cells), np.asarray(half_extents, np.float32))


def contains(occupancy: Occupancy, positions: jax.Array) -> jax.Array:
    """Whether positions [..., 3] lie in the box and in a cell that may be occupied."""
    shape = jnp.array(occupancy.cells.shape)
    unit = positions / occupancy.half_extents
    index = jnp.clip(jnp.floor((unit + 1) / 2 * shape).astype(jnp.int32), 0, shape - 1)
    flat = (index[..., 0] * shape[1] + index[..., 1]) * shape[2] + index[..., 2]
    cell = jnp.ravel(occupancy.cells).at[flat].get(mode="promise_in_bounds")
    # By rounding, the ends of a ray's interval may lie slightly outside of the box.
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
    """Which of the K bins of every ray are occupied.

    K is the largest number of cells along an axis. Half a bin is then shorter than a cell along
    every axis. As the hull was dilated by one cell, one lookup at the centre of a bin suffices.

    Returns:
        Occupied [R, K], distance [R] at which the ray enters the box, and length [R] of a bin.
    """
    num_bins = max(occupancy.cells.shape)
    near, far = box_interval(origins, directions, occupancy.half_extents)
    length = (far - near) / num_bins
    centres = near[:, None] + (jnp.arange(num_bins) + 0.5) * length[:, None]
    positions = origins[:, None, :] + centres[..., None] * directions[:, None, :]
    return contains(occupancy, positions) & (length > 0)[:, None], near, length


def save_occupancy(path: str | os.PathLike[str], occupancy: Occupancy) -> None:
    """Write the grid as an `.npz` archive, its cells as packed bits, atomically."""
    cells = np.asarray(occupancy.cells)
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(
            file,
            bits=np.packbits(cells),
            shape=np.array(cells.shape, np.int32),
            half_extents=np.asarray(occupancy.half_extents),
        )


def load_occupancy(path: str | os.PathLike[str]) -> Occupancy:
    """Read what `save_occupancy` wrote; refuses a missing or damaged file."""
    try:
        arrays = read_arrays(path, "bits", "shape", "half_extents")
    except LumitreeError as error:
        raise LumitreeError(f"not a readable occupancy grid: {error}; train again") from None
    bits, shape, half_extents = arrays.values()
    # In Python's integers, which do not overflow.
    count = math.prod(shape.tolist()) if shape.dtype == np.int32 and shape.shape == (3,) else 0
    if (
        not (count > 0 and min(shape) > 0 and bits.shape == (-(-count // 8),))
        or bits.dtype != np.uint8
        or half_extents.dtype.kind != "f"
        or half_extents.shape != (3,)
    ):
        raise LumitreeError(f"{path} is not a readable occupancy grid; train again")
    cells = np.unpackbits(bits, count=count).astype(bool).reshape(shape)
    return Occupancy(cells, half_extents.astype(np.float32))


def _dilate(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    for axis in range(3):
        front = np.moveaxis(cells, axis, 0)
        wide = front.copy()
        wide[1:] |= front[:-1]
        wide[:-1] |= front[1:]
        cells = np.moveaxis(wide, 0, axis)
    return cells
