"""Growing the first octree, from coarse cells to fine ones.

The cells of a level in which any ray terminates are divided for the next level.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.octree.config import EstimateConfig
from lumitree.fit.octree.traced import TracedRays
from lumitree.octree.build import build_children, child_cells
from lumitree.octree.traversal import Octree


def grow(rays: TracedRays, level: int, config: EstimateConfig) -> NDArray[np.int64]:
    """Cells [M, 3] of a level that may hold something: those in whose parents rays terminate.

    Args:
        rays: where rays come from.
        level: level of the cells.
        config: the level to start from, and how many rays to trace.
    """
    half = rays.luminaire.frame.half_extents
    current = min(config.start_level, level)
    side = 1 << current
    cells = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)
    cells = cells[inside_box(cells, current, half)]
    while current < level:
        num_rays = max(config.batch_rays, config.growth_rays >> (2 * (level - 1 - current)))
        terminated = _count_terminated(rays, cells, current, num_rays, config.batch_rays)
        cells = child_cells(cells[terminated > 0]).reshape(-1, 3)
        current += 1
        cells = cells[inside_box(cells, current, half)]
    return cells


def inside_box(
    cells: NDArray[np.int64], level: int, half_extents: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether cells [M, 3] reach into the proxy box."""
    side = 2 / (1 << level)
    low = cells * side - 1
    return np.all((low < half_extents) & (low + side > -half_extents), axis=1)


def octree_of(cells: NDArray[np.int64], level: int, half_extents: NDArray[np.float64]) -> Octree:
    """An octree whose leaves are cells [M, 3] of one level."""
    return Octree(build_children(cells, np.full(len(cells), level)), level, half_extents)


def _count_terminated(
    rays: TracedRays, cells: NDArray[np.int64], level: int, num_rays: int, batch_rays: int
) -> NDArray[np.float32]:
    """How many of some random rays terminate in each cell [M]."""
    octree = octree_of(cells, level, rays.luminaire.frame.half_extents)
    count = dr.zeros(mi.Float, len(cells))
    for batch in range(-(-num_rays // batch_rays)):
        drawn = rays.draw_terminated(batch_rays, SeedStream(Purpose.GROWTH, level, batch))
        leaf, found = octree.find_leaf(drawn.point, drawn.terminated)
        dr.scatter_add(count, mi.Float(1), leaf, found)
        dr.eval(count)
    return np.array(count)
