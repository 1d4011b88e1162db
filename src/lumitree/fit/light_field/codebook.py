"""A few curves in place of many: reach over distance, by weighted k-means.

Symbols
    N   entries         K   points of a curve
    n   light of an entry that gets farther than each distance; its first point is d, all light
    c   a curve of the codebook, near n / d

The distance of an entry and a curve is Σ d (√(n / d) - √c)². The roots keep the order of magnitude
of small values: only little light gets far.

A curve is the ratio of the sums of n and of d over its entries. So at every point Σ d c over the
entries of a curve is Σ n: all light is kept.
"""

import numpy as np
from numpy.typing import NDArray

# Entries from which curves are found; all are then given the nearest.
_SAMPLES = 1 << 14
_ITERATIONS = 8
_CHUNK = 1 << 15
# Of numbers whose products are added exactly in double precision.
_LARGEST = 1 << 20


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
    # Of whole numbers of 20 bits, so that sums are exact: those of BLAS otherwise depend on the
    # number of its threads. The scale of an entry does not matter.
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
