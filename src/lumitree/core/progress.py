"""Progress of long work: reported to a callback, by default a bar with time left or plain lines."""

import contextlib
import contextvars
import dataclasses
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol

# Work that ends sooner than this shows nothing.
_QUIET_SECONDS = 2.0
_LOG_SECONDS = 15.0


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a task has come.

    Attributes:
        task: what is being done, such as "bake bulbs".
        done, total: units of work.
        seconds: since this process began the task.
        seconds_left: estimate; None as long as there is none.
        note: a short remark, such as the current quality; may be empty.
        finished: whether this is the last report of the task, however it ended.
    """

    task: str
    done: float
    total: float
    seconds: float
    seconds_left: float | None
    note: str
    finished: bool


ProgressCallback = Callable[[Progress], None]


class Advance(Protocol):
    def __call__(self, amount: float, note: str = "") -> None:
        """Report `amount` more units of work done, with an optional short note."""


class _Display:
    """A bar on a terminal or in a notebook, a line every 15 seconds elsewhere."""

    def __init__(self) -> None:
        self._bar: Any = None
        self._task: Any = None
        self._logged = 0.0

    def __repr__(self) -> str:
        return "show_progress"

    def __call__(self, progress: Progress) -> None:
        """Show a report; nothing in the first two seconds of a task."""
        if progress.finished:
            if self._bar is not None:
                self._bar.stop()
            self._bar, self._logged = None, 0.0
        elif progress.seconds >= _QUIET_SECONDS:
            if sys.stderr.isatty() or _in_notebook():
                self._show_bar(progress)
            elif progress.seconds - self._logged >= _LOG_SECONDS or progress.done >= progress.total:
                self._logged = progress.seconds
                self._log(progress)

    def _show_bar(self, progress: Progress) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        if self._bar is None:
            columns = (
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TextColumn("{task.percentage:>3.0f} %"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[note]}", markup=False),
            )
            self._bar = Bar(*columns, console=Console(stderr=True))
            self._bar.start()
            self._task = self._bar.add_task(progress.task, total=progress.total, note=progress.note)
        self._bar.update(self._task, completed=progress.done, note=progress.note)

    def _log(self, progress: Progress) -> None:
        percent = 100 * progress.done / progress.total
        parts = [f"{progress.task}: {percent:.0f} %"]
        if progress.seconds_left is not None:
            parts.append(f"{progress.seconds_left:.0f} s left")
        if progress.note:
            parts.append(progress.note)
        print(", ".join(parts), file=sys.stderr, flush=True)


show_progress: ProgressCallback = _Display()
_callback: contextvars.ContextVar[ProgressCallback | None] = contextvars.ContextVar(
    "progress", default=show_progress
)


@contextlib.contextmanager
def reporting(callback: ProgressCallback | None) -> Iterator[None]:
    """Within the block progress is reported to `callback`, or to nobody."""
    token = _callback.set(callback)
    try:
        yield
    finally:
        _callback.reset(token)


@contextlib.contextmanager
def progress(description: str, total: float, done: float = 0) -> Iterator[Advance]:
    """Report the progress of the block; call what is yielded as work is done.

    Args:
        description: what is being done, e.g. "capture".
        total: units of work in all.
        done: units that an earlier run has already done.
    """
    callback = _callback.get()
    start, first, latest = time.monotonic(), done, ""

    def report(finished: bool) -> None:
        if callback is None:
            return
        seconds = time.monotonic() - start
        left = (total - done) * seconds / (done - first) if done > first else None
        callback(Progress(description, done, total, seconds, left, latest, finished))

    def advance(amount: float, note: str = "") -> None:
        nonlocal done, latest
        done, latest = done + amount, note
        report(False)

    try:
        yield advance
    finally:
        report(True)


def _in_notebook() -> bool:
    shell = sys.modules.get("IPython")
    return shell is not None and "ZMQInteractiveShell" in type(shell.get_ipython()).__name__
