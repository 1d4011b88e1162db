"""The training set: every captured ray that crosses an occupied cell of the luminaire's box.

Symbols
    grid         boolean cells over the bounding box; density is 0 outside of the true cells
    bin          one of K equal intervals of a ray within the box, occupied or not
    V            views
    N            rays kept
    radiance     captured HDR radiance, clipped at max_radiance
    held out     rays at multiples of a stride, which are not used for training

Memory: 22 bytes per ray (view 2, pixel 4, radiance 12, opacity 4). A hundred views of 800² pixels
have 64 million rays, of which about half cross the box: 0.7 to 1.4 GB.
"""

import dataclasses
import math
from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.frames import orthographic_rays
from lumitree.core.reading import Arrays
from lumitree.errors import LumitreeError
from lumitree.lamp.dataset import Dataset, OpacityKind, visual_hull

# Number of cells along the longest side of the box, whose length is 2 local units.
HULL_RESOLUTION = 128


class Occupancy(NamedTuple):
    """Grid [nx, ny, nz] of cells that may be occupied, over the box of `half_extents` [3]."""

    cells: jax.Array | NDArray[np.bool_]
    half_extents: jax.Array | NDArray[np.float32]

    def arrays(self) -> Arrays:
        """The grid as arrays for a checkpoint, its cells as packed bits."""
        cells = np.asarray(self.cells)
        return {
            "occupied": np.packbits(cells),
            "grid": np.array(cells.shape, np.int32),
            "half_extents": np.asarray(self.half_extents),
        }

    @staticmethod
    def of_arrays(arrays: Arrays) -> "Occupancy":
        """The grid of `arrays`."""
        shape = arrays["grid"].tolist()
        cells = np.unpackbits(arrays["occupied"], count=math.prod(shape)).astype(bool)
        return Occupancy(cells.reshape(shape), arrays["half_extents"].astype(np.float32))


def full_occupancy(half_extents: ArrayLike) -> Occupancy:
    """Grid whose only cell is the whole box, so that no part of it is skipped."""
    return Occupancy(np.ones((1, 1, 1), bool), np.asarray(half_extents, np.float32))


