"""Results, which are frozen dataclasses for Python, JSON and notebooks; and their costs."""

import contextlib
import dataclasses
import math
import os
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from lumitree.errors import shown

Json = dict[str, Any]


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class Result:
    """Base class of all results.

    Attributes:
        seconds: wall time by stage, s.
        peak_memory_bytes: largest resident memory of the process so far, bytes.
    """

    seconds: dict[str, float]
    peak_memory_bytes: int

    def to_json(self) -> Json:
        """Dictionary of the result, for `json.dumps`."""
        return {field.name: plain(getattr(self, field.name)) for field in self._shown()}

    def __repr__(self) -> str:
        lines = [f"{name}: {shown(value, 200)}" for name, value in self.to_json().items()]
        return "\n  ".join([type(self).__name__, *lines])

    def _shown(self) -> list[dataclasses.Field[Any]]:
        return [field for field in dataclasses.fields(self) if field.repr]


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class ImageResult(Result):
    """Base class of results with an image, which notebooks display.

    Attributes:
        png: contents of a PNG file with the image.
    """

    png: bytes = dataclasses.field(repr=False)

    def _repr_png_(self) -> bytes:
        return self.png


def plain(value: object) -> Any:
    """Convert a value for `json.dumps`: paths to text, arrays and tuples to lists, and so on.

    Numbers that JSON does not have, NaN and infinities, become None.
    """
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return plain({field.name: getattr(value, field.name) for field in fields})
    return value


try:
    import resource
except ImportError:  # Windows
    resource = None


class Stopwatch:
    """Wall time of named stages.

    Attributes:
        seconds: wall time by stage, s, in the order of the first run of each.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Context that measures its block; the times of blocks of one name are added."""
        start = time.perf_counter()
        try:
            yield
        finally:
            elapsed = time.perf_counter() - start
            self.seconds[name] = round(self.seconds.get(name, 0.0) + elapsed, 3)

    def costs(self) -> Json:
        """Values of the fields of `Result`."""
        return {"seconds": self.seconds, "peak_memory_bytes": peak_memory_bytes()}


def peak_memory_bytes() -> int:
    """Largest resident memory of this process so far, in bytes; 0 on Windows."""
    if resource is None:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def digits_text(value: float) -> str:
    """A number with four significant digits, and all digits before the point."""
    digits = 0 if value == 0 or not math.isfinite(value) else 3 - math.floor(math.log10(abs(value)))
    return f"{round(value, max(digits, 0)):,.12g}"
