"""Reference implementation of the field's integral: every leaf and every ray, in float64."""

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.frames import towards_viewer
from lumitree.core.harmonics import basis_array
from lumitree.core.transmittance import transmittance


def leaf_boxes(asset: Asset) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower and upper corners [M, 3] of all leaves, local units, by leaf index."""
    lower = np.zeros((asset.num_leaves, 3))
    upper = np.zeros((asset.num_leaves, 3))
    stack = [(0, np.full(3, -1.0), 2.0)]
    while stack:
        node, corner, side = stack.pop()
        for octant in range(8):
            child = asset.children[node, octant]
            start = corner + side / 2 * np.array([octant & 1, octant >> 1 & 1, octant >> 2])
            if child > 0:
                stack.append((child, start, side / 2))
            elif child < 0:
                lower[~child], upper[~child] = start, start + side / 2
    return lower, upper


def integrate_ray(
    asset: Asset, origin: NDArray[np.float64], direction: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Emission [3] (Eq. 3) and transmittance (Eq. 4) along a whole line through the proxy box.

    Args:
        origin: [3] any point of the line, local units.
        direction: [3] unit direction of travel, local frame.
    """
    lower, upper = leaf_boxes(asset)
    entry, exit_ = _slab(origin, direction, lower, upper)
    box_entry, box_exit = _slab(
        origin, direction, -asset.frame.half_extents[None], asset.frame.half_extents[None]
    )
    entry, exit_ = np.maximum(entry, box_entry), np.minimum(exit_, box_exit)
    order = np.argsort(entry, kind="stable")
    order = order[exit_[order] > entry[order]]
    y = basis_array(towards_viewer(direction), asset.l_max)
    logits = asset.coefficients[order].astype(np.float64) @ y
    emission = asset.max_radiance * np.array(asset.light_factors) / (1 + np.exp(-logits))
    depth = asset.density[order].astype(np.float64) * (exit_ - entry)[order]
    after = transmittance(np.cumsum(depth), asset.law, np)
    before = np.concatenate([[1.0], after[:-1]])[: len(after)]
    total = after[-1] if len(after) else 1.0
    return (before - after) @ emission.reshape(-1, 3), float(total)


def _slab(
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Entry and exit distances [M] of a line through boxes [M, 3]; entry > exit where it misses."""
    entry = np.full(len(lower), -np.inf)
    exit_ = np.full(len(lower), np.inf)
    for axis in range(3):
        if direction[axis] == 0:
            outside = (origin[axis] < lower[:, axis]) | (origin[axis] >= upper[:, axis])
            exit_ = np.where(outside, -np.inf, exit_)
            continue
        first = (lower[:, axis] - origin[axis]) / direction[axis]
        second = (upper[:, axis] - origin[axis]) / direction[axis]
        entry = np.maximum(entry, np.minimum(first, second))
        exit_ = np.minimum(exit_, np.maximum(first, second))
    return entry, exit_
