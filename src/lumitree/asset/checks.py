"""Checks that all parts of an asset share."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.errors import LumitreeError


def expect(what: str, condition: Any, message: str) -> None:
    """Refuse `what` with a message if the condition is false."""
    if not condition:
        raise LumitreeError(f"invalid {what}: {message}")


def expect_arrays(
    what: str, arrays: dict[str, tuple[NDArray[Any], type[np.generic], tuple[int, ...]]]
) -> None:
    """Refuse `what` if one of its arrays has not the type and shape that are listed with it."""
    for name, (array, dtype, shape) in arrays.items():
        expect(
            what,
            array.dtype == dtype and array.shape == shape,
            f"{name} is {array.dtype} {array.shape}, expected {np.dtype(dtype)} {shape}",
        )
