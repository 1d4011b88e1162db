"""Values as bytes for tasks in other processes: descriptions of scenes and luminaires."""

import io
import pickle
import sys
from typing import Any

import numpy as np

from lumitree.core.backend import load_mitsuba
from lumitree.errors import LumitreeError, shown


def packed(value: Any, name: str, expected: str) -> bytes:
    """A value as bytes for the arguments of a task; `unpacked` is the inverse.

    They can be compared, so that a worker keeps what it makes of the value for its next task.

    Args:
        name: what the value is, for the message.
        expected: what can be given in its place, for the message.

    Raises:
        LumitreeError: it cannot be pickled.
    """
    memory = io.BytesIO()
    try:
        _Pickler(memory).dump(value)
    except Exception as error:
        reason = " ".join(str(error).split())
        raise LumitreeError(
            f"{name} cannot be sent to other processes ({shown(reason, 200)}); give {expected}"
        ) from error
    return pickle.dumps((variant_here(), memory.getvalue()))


def variant_here() -> str | None:
    """The variant of Mitsuba that this process has set; None if it has set none."""
    return sys.modules["mitsuba"].variant() if "mitsuba" in sys.modules else None


def unpacked(data: bytes) -> Any:
    """The value of `packed`; sets the variant of Mitsuba that was set there."""
    variant, value = pickle.loads(data)
    if variant is not None:
        load_mitsuba(variant)
    return pickle.loads(value)


class _Pickler(pickle.Pickler):
    """Pickles Mitsuba's transforms too, which dictionaries of scenes have."""

    def reducer_override(self, obj: Any) -> Any:
        kind = type(obj)
        if kind.__module__.partition(".")[0] == "mitsuba" and "Transform" in kind.__name__:
            return _transform, (kind.__name__, np.array(obj.matrix))
        return NotImplemented


def _transform(kind: str, matrix: np.ndarray) -> Any:
    return getattr(sys.modules["mitsuba"], kind)(matrix)
