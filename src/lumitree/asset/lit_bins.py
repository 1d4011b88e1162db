"""Values of the occupied bins, and a bit mask of which bins are occupied.

Symbols
    C   cells       N   bins of each        B   bins of all cells that are stored
"""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", bound=np.generic)


def dense(lit: NDArray[np.uint8], bins: int, values: NDArray[Number]) -> NDArray[Number]:
    """Values [B, ..] by cell and bin [C, N, ..]; 0 where none is stored.

    Args:
        lit: [C, ⌈N / 8⌉] which bins of each cell are stored; the first bin in the highest bit.
        bins: N.
        values: by cell and then by bin.
    """
    every = np.zeros((len(lit), bins, *values.shape[1:]), values.dtype)
    every[np.unpackbits(lit, axis=1, count=bins).view(bool)] = values
    return every


def by_coarse_bin(values: NDArray[Any]) -> NDArray[Any]:
    """Values [C, R²] of bins on the octahedral map as [C, Q², 4]: four of them are one of Q²."""
    coarse = round(values.shape[1] ** 0.5) // 2
    blocks = values.reshape(len(values), coarse, 2, coarse, 2)
    return blocks.transpose(0, 1, 3, 2, 4).reshape(len(values), coarse**2, 4)


def by_fine_bin(values: NDArray[Any]) -> NDArray[Any]:
    """The inverse of `by_coarse_bin`."""
    coarse = round(values.shape[1] ** 0.5)
    blocks = values.reshape(len(values), coarse, coarse, 2, 2)
    return blocks.transpose(0, 1, 3, 2, 4).reshape(len(values), 4 * coarse**2)
