"""Statistical tests of two estimators: batches of numbers that have the same means."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats


def assert_equal_means(first: ArrayLike, second: ArrayLike, p: float = 1e-3) -> None:
    """Welch's tests of batches [N, ..], one for each number, corrected for how many there are.

    Numbers that are the same in all batches, as of pixels that get no light, are not tested.

    Args:
        p: probability with which equal means fail.
    """
    result: Any = stats.ttest_ind(first, second, equal_var=False)
    found = np.atleast_1d(result.pvalue)
    found = found[np.isfinite(found)]
    assert found.size
    assert found.min() > p / found.size, f"p = {found.min():.2g} of {found.size:,} numbers"
