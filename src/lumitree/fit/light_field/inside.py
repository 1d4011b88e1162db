"""The light inside a luminaire's box from its bake, see `lumitree.asset.light_field`.

Symbols
    C, Q, E, K, J, s    as there
"""

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import MAX_CURVES, LightField, LightInside, pack_lit, pack_part
from lumitree.core.octahedral import coarse_solid_angles
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.light_field.codebook import codebook
from lumitree.octree.build import morton
from lumitree.trace.histograms import EndingHistogram, cell_codes, coded_cells

# Distances of curves, local units: denser near, where most light ends. No way in the box is longer
# than the last, twice the diagonal of half the cube.
DISTANCES = np.hstack(
    [
        np.arange(0, 0.6, 0.05),
        np.arange(0.6, 1.2, 0.1),
        np.arange(1.2, 2, 0.2),
        (2, 2.4, 2.9, 3.5),
    ]
).astype(np.float32)


def light_inside(
    field: LightField, ending: EndingHistogram, straight: EndingHistogram, seed: int
) -> LightInside:
    """The light inside the box, of a light field and of light that ends on the luminaire.

    Memory: 4 arrays of `DISTANCES` by entry; 0.4 GB for a million.

    Args:
        field: what leaves the box.
        ending: all segments that end on the luminaire.
        straight: those that are straight light.
        seed: root seed.
    """
    solid_angle = coarse_solid_angles(field.resolution)[:, None]
    intensity = ending.flux / solid_angle
    scale = float(intensity.max(initial=0))
    scale = scale if scale > 0 else 1.0
    packed = pack_lit(intensity, scale)
    light_field_code, ending_code = (
        cell_codes(each, field.depth) for each in (field.cells, ending.cells)
    )
    codes = np.union1d(light_field_code, ending_code[packed.any(axis=1)])
    cells = coded_cells(codes, field.depth)
    order = np.argsort(morton(cells))
    codes, cells = codes[order], cells[order]

    # Row of each cell in `ending`, or -1.
    source = _rows_of(ending_code, codes)
    lit = np.zeros((len(codes), packed.shape[1]), bool)
    lit[source >= 0] = packed[source[source >= 0]] > 0
    rows, bins = np.nonzero(lit)
    at = source[rows], bins
    words = packed[at]
    bent = pack_part((ending.flux_without(straight) / solid_angle)[at] / scale, words)
    reach, bent_reach, curves = _reach(
        ending.by_reach[at], ending.by_reach_without(straight)[at], bent != words, seed
    )
    return LightInside(
        cells=cells.astype(np.uint8),
        lit=np.packbits(lit, axis=1),
        intensity=words,
        bent=bent,
        reach=reach,
        bent_reach=np.where(bent > 0, bent_reach, 0).astype(np.uint8),
        distances=DISTANCES,
        reach_curves=curves,
        scale=scale,
    )


def _reach(
    whole: NDArray[np.float32], bent: NDArray[np.float32], divided: NDArray[np.bool_], seed: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]]:
    """Curve [E] of each entry and of its bent part, and the curves of s, one codebook for both.

    Args:
        whole, bent: [E, K - 1] luminous flux that ends between two distances.
        divided: [E] whether the bent part is another than the whole.
        seed: root seed.
    """
    ends = np.concatenate([whole, bent[divided]])
    beyond = np.zeros((len(ends), len(DISTANCES)), np.float32)
    beyond[:, :-1] = ends[:, ::-1].cumsum(axis=1)[:, ::-1]
    rows, curves = codebook(beyond, MAX_CURVES, SeedStream(Purpose.ENDING, 0, 1).seed(seed))
    bent_rows = rows[: len(whole)].copy()
    bent_rows[divided] = rows[len(whole) :]
    return rows[: len(whole)], bent_rows, curves


def _rows_of(codes: NDArray[np.integer], wanted: NDArray[np.integer]) -> NDArray[np.int64]:
    """Row of each of some cells in `codes`, or -1."""
    if not len(codes):
        return np.full(len(wanted), -1)
    order = np.argsort(codes)
    at = np.minimum(np.searchsorted(codes, wanted, sorter=order), len(codes) - 1)
    return np.where(codes[order[at]] == wanted, order[at], -1)
