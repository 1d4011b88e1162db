"""Progress of long tasks, reported to a callback.

The default callback shows a bar with the time left, or prints lines where there is no terminal.
"""

import collections
import contextlib
import contextvars
import dataclasses
import math
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from lumitree.core.interruption import raise_interruption

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
        within: the latest report of the task that this one is a part of, such as a list of bakes;
            None if there is none.
    """

    task: str
    done: float
    total: float
    seconds: float
    seconds_left: float | None
    note: str
    finished: bool
    within: "Progress | None" = None


ProgressCallback = Callable[[Progress], None]


class Advance(Protocol):
    def __call__(self, amount: float, note: str = "") -> None:
        """Report that `amount` more units of work are done, with an optional short note.

        Raises:
            Interrupted: a stop signal is pending; see `core.interruption`.
        """


class _Display:
    """The default callback: a bar on a terminal or in a notebook, else a line every 15 seconds.

    A task within another one has a bar below the bar of the other.
    """

    def __init__(self) -> None:
        self._bar: Any = None
        # Bars by level, from the outermost task's.
        self._rows: list[Any] = []
        # Time of the task's latest line; infinite after the line of 100 %.
        self._logged = 0.0

    def __repr__(self) -> str:
        return "show_progress"

    def __call__(self, progress: Progress) -> None:
        """Show a report; reports in the first two seconds of a task are not shown."""
        if progress.finished:
            if self._bar is not None and progress.within is None:
                self._bar.stop()
                self._bar, self._rows = None, []
            outer = len(_with_outer(progress)) - 1
            if self._bar is not None:
                for row in self._rows[outer:]:
                    self._bar.remove_task(row)
            del self._rows[outer:]
            self._logged = 0.0
        elif progress.seconds >= _QUIET_SECONDS:
            if sys.stderr.isatty() or _in_notebook():
                self._show_bar(progress)
                return
            is_done = progress.done >= progress.total
            if progress.seconds - self._logged >= (0.0 if is_done else _LOG_SECONDS):
                self._logged = math.inf if is_done else progress.seconds
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
        for level, each in enumerate(_with_outer(progress)):
            if level == len(self._rows):
                self._rows.append(self._bar.add_task(each.task, total=each.total, note=each.note))
            self._bar.update(
                self._rows[level], description=each.task, completed=each.done, note=each.note
            )

    def _log(self, progress: Progress) -> None:
        percent = 100 * progress.done / progress.total
        outer = [f"{each.task}, {each.done:.0f} done" for each in _with_outer(progress)[:-1]]
        parts = ["; ".join([*outer, f"{progress.task}: {percent:.0f} %"])]
        if progress.seconds_left is not None:
            parts.append(f"{progress.seconds_left:.0f} s left")
        if progress.note:
            parts.append(progress.note)
        print(", ".join(parts), file=sys.stderr, flush=True)


show_progress: ProgressCallback = _Display()
_callback: contextvars.ContextVar[ProgressCallback | None] = contextvars.ContextVar(
    "progress", default=show_progress
)
# The latest report of the task in whose block the code runs.
_current: contextvars.ContextVar[Progress | None] = contextvars.ContextVar("current", default=None)


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

    A task that begins in this block is reported as one within this task.

    Args:
        description: name of the task, e.g. "capture".
        total: units of work in all.
        done: units that an earlier run has already done.
    """
    callback, within = _callback.get(), _current.get()
    start, latest = time.monotonic(), ""
    # Time and work done of earlier reports, of which the first is half as old as the task.
    earlier = collections.deque([(0.0, done)])

    def report(finished: bool) -> None:
        seconds = time.monotonic() - start
        # Only the second half counts: the first units of work may compile kernels, or be kept.
        while len(earlier) > 1 and earlier[1][0] <= seconds / 2:
            earlier.popleft()
        then, first = earlier[0]
        left = (total - done) * (seconds - then) / (done - first) if done > first else None
        earlier.append((seconds, done))
        state = Progress(description, done, total, seconds, left, latest, finished, within)
        _current.set(state)
        if callback is not None:
            callback(state)

    def advance(amount: float, note: str = "") -> None:
        nonlocal done, latest
        done, latest = done + amount, note
        report(False)
        raise_interruption()

    _current.set(Progress(description, done, total, 0.0, None, "", False, within))
    try:
        yield advance
    finally:
        report(True)
        _current.set(within)


def _with_outer(progress: Progress) -> list[Progress]:
    """The tasks that a task is within, outermost first, and itself."""
    outer = [] if progress.within is None else _with_outer(progress.within)
    return [*outer, progress]


def _in_notebook() -> bool:
    shell = sys.modules.get("IPython")
    return shell is not None and "ZMQInteractiveShell" in type(shell.get_ipython()).__name__