def dilated_hull(
    views: Iterable[tuple[NDArray[np.float64], NDArray[np.bool_]]],
    half_width: float,
    half_extents: ArrayLike,
    resolution: int = HULL_RESOLUTION,
) -> Occupancy:
    """The visual hull, dilated by one cell; arguments as for `visual_hull`.

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


def _dilate(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    for axis in range(3):
        front = np.moveaxis(cells, axis, 0)
        wide = front.copy()
        wide[1:] |= front[:-1]
        wide[:-1] |= front[1:]
        cells = np.moveaxis(wide, 0, axis)
    return cells


NUM_HELD_OUT = 4096


class Batch(NamedTuple):
    """R rays: origins and unit directions of travel [R, 3], radiance [R, 3], opacity [R]."""

    origins: jax.Array
    directions: jax.Array
    radiance: jax.Array
    opacity: jax.Array


@dataclasses.dataclass(frozen=True)
class RaySet:
    """All rays of a dataset that cross an occupied part of the bounding box.

    Attributes:
        corners: [V, 3] origins of the rays of each view's first pixel, local frame.
        column_steps, row_steps: [V, 3] offset to the origin of the next pixel in the row, and in
            the column.
        directions: [V, 3] directions of travel of each view.
        resolution: pixels per side of a view.
        view: [N] uint16 index of each ray's view.
        pixel: [N] uint32 index of each ray's pixel, row by row.
        radiance: [N, 3] clipped at `max_radiance`.
        opacity: [N] in [0, 1].
        max_radiance: L_max, > 0.
    """

    corners: NDArray[np.float32]
    column_steps: NDArray[np.float32]
    row_steps: NDArray[np.float32]
    directions: NDArray[np.float32]
    resolution: int
    view: NDArray[np.uint16]
    pixel: NDArray[np.uint32]
    radiance: NDArray[np.float32]
    opacity: NDArray[np.float32]
    max_radiance: float

    def batch(self, index: NDArray[np.integer]) -> Batch:
        """The rays at `index` [R]."""
        view = self.view[index]
        row, column = np.divmod(self.pixel[index].astype(np.int64), self.resolution)
        origins = (
            self.corners[view]
            + column[:, None].astype(np.float32) * self.column_steps[view]
            + row[:, None].astype(np.float32) * self.row_steps[view]
        )
        rays = (origins, self.directions[view], self.radiance[index], self.opacity[index])
        return Batch(*map(jnp.asarray, rays))

    def draw(self, seed: int, step: int, count: int) -> Batch:
        """The random batch of a step; it depends on the arguments only, so that runs can resume."""
        stride = self._held_out_stride
        # Indices of the rays that are not held out, in order.
        num_trained = len(self.view) - -(-len(self.view) // stride)
        drawn = np.random.default_rng((seed, step)).integers(0, num_trained, count)
        return self.batch(drawn + 1 + drawn // (stride - 1))

    @property
    def typical_part(self) -> float:
        """Geometric mean of the lit rays' channels over `max_radiance`, clipped to [1e-4, 0.5]."""
        sample = self.radiance[:: max(1, len(self.radiance) // 1_000_000)]
        lit = sample[sample > 0] / self.max_radiance
        mean = float(np.exp(np.log(lit).mean())) if lit.size else 1e-4
        return min(max(mean, 1e-4), 0.5)

    def held_out(self) -> Batch:
        """At most NUM_HELD_OUT rays that `draw` never returns; at most half of the rays."""
        return self.batch(np.arange(0, len(self.view), self._held_out_stride)[:NUM_HELD_OUT])

    @property
    def _held_out_stride(self) -> int:
        return max(2, len(self.view) // NUM_HELD_OUT)


def load_rays(dataset: Dataset, kind: OpacityKind, skip_empty: bool) -> tuple[RaySet, Occupancy]:
    """Read all views and keep the rays that cross an occupied part of the box.

    All other rays have radiance 0 and opacity 0, in the captured views and in the field. Without
    `skip_empty` the whole box counts as occupied.

    Raises:
        LumitreeError: views are missing or damaged, or all of them are black.
    """
    manifest = dataset.manifest
    if len(manifest.frames) > np.iinfo(np.uint16).max:
        raise LumitreeError(f"{len(manifest.frames)} views are too many; capture at most 65535")
    views = list(dataset.views())
    highest = dataset.max_radiance(views)
    if skip_empty:
        masks = ((view.frame.pose, view.geometric > 0) for view in views)
        occupancy = dilated_hull(masks, manifest.half_width, manifest.local_frame.half_extents)
    else:
        occupancy = full_occupancy(manifest.local_frame.half_extents)
    geometry, kept = [], []
    for view in views:
        origins, direction = orthographic_rays(
            view.frame.pose, manifest.half_width, manifest.resolution
        )
        steps = max(origins.shape[0] - 1, 1)
        column_step = (origins[0, -1] - origins[0, 0]) / steps
        row_step = (origins[-1, 0] - origins[0, 0]) / steps
        geometry.append((origins[0, 0], column_step, row_step, direction))
        # Row by row, because the bins of a whole view take gigabytes.
        crossing = _crossing_rows(occupancy, jnp.asarray(origins), jnp.asarray(direction))
        kept.append(np.flatnonzero(np.asarray(crossing)))
    if (count := sum(map(len, kept))) < 2:
        rays = "one ray" if count else "no ray"
        raise LumitreeError(
            f"{rays} of {dataset.folder} crosses the luminaire; capture it again, with more pixels"
        )
    corners, column_steps, row_steps, directions = (
        np.stack(x) for x in zip(*geometry, strict=True)
    )
    rays = RaySet(
        corners,
        column_steps,
        row_steps,
        directions,
        manifest.resolution,
        view=np.repeat(np.arange(len(views), dtype=np.uint16), [len(p) for p in kept]),
        pixel=np.concatenate(kept).astype(np.uint32),
        radiance=_gather([view.radiance.reshape(-1, 3) for view in views], kept, highest),
        opacity=_gather([view.opacity(kind).ravel() for view in views], kept, 1.0),
        max_radiance=highest,
    )
    return rays, occupancy


@jax.jit
def _crossing_rows(occupancy: Occupancy, origins: jax.Array, direction: jax.Array) -> jax.Array:
    def row(row_origins: jax.Array) -> jax.Array:
        directions = jnp.broadcast_to(direction, row_origins.shape)
        return jnp.any(occupied_bins(occupancy, row_origins, directions)[0], axis=-1)

    return jax.lax.map(row, origins).ravel()


def _gather(
    values: list[NDArray[np.float32]], kept: list[NDArray[np.intp]], limit: float
) -> NDArray[np.float32]:
    """Rows with the indices `kept` of all views, clipped to [0, limit]."""
    rows = [value[pixels] for value, pixels in zip(values, kept, strict=True)]
    return np.clip(np.concatenate(rows), 0, limit)
