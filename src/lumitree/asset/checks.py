"""Checks that all parts of an asset share."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.errors import LumitreeError


def require(condition: Any, message: str) -> None:
    """Raise a `LumitreeError` with a message if the condition is false."""
    if not condition:
        raise LumitreeError(message)


def expect(what: str, condition: Any, message: str) -> None:
    """Refuse `what` with a message if the condition is false."""
    require(condition, f"invalid {what}: {message}")


@contextlib.contextmanager
def naming(name: Callable[[], str]) -> Iterator[None]:
    """Context in which messages of a `LumitreeError` begin with a name, which is made on demand."""
    try:
        yield
    except LumitreeError as error:
        raise LumitreeError(f"{name()}: {error}") from None


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
