"""Boxes around the cells of a grid that shine, small where they are bright."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

# Cells are grouped by light: a group's brightest has this many times that of its darkest.
_GROUP_RATIO = 8.0
_NUM_GROUPS = 4


@dataclasses.dataclass(frozen=True)
class _Cluster:
    """Cells, and the division in two that saves most."""

    cells: NDArray[np.int64]
    gain: float
    halves: tuple[NDArray[np.int64], ...]


def cluster_cells(
    power: NDArray[np.float64], cell: NDArray[np.float64], count: int
) -> list[NDArray[np.int64]]:
    """Clusters of cells that shine, for each of which its bounding box is to be sampled uniformly.

    Cells are first grouped by brightness, so that a box of bright cells is not widened by a glow
    around them, then the cluster is divided that gains most, again and again. The cost of a
    cluster is the root of its box's area times the sum of squared light in it: added up, that is the
    root of the second moment of an estimator that takes boxes in the best proportion and points
    uniformly in each.

    Args:
        power: [X, Y, Z] light that leaves from each cell.
        cell: [3] sides of a cell, any unit.
        count: most clusters.

    Returns:
        Cells [M, 3] of each cluster. All cells of the grid where nothing shines.
    """
    lit = np.argwhere(power > 0)
    if not len(lit):
        return [np.argwhere(power == 0)]
    squared = power**2
    values = power[tuple(lit.T)]
    group = np.log(values.max() / values) / np.log(_GROUP_RATIO)
    group = np.minimum(group.astype(int), _NUM_GROUPS - 1)
    clusters = [_divide(lit[group == g], squared, cell) for g in np.unique(group)]
    while len(clusters) < count:
        best = max(range(len(clusters)), key=lambda index: clusters[index].gain)
        if clusters[best].gain <= 0:
            break
        halves = clusters.pop(best).halves
        clusters += [_divide(half, squared, cell) for half in halves]
    return [cluster.cells for cluster in clusters]


def _divide(
    cells: NDArray[np.int64], squared: NDArray[np.float64], cell: NDArray[np.float64]
) -> _Cluster:
    """Cluster of these cells with the plane that divides it best."""
    best = _Cluster(cells, 0.0, ())
    for axis in range(3):
        order = np.argsort(cells[:, axis], kind="stable")
        ordered = cells[order]
        values = squared[tuple(ordered.T)]
        below, above = _costs(ordered, values, cell), _costs(ordered[::-1], values[::-1], cell)[::-1]
        # A plane lies where the coordinate steps up.
        planes = np.flatnonzero(np.diff(ordered[:, axis])) + 1
        if not len(planes):
            continue
        costs = below[planes - 1] + above[planes]
        gain = float(below[-1] - costs.min())
        if gain > best.gain:
            plane = planes[costs.argmin()]
            best = _Cluster(cells, gain, (ordered[:plane], ordered[plane:]))
    return best


def _costs(
    cells: NDArray[np.int64], squared: NDArray[np.float64], cell: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Cost [M] of the first 1, 2, ... M cells."""
    lower, upper = np.minimum.accumulate(cells), np.maximum.accumulate(cells) + 1
    x, y, z = ((upper - lower) * cell).T
    return np.sqrt((x * y + y * z + z * x) * np.cumsum(squared))
