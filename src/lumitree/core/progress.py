"""Progress of long tasks, reported to a callback.

The default callback shows a bar with the time left, or prints lines where there is no terminal.
"""

import contextlib
import contextvars
import dataclasses
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol

# Tasks shorter than this show nothing.
_QUIET_SECONDS = 2.0
_LOG_SECONDS = 15.0


@dataclasses.dataclass(frozen=True)
class Progress:
    """Progress of a task.

    Attributes:
        task: name of the task, such as "bake bulbs".
        done, total: units of work done, and units in all.
        seconds: time since this process began the task.
        seconds_left: estimate of the time left; None if there is none yet.
        note: a short remark, such as the current quality; may be empty.
        finished: whether this is the last report of the task, also after an error.
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
        """Report that `amount` more units of work are done, with an optional short note."""


class _Display:
    """The default callback: a bar on a terminal or in a notebook, else a line every 15 seconds."""

    def __init__(self) -> None:
        self._bar: Any = None
        self._task: Any = None
        self._logged = 0.0

    def __repr__(self) -> str:
        return "show_progress"

    def __call__(self, progress: Progress) -> None:
        """Show a report; reports in the first two seconds of a task are not shown."""
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
    """Context in which progress is reported to `callback`; None reports nothing."""
    token = _callback.set(callback)
    try:
        yield
    finally:
        _callback.reset(token)


@contextlib.contextmanager
def progress(description: str, total: float, done: float = 0) -> Iterator[Advance]:
    """Context that reports a task's progress; the block calls the yielded function as it works.

    Args:
        description: name of the task, e.g. "capture".
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
