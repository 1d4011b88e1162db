"""NumPy arrays on the device."""

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike

# Values that Dr.Jit may read beyond an array's end: a packet, of the widest vector unit there is.
_PACKET = 64


def on_device(kind: Any, values: ArrayLike) -> Any:
    """Device array of a copy of some values, flattened and converted.

    Dr.Jit 1.5 reads an array of NumPy where it lies and in whole packets, so also what follows it.
    Where a page ends there, the process dies.

    Args:
        kind: type of the result, such as `mi.Float`.
        values: numbers.
    """
    flat = np.ravel(values)
    padded = np.empty(len(flat) + _PACKET, np.dtype(dr.type_v(kind).name.lower()))
    padded[: len(flat)] = flat
    return kind(padded[: len(flat)])
