"""The light inside a luminaire's box from its bake, see `lumitree.asset.light_field`.

Reach over distance is stored by a few curves, found by weighted k-means (`codebook`).

Symbols
    C, Q, E, K, J, s    as in `lumitree.asset.light_field`
    N   entries of the codebook
    n   light of an entry that gets farther than each distance
    d   first point of n: all light of the entry
    c   a curve of the codebook, near n / d

The distance of an entry and a curve is Σ d (√(n / d) - √c)²: with roots, small values keep their
order of magnitude, such as the little light that gets far. A curve is the ratio of the sums of n
and of d over its entries. So at every point Σ d c over the entries of a curve is Σ n: all light is
kept.
"""

import enum

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import MAX_CURVES, LightField, LightInside, pack_lit, pack_part
from lumitree.core.octahedral import coarse_solid_angles
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.octree.build import morton
from lumitree.trace.histograms import EndingHistogram, cell_codes, coded_cells

# Entries from which curves are found; all are then given the nearest.
_SAMPLES = 1 << 14
_ITERATIONS = 8
_CHUNK = 1 << 15
# Largest of whole numbers whose products are added exactly in double precision.
_LARGEST = 1 << 20
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


class EndingDraw(enum.IntEnum):
    """Draws of `Purpose.ENDING`. A number is part of the seed."""

    SEGMENTS = 0  # which segment of each path is kept; step: batch
    CURVES = 1  # entries from which curves are found
    PLACES = 2  # where in its cell each reach begins; step: batch


def light_inside(field: LightField, ending: EndingHistogram, seed: int) -> LightInside:
    """The light inside the box, of a light field and of light that ends on the luminaire.

    Memory: 4 arrays of `DISTANCES` by entry; 0.4 GB for a million.

    Args:
        field: what leaves the box.
        ending: all segments that end on the luminaire.
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
    bent = pack_part((ending.bent / solid_angle)[at] / scale, words)
    whole, part = ending.by_reach[at], ending.bent_by_reach[at]
    reach, bent_reach, curves = _reach(whole, part, bent != words, seed)
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
    stream = SeedStream(Purpose.ENDING, draw=EndingDraw.CURVES)
    rows, curves = codebook(beyond, MAX_CURVES, stream.seed(seed))
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


def codebook(
    beyond: NDArray[np.float32], count: int, seed: int
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Curves of reach; equal arguments give equal curves.

    Args:
        beyond: [N, K] n of each entry, at least 0 and not increasing.
        count: number of curves, at most 256.
        seed: of the entries that are sampled, in proportion to d.

    Returns:
        rows: [N] curve of each entry; the most frequent curve is the first.
        curves: [.., K], at most `count` and at least one, from 1 and not increasing.
    """
    total = beyond[:, 0].astype(np.float64)
    lit = np.flatnonzero(total)
    rows = np.zeros(len(beyond), np.uint8)
    if not len(lit):
        return rows, np.eye(1, beyond.shape[1], dtype=np.float32)
    if len(lit) < len(beyond):
        rows[lit], curves = codebook(beyond[lit], count, seed)
        return rows, curves
    random = np.random.default_rng(seed)
    if len(beyond) > _SAMPLES:
        chosen = random.choice(len(total), _SAMPLES, p=total / total.sum())
        n = (beyond[chosen] / total[chosen, None]).astype(np.float32)
    else:
        n = (beyond / total.max()).astype(np.float32)
    curves = np.unique(_ratios(n), axis=0)
    features = _features(n)
    curves = curves[random.permutation(len(curves))[:count]]
    for _ in range(_ITERATIONS):
        nearest = _nearest(features, curves)
        used, nearest = np.unique(nearest, return_inverse=True)
        curves = _ratios(_sums(n, nearest, len(used)))
    chunks = (beyond[start : start + _CHUNK] for start in range(0, len(beyond), _CHUNK))
    nearest = np.concatenate([_nearest(_features(chunk), curves) for chunk in chunks])
    used, nearest, frequency = np.unique(nearest, return_inverse=True, return_counts=True)
    order = np.argsort(-frequency, kind="stable")
    nearest = np.argsort(order, kind="stable")[nearest]
    return nearest.astype(np.uint8), _ratios(_sums(beyond, nearest, len(used)))


def _features(n: NDArray[np.float32]) -> NDArray[np.float32]:
    """Numbers [N, K + 1] of entries that their distance from a curve is linear in, but for n."""
    return np.hstack([n[:, :1], np.sqrt(n * n[:, :1])])


def _nearest(features: NDArray[np.float32], curves: NDArray[np.float32]) -> NDArray[np.intp]:
    """Index [N] of the curve at the least distance from each entry, by its `_features`."""
    # Sums of whole numbers of 20 bits are exact; else the result of BLAS would depend on the number
    # of its threads. The scale of an entry does not matter.
    terms = np.hstack([curves.sum(axis=1, keepdims=True), -2 * np.sqrt(curves)])
    return (_whole(features, 1) @ _whole(terms, None).T).argmin(axis=1)


def _whole(values: NDArray[np.floating], axis: int | None) -> NDArray[np.float64]:
    """Whole numbers in proportion to values along an axis, or to all; the largest `_LARGEST`."""
    largest = np.abs(values).max(axis=axis, keepdims=True).astype(np.float64)
    return np.rint(values * (_LARGEST / largest))


def _sums(values: NDArray[np.float32], rows: NDArray[np.intp], count: int) -> NDArray[np.float64]:
    """Sums [count, K] of the values [N, K] of each row."""
    columns = [np.bincount(rows, column, count) for column in values.T]
    return np.stack(columns, axis=1, dtype=np.float64)


def _ratios(n: NDArray[np.floating]) -> NDArray[np.float32]:
    """Curves n / d."""
    # Sums are rounded.
    return np.minimum.accumulate((n / n[:, :1]).astype(np.float32), axis=1)
