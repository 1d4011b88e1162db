"""Values of bins of which only some are stored, and which these are as bits.

Symbols
    C   cells       N   bins of each        B   bins of all cells that are stored
"""

from typing import TypeVar

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
