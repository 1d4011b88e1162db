"""NumPy arrays on the device."""

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike

# Dr.Jit may read this many values beyond an array's end: a packet of the widest vector unit.
_PACKET = 64


def parameter(kind: Any, *values: float) -> Any:
    """Small device array of the numbers given, which kernels read from memory.

    A number that is a part of a kernel's code gives each lamp a kernel of its own. Lamps whose
    numbers are parameters share one.

    Args:
        kind: type of the result, such as `mi.Float` or `mi.Point3f`.
        values: its components.
    """
    result = kind(*values)
    dr.make_opaque(result)
    return result


def on_device(kind: Any, values: ArrayLike) -> Any:
    """Device array of a copy of some values, flattened and converted.

    Dr.Jit 1.5 reads NumPy arrays without copying them, and in whole packets, so it also reads
    memory beyond their end. If that memory is not mapped, the process is killed. The copy is
    followed by padding.

    Args:
        kind: type of the result, such as `mi.Float`.
        values: numbers.
    """
    flat = np.ravel(values)
    padded = np.empty(len(flat) + _PACKET, np.dtype(dr.type_v(kind).name.lower()))
    padded[: len(flat)] = flat
    return kind(padded[: len(flat)])
