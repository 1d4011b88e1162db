"""How fine the grid of a light field is: cells follow the light, and not the box of the lamp.

A chain or a cable makes the box longer and the cells larger, and adds next to no light. So the side
of a cell is a part of the spread of the light. It is a power of two of the side of the box: cells
of a coarser grid are sums of 2 × 2 × 2 cells.
"""

import math

import numpy as np

from lumitree.asset.light_field import MAX_DEPTH
from lumitree.core.photometry import luminance
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.light_field.batches import LARGEST_GAIN
from lumitree.lamp.luminaire import Luminaire
from lumitree.trace.emitted_rays import as_rows
from lumitree.trace.ending_segments import EndingConfig, EndingSegments
from lumitree.trace.histograms import cell_codes
from lumitree.trace.lamp_rays import LampRays
from lumitree.trace.light_field_config import LEAST_DEPTH
from lumitree.trace.light_paths import LightPaths

_PATHS = 1 << 16
# Quantiles of the flux between which the light is.
_SPREAD = (0.05, 0.95)
# Parts of the flux, and the cells in which they may start: finer cells would get too few paths. In
# the coarsest grid 90 % of the flux of lamps is in up to 1,200 cells. The second limit bounds the
# memory.
_LIMITS = ((0.9, 800), (1.0, 6000))


def grid_depth(luminaire: Luminaire) -> int:
    """Depth of the grid for a luminaire: at least `LEAST_DEPTH`, and larger where light is dense.

    It does not depend on the seed of a bake: fields of all seeds have the same cells.

    Raises:
        LumitreeError: a path's flux is NaN or infinite.
    """
    seed, of_segments = (SeedStream(Purpose.CELLS, draw=draw).seed(0) for draw in (0, 1))
    paths = LampRays(luminaire).draw(
        _PATHS, seed, ending=EndingConfig(MAX_DEPTH, of_segments), largest_gain=LARGEST_GAIN
    )
    if not as_rows(paths.flux).any():
        return LEAST_DEPTH
    assert paths.ending is not None
    finer = round(math.log2(1 / max(_spread(paths), 2.0**-MAX_DEPTH)))
    for depth in range(min(LEAST_DEPTH + finer, MAX_DEPTH), LEAST_DEPTH, -1):
        cells = _flux_by_cell(paths, depth), _flux_by_cell(paths.ending, depth)
        if all(_num_cells(flux, part) <= most for flux in cells for part, most in _LIMITS):
            return depth
    return LEAST_DEPTH


def _spread(rays: LightPaths) -> float:
    """Side of the light over the side of the lamp's box, 0 to 1.

    It is the side of a square with the area of the largest face of the light's box: light along a
    line is not spread, since receivers beside it are near.
    """
    low, high = np.quantile(
        as_rows(rays.origin),
        _SPREAD,
        axis=0,
        weights=luminance(as_rows(rays.flux)),
        method="inverted_cdf",
    )
    sides = np.sort(high - low) / 2
    return math.sqrt(sides[1] * sides[2])


def _flux_by_cell(rays: LightPaths | EndingSegments, depth: int) -> np.ndarray:
    """Luminous flux of the cells in which rays start, the largest first."""
    cells = np.floor((as_rows(rays.origin) + 1) * 2.0 ** (depth - 1)).astype(np.int64)
    codes = cell_codes(np.clip(cells, 0, (1 << depth) - 1), depth)
    _, cell = np.unique(codes, return_inverse=True)
    return np.sort(np.bincount(cell, luminance(as_rows(rays.flux))))[::-1]


def _num_cells(flux: np.ndarray, part: float) -> int:
    """Number of the first cells that have a part of the flux."""
    total = flux.cumsum()
    return int(np.searchsorted(total, part * total[-1])) + 1
