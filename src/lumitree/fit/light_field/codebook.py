"""A few curves in place of many: curves that are ratios, by weighted k-means.

Symbols
    N   entries         K   points of a curve
    n   numerators      d   denominators        c   a curve of the codebook, near n / d

The distance of an entry and a curve is Σ d (√(n / d) - √c)²: of roots, so that small values keep
their order of magnitude, as those of the little light that gets far.

A curve is the ratio of the sums of n and of d over its entries. So at every point Σ d c over the
entries of a curve is Σ n: if d are weights of light without a factor and n those with it, all light
is kept.
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
    numerators: NDArray[np.float32],
    denominators: NDArray[np.float32],
    count: int,
    largest: float,
    seed: int,
    *,
    independent: NDArray[np.float32] | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Curves for ratios n / d; equal arguments give equal curves.

    Args:
        numerators, denominators: [N, K], at least 0.
        count: number of curves, at most 256.
        largest: ratios above it are cut, so that light is lost.
        seed: of the entries that are sampled, in proportion to their largest numerator.
        independent: [N, K] another estimate of the denominators, from which curves are computed
            once each entry has its curve. Entries whose noise is alike get the same curve, so that
            the same estimate would make it too large or too small.

    Returns:
        rows: [N] curve of each entry; the most frequent curve is the first.
        curves: [.., K], at most `count`. Where all denominators of a curve are 0 it keeps the value
            of the point before, or is 1.
    """
    if not len(numerators):
        return np.zeros(0, np.uint8), np.ones((1, numerators.shape[1]), np.float32)
    random = np.random.default_rng(seed)
    weight = numerators.max(axis=1).astype(np.float64)
    if len(numerators) > _SAMPLES and weight.any():
        chosen = random.choice(len(weight), _SAMPLES, p=weight / weight.sum())
        scale = 1 / weight[chosen, None]
    else:
        chosen, scale = np.arange(len(weight)), 1 / max(weight.max(), 1e-30)
    n = (numerators[chosen] * scale).astype(np.float32)
    d = (denominators[chosen] * scale).astype(np.float32)
    curves = _ratios(n, d, largest)
    curves = np.unique(curves, axis=0)
    both = _features(n, d)
    curves = curves[random.permutation(len(curves))[:count]]
    for _ in range(_ITERATIONS):
        rows = _nearest(both, curves)
        curves = _ratios(_sums(n, rows, len(curves)), _sums(d, rows, len(curves)), largest)
    chunks = [slice(start, start + _CHUNK) for start in range(0, len(numerators), _CHUNK)]
    rows = np.concatenate(
        [_nearest(_features(numerators[at], denominators[at]), curves) for at in chunks]
    )
    used, rows, frequency = np.unique(rows, return_inverse=True, return_counts=True)
    order = np.argsort(-frequency, kind="stable")
    rows = np.argsort(order, kind="stable")[rows]
    final = denominators if independent is None else independent
    n, d = (_sums(each, rows, len(used)) for each in (numerators, final))
    return rows.astype(np.uint8), _ratios(n, d, largest)


def _features(n: NDArray[np.float32], d: NDArray[np.float32]) -> NDArray[np.float32]:
    """Numbers [N, 2 K] of entries that their distance from a curve is linear in, but for n."""
    return np.hstack([d, np.sqrt(n * d)])


def _nearest(features: NDArray[np.float32], curves: NDArray[np.float32]) -> NDArray[np.intp]:
    """Index [N] of the curve at the least distance from each entry, by its `_features`."""
    # Of whole numbers of 20 bits, so that sums are exact: those of BLAS otherwise depend on the
    # number of its threads. The scale of an entry does not matter.
    terms = np.hstack([curves, -2 * np.sqrt(curves)])
    return (_whole(features, 1) @ _whole(terms, None).T).argmin(axis=1)


def _whole(values: NDArray[np.floating], axis: int | None) -> NDArray[np.float64]:
    """Whole numbers in proportion to values along an axis, or to all; the largest `_LARGEST`."""
    largest = np.abs(values).max(axis=axis, keepdims=True).astype(np.float64)
    return np.rint(values * (_LARGEST / np.maximum(largest, 1e-300)))


def _sums(values: NDArray[np.float32], rows: NDArray[np.intp], count: int) -> NDArray[np.float64]:
    """Sums [count, K] of the values [N, K] of each row."""
    columns = [np.bincount(rows, column, count) for column in values.T]
    return np.stack(columns, axis=1, dtype=np.float64)


def _ratios(
    n: NDArray[np.floating], d: NDArray[np.floating], largest: float
) -> NDArray[np.float32]:
    """Curves n / d, from 0 to `largest`."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratios = np.minimum(n / d, largest).astype(np.float32)
    ratios[:, 0] = np.where(np.isnan(ratios[:, 0]), 1, ratios[:, 0])
    for point in range(1, ratios.shape[1]):
        missing = np.isnan(ratios[:, point])
        ratios[missing, point] = ratios[missing, point - 1]
    return ratios
