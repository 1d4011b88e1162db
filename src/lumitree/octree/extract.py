"""Distilling a continuous field into an octree ("Creating the plenoctree" in the paper)."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from lumitree.core.frames import radical_inverse
from lumitree.core.progress import progress
from lumitree.errors import LumitreeError
from lumitree.octree.build import build_children, check_tree_depth, child_cells

# positions [N, 3] in local units -> density [N], coefficients [N, 3, K]
Query = Callable[[NDArray[np.float32]], tuple[NDArray[np.float32], NDArray[np.float32]]]

# The coarse-to-fine search starts here, with this many positions a side in each cell.
_START_LEVEL = 5
_START_SIDE = 4
# Positions of a query; with l_max 4 that is 320 MiB of coefficients, the peak.
_CHUNK = 1 << 20


def extract(
    query: Query,
    half_extents: NDArray[np.float64],
    tree_depth: int,
    *,
    min_density: float = 0.01,
    samples_per_leaf: int = 256,
) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float16]]:
    """Octree of a field: `children`, `density` and `coefficients` as in `Asset`.

    Cells are searched coarse to fine; a finest cell becomes a leaf if the density at its centre
    is above `min_density`, and then gets averages over `samples_per_leaf` positions.

    Args:
        query: the field.
        half_extents: [3] proxy box, local units; nothing outside is looked at.
        tree_depth: level of the leaves, 1 to 10.
        min_density: pruning threshold, per local unit of length.
        samples_per_leaf: positions averaged in a leaf.

    Memory: the result plus at most about 0.5 GiB, at any depth.
    """
    check_tree_depth(tree_depth)
    cells = _find_dense_cells(query, half_extents, tree_depth, min_density)
    if not len(cells):
        raise LumitreeError(
            f"the field is empty: no density above {min_density} at depth {tree_depth}; train "
            "longer or extract deeper"
        )
    density, coefficients = _average_leaves(
        query, half_extents, cells, tree_depth, samples_per_leaf
    )
    children = build_children(cells, np.full(len(cells), tree_depth))
    return children, density, coefficients


def _find_dense_cells(
    query: Query, half_extents: NDArray[np.float64], tree_depth: int, min_density: float
) -> NDArray[np.int32]:
    """Integer coordinates [M, 3] of the dense cells at `tree_depth`."""
    level = min(_START_LEVEL, tree_depth)
    side = 1 << level
    cells = np.stack(np.meshgrid(*[np.arange(side, dtype=np.int32)] * 3, indexing="ij"), -1)
    cells = cells.reshape(-1, 3)
    while True:
        # A leaf is judged by its centre, as in the paper; coarser cells by more positions.
        count = 1 if level == tree_depth else _START_SIDE if level == _START_LEVEL else 2
        steps = (np.arange(count) + 0.5) / count
        offsets = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
        kept = []
        for chunk in _chunks(cells, count**3):
            density, _ = _query_inside(query, half_extents, chunk, level, offsets)
            kept.append(chunk[np.any(density > min_density, axis=1)])
        cells = np.concatenate(kept) if kept else cells[:0]
        if level == tree_depth:
            return cells
        cells = child_cells(cells).reshape(-1, 3)
        level += 1


def _average_leaves(
    query: Query,
    half_extents: NDArray[np.float64],
    cells: NDArray[np.int32],
    tree_depth: int,
    samples: int,
) -> tuple[NDArray[np.float32], NDArray[np.float16]]:
    """Mean density [M] and coefficients [M, 3, K] over a Halton(2, 3, 5) set in each cell."""
    offsets = np.array(
        [[radical_inverse(i + 1, base) for base in (2, 3, 5)] for i in range(samples)]
    )
    densities, coefficients = [], []
    with progress("extract", len(cells)) as advance:
        for chunk in _chunks(cells, samples):
            density, values = _query_inside(query, half_extents, chunk, tree_depth, offsets)
            densities.append(density.mean(axis=1))
            coefficients.append(values.mean(axis=1).astype(np.float16))
            advance(len(chunk))
    return np.concatenate(densities).astype(np.float32), np.concatenate(coefficients)


def _query_inside(
    query: Query,
    half_extents: NDArray[np.float64],
    cells: NDArray[np.int32],
    level: int,
    offsets: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Field at `offsets` [S, 3] in [0, 1)³ of each cell: density [M, S], coefficients [M, S, 3, K].

    Cells count with their part inside the proxy box. The density is 0 in cells outside.
    """
    side = 2 / (1 << level)
    lower = np.maximum(cells * side - 1, -half_extents)
    upper = np.minimum((cells + 1) * side - 1, half_extents)
    positions = lower[:, None, :] + offsets * (upper - lower)[:, None, :]
    density, coefficients = query(positions.reshape(-1, 3).astype(np.float32))
    shape = positions.shape[:2]
    inside = np.all(lower < upper, axis=-1)
    density = density.reshape(shape) * inside[:, None]
    return density, coefficients.reshape(*shape, *coefficients.shape[1:])


def _chunks(cells: NDArray[np.int32], samples: int) -> Iterator[NDArray[np.int32]]:
    size = max(1, _CHUNK // samples)
    for start in range(0, len(cells), size):
        yield cells[start : start + size]
