"""The visual hull of a luminaire: the region that its masks do not show to be empty.

Symbols
    footprint    pixels of a view onto which a cell projects
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray


def visual_hull(
    views: Iterable[tuple[NDArray[np.float64], NDArray[np.bool_]]],
    half_width: float,
    half_extents: ArrayLike,
    resolution: int,
) -> NDArray[np.bool_]:
    """Cells [nx, ny, nz] of a box that no view shows to be empty.

    A cell is removed if in some view all pixels of its footprint, and of a margin of one pixel
    around it, are background. No cell that a captured ray hit is removed.

    Args:
        views: pairs of `local_from_camera` [4, 4] and mask [H, H], true where a ray hit anything.
        half_width: half the side of the views, local units.
        half_extents: [3] half the sides of the box, local units.
        resolution: number of cells along 2 local units.
    """
    half = np.asarray(half_extents, np.float64)
    shape = np.maximum(np.ceil(half * resolution), 1).astype(int)
    # Only the remaining cells are projected, so each view costs less than the one before.
    alive = np.stack(np.unravel_index(np.arange(shape.prod()), shape)).astype(np.int16)
    for pose, mask in views:
        size = mask.shape[0]
        # Pixels per local unit; rows are counted downwards, against the camera's y.
        scale = size / (2 * half_width)
        row, row_reach = _footprint(alive, shape, half, -scale * pose[:, 1], pose, size)
        column, column_reach = _footprint(alive, shape, half, scale * pose[:, 0], pose, size)
        near = _max_filter(_max_filter(mask, row_reach).T, column_reach).T
        # A cell outside of the image is kept.
        kept = (row < 0) | (row >= size) | (column < 0) | (column >= size)
        kept[~kept] = near[row[~kept], column[~kept]]
        alive = alive[:, kept]
    cells = np.zeros(shape, bool)
    cells[tuple(alive)] = True
    return cells


def _footprint(
    cells: NDArray[np.int16],
    shape: NDArray[np.int_],
    half: NDArray[np.float64],
    slope: NDArray[np.float64],
    pose: NDArray[np.float64],
    size: int,
) -> tuple[NDArray[np.int32], int]:
    """Projection of cells onto one axis of a view, with the pose `local_from_camera`.

    Args:
        cells: [3, N] indices in a grid of `shape` over the box of half extents `half`.
        slope: [4] pixels per local unit along x, y and z; the last element is not used.

    Returns:
        Pixel [N] of each cell's centre, and half the width of its footprint with the margin, in
        pixels.
    """
    pixel = np.full(cells.shape[1], size / 2 - slope[:3] @ pose[:3, 3], np.float32)
    for index, count, extent, factor in zip(cells, shape, half, slope[:3], strict=True):
        centres = ((np.arange(count) + 0.5) / count * 2 - 1) * extent * factor
        pixel += centres.astype(np.float32)[index]
    reach = int(np.ceil(np.abs(slope[:3]) @ (half / shape))) + 1
    return np.floor(pixel).astype(np.int32), reach


def _max_filter(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Whether any pixel within `reach` rows is true, from differences of cumulative sums."""
    sums = np.cumsum(mask, axis=0, dtype=np.int32)
    sums = np.concatenate([np.zeros_like(sums[:1]), sums])
    rows = np.arange(mask.shape[0])
    return sums[np.minimum(rows + reach + 1, len(rows))] > sums[np.maximum(rows - reach, 0)]
