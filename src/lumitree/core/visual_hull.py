"""The visual hull of a luminaire's masks: where it can be at all.

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
    """Cells [nx, ny, nz] of a box that no view sees to be empty.

    A cell is carved if in some view every pixel of its footprint, and of a margin of one pixel,
    is background. No cell that a captured ray hit is carved.

    Args:
        views: pairs of `proxy_from_camera` [4, 4] and mask [H, H], true where a ray hit anything.
        half_width: half the side of the views, local units.
        half_extents: [3] of the box, local units.
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
    return cells


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
