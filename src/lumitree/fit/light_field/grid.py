"""How fine the grid of a light field is: cells follow the light, and not the box of the lamp.

A chain or a cable makes the box longer and the cells larger, and adds next to no light. So the grid
is the finest in which the light starts in few cells. Its sides are powers of two: cells of a
coarser grid are sums of 2 × 2 × 2 cells.
"""

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
# Parts of the flux, and in how many cells they may start. Of lamps that fill their box, 240 to 1,200
# cells have 90 % of the flux if there are 32 a side. The limit of all cells bounds the memory.
_LIMITS = ((0.9, 800), (1.0, 6000))


def grid_depth(luminaire: Luminaire) -> int:
    """The largest depth at which light that leaves a luminaire, or ends on it, is in few cells.

    It does not depend on the seed of a bake, so that fields of different seeds can be merged.

    Returns:
        `LEAST_DEPTH` to `MAX_DEPTH`.

    Raises:
        LumitreeError: a path's flux is NaN or infinite.
    """
    seed = SeedStream(Purpose.CELLS).seed(0)
    paths = LampRays(luminaire).draw(
        _PATHS, seed, ending=EndingConfig(MAX_DEPTH, seed), largest_gain=LARGEST_GAIN
    )
    assert paths.ending is not None
    for depth in range(MAX_DEPTH, LEAST_DEPTH, -1):
        cells = _flux_by_cell(paths, depth), _flux_by_cell(paths.ending, depth)
        if all(_num_cells(flux, part) <= most for flux in cells for part, most in _LIMITS):
            return depth
    return LEAST_DEPTH


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
