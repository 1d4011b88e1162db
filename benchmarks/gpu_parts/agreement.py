"""Whether two devices estimate the same quantities: a z-test of each, with one significance."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

# Largest probability by chance at which a set of quantities counts as different.
SIGNIFICANCE = 1e-3


def agreement(first: NDArray[np.floating], second: NDArray[np.floating]) -> dict[str, Any]:
    """Compare the means of independent batches of two estimates of the same quantities.

    Each quantity and the sum of all have Welch's test, because the errors are estimated from few
    batches; then Šidák's correction for their number. The sum shows a difference that all have in
    common and that the noise of each hides.

    Args:
        first, second: [K, ...] and [L, ...] batches of equal weight, at least two of each.

    Returns:
        `quantities`, their number with the sum; `largest_z`, the largest difference in standard
        errors; `p`, the probability of one as improbable as the least probable, if both estimate
        the same; `agrees`, whether it is at least `SIGNIFICANCE`; `ratio` and `ratio_error`, the
        sum of `first` over that of `second` and its standard error; `not_finite`, the number of
        values that are NaN or infinite: with one, nothing agrees, and what is not known is None.
    """
    a, b = (_with_sum(each) for each in (first, second))
    not_finite = int((~np.isfinite(a)).sum() + (~np.isfinite(b)).sum())
    if not_finite:
        unknown = dict.fromkeys(("largest_z", "ratio", "ratio_error"))
        return {"quantities": a.shape[1], "p": 0.0, "agrees": False, **unknown} | {
            "not_finite": not_finite
        }
    squares = [each.var(axis=0, ddof=1) / len(each) for each in (a, b)]
    difference, error = a.mean(axis=0) - b.mean(axis=0), np.sqrt(squares[0] + squares[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(difference == 0, 0.0, difference / error)
        parts = squares[0] ** 2 / (len(a) - 1) + squares[1] ** 2 / (len(b) - 1)
        freedom = np.where(error > 0, error**4 / parts, 1.0)
    smallest = float(2 * stats.t.sf(np.abs(z), freedom).min())
    p = 1.0 if smallest >= 1 else float(-np.expm1(z.size * np.log1p(-smallest)))
    ratio, ratio_error = _ratio(a[:, -1], b[:, -1])
    return {
        "quantities": int(z.size),
        "largest_z": float(np.abs(z).max()),
        "p": p,
        "agrees": p >= SIGNIFICANCE,
        "ratio": ratio,
        "ratio_error": ratio_error,
        "not_finite": 0,
    }


def _with_sum(batches: NDArray[np.floating]) -> NDArray[np.float64]:
    """The quantities [K, N + 1] of the batches, and the sum of all."""
    flat = np.asarray(batches, np.float64).reshape(len(batches), -1)
    return np.column_stack([flat, flat.sum(axis=1)])


def _ratio(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[float, float]:
    """Ratio of the means of batches, and its standard error to first order."""
    ratio = a.mean() / b.mean()
    relative = [each.std(ddof=1) / np.sqrt(len(each)) / each.mean() for each in (a, b)]
    return float(ratio), float(abs(ratio) * np.hypot(*relative))
