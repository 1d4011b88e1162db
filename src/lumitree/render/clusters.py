"""Boxes around the cells of a grid that shine, small where they are bright."""

import numpy as np
from numpy.typing import NDArray

# Cells that hold the last part of the light need no box.
_NEGLECTED = 0.005
# In a block, cells whose light differs by more than about this factor start in clusters of their
# own, so that a box of bright cells is not widened by a glow around them.
_GROUP_RATIO = 8.0
_NUM_GROUPS = 4
# Most clusters to begin with: bounds the table of pairs.
_FIRST_CLUSTERS = 1024
# A merger that costs less than this part of the whole saves more time than it adds variance.
_WORTH = 0.001


def cluster_cells(
    power: NDArray[np.float64], cell: NDArray[np.float64], count: int
) -> list[NDArray[np.int64]]:
    """Clusters of cells that shine, each to be sampled by points on its bounding box.

    Blocks of cells are merged, two at a time, those whose merging costs least. The cost of a
    cluster is the root of its box's area times the sum of squared light in it: added up, that is
    the root of the second moment of an estimator that takes boxes in the best proportion and points
    uniformly in each.

    Args:
        power: [X, Y, Z] light that leaves from each cell.
        cell: [3] sides of a cell, any unit.
        count: most clusters; there are fewer where more would not pay.

    Returns:
        Cells [M, 3] of each cluster. One cluster of the whole grid where nothing shines.
    """
    cells, values = _bright_cells(power)
    if not len(cells):
        return [np.argwhere(power == 0)]
    label = _blocks(cells, values)
    boxes = _Boxes(label, cells * cell, (cells + 1) * cell, values**2)
    while boxes.num_alive > 1:
        i, j, increase = boxes.cheapest()
        if boxes.num_alive <= count and increase > _WORTH * boxes.total_cost():
            break
        boxes.merge(i, j)
        label[label == j] = i
    return [cells[label == index] for index in np.unique(label)]


class _Boxes:
    """Boxes that are merged; a merged one leaves a gap whose cost, and cost of merging, is inf.

    Args:
        label: int [M] box of each cell.
        lower, upper: [M, 3] corners of each cell.
        squared: [M] squared light of each cell.
    """

    def __init__(self, label, lower, upper, squared):
        self.num_alive = int(label.max()) + 1
        self._lower, self._upper = np.full((2, self.num_alive, 3), [[[np.inf]], [[-np.inf]]])
        np.minimum.at(self._lower, label, lower)
        np.maximum.at(self._upper, label, upper)
        self._squared = np.bincount(label, squared)
        self._cost = _cost(self._lower, self._upper, self._squared)
        self._increase = np.stack([self._increases(i) for i in range(self.num_alive)])

    def total_cost(self):
        return self._cost[np.isfinite(self._cost)].sum()

    def cheapest(self):
        """The two whose merging adds least cost, and how much."""
        i, j = np.unravel_index(self._increase.argmin(), self._increase.shape)
        return i, j, self._increase[i, j]

    def merge(self, i, j):
        """Make box i hold j too, and drop j."""
        self._lower[i] = np.minimum(self._lower[i], self._lower[j])
        self._upper[i] = np.maximum(self._upper[i], self._upper[j])
        self._squared[i] += self._squared[j]
        self._cost[i] = _cost(self._lower[[i]], self._upper[[i]], self._squared[[i]])[0]
        self._cost[j] = np.inf
        self._increase[j], self._increase[:, j] = np.inf, np.inf
        self._increase[i] = self._increase[:, i] = self._increases(i)
        self.num_alive -= 1

    def _increases(self, i):
        lower, upper = (
            np.minimum(self._lower, self._lower[i]),
            np.maximum(self._upper, self._upper[i]),
        )
        together = _cost(lower, upper, self._squared + self._squared[i])
        gone = np.isinf(self._cost)
        increase = np.where(gone, np.inf, together - np.where(gone, 0, self._cost) - self._cost[i])
        increase[i] = np.inf
        return increase


def _bright_cells(power):
    """Cells [M, 3] that hold nearly all of the light, brightest first, and the light in them."""
    order = np.argsort(power, axis=None)[::-1]
    values = power.ravel()[order]
    held = np.cumsum(values)
    kept = int(np.searchsorted(held, (1 - _NEGLECTED) * held[-1])) + 1 if held[-1] > 0 else 0
    return np.stack(np.unravel_index(order[:kept], power.shape), axis=1), values[:kept]


def _blocks(cells, values):
    """Label [M] of each cell by block and brightness; the smallest blocks that are few enough."""
    group = (np.log(values[0] / values) / np.log(_GROUP_RATIO)).astype(np.int64)
    group = np.minimum(group, _NUM_GROUPS - 1)[:, None]
    side = 1
    while True:
        _, label = np.unique(np.hstack([cells // side, group]), axis=0, return_inverse=True)
        if label.max() < _FIRST_CLUSTERS:
            return label.ravel()
        side *= 2


def _cost(lower, upper, squared):
    x, y, z = (upper - lower).T
    return np.sqrt((x * y + y * z + z * x) * squared)
