"""Measurement of time by stage, and of memory."""

import contextlib
import sys
import time
from collections.abc import Iterator
from typing import Any

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

    def costs(self) -> dict[str, Any]:
        """Values of the fields of `Result`."""
        return {"seconds": self.seconds, "peak_memory_bytes": peak_memory_bytes()}


def peak_memory_bytes() -> int:
    """Largest resident memory of this process so far, in bytes; 0 on Windows."""
    if resource is None:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
