"""Progress of long work: a bar with time left on a terminal, plain lines elsewhere."""

import contextlib
import sys
import time
from collections.abc import Iterator
from typing import Protocol

# Work that ends sooner than this shows nothing.
_QUIET_SECONDS = 2.0
_LOG_SECONDS = 15.0


class Advance(Protocol):
    def __call__(self, amount: float, note: str = "") -> None:
        """Report `amount` more units of work done, with an optional short note."""


@contextlib.contextmanager
def progress(description: str, total: float, done: float = 0) -> Iterator[Advance]:
    """Show the progress of the block; call what is yielded as work is done.

    Args:
        description: what is being done, e.g. "capture".
        total: units of work in all.
        done: units that an earlier run has already done.
    """
    start = time.monotonic()
    state = {"done": done, "logged": start}
    with contextlib.ExitStack() as stack:
        bar = _Bar(description, total, stack) if sys.stderr.isatty() else None

        def advance(amount: float, note: str = "") -> None:
            state["done"] += amount
            now = time.monotonic()
            if now - start < _QUIET_SECONDS:
                return
            if bar:
                bar.show(state["done"], note)
            elif now - state["logged"] >= _LOG_SECONDS or state["done"] >= total:
                state["logged"] = now
                rate = max(state["done"] - done, 1e-9) / (now - start)
                left = (total - state["done"]) / rate
                percent = 100 * state["done"] / total
                line = f"{description}: {percent:.0f} %, {left:.0f} s left"
                print(f"{line}, {note}" if note else line, file=sys.stderr, flush=True)

        yield advance


class _Bar:
    """A rich progress bar that appears when it is first shown."""

    def __init__(self, description: str, total: float, stack: contextlib.ExitStack) -> None:
        self._description, self._total, self._stack = description, total, stack
        self._live = None

    def show(self, done: float, note: str) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        if self._live is None:
            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.percentage:>3.0f} %"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[note]}"),
            )
            self._live = self._stack.enter_context(Progress(*columns, console=Console(stderr=True)))
            self._task = self._live.add_task(self._description, total=self._total, note=note)
        self._live.update(self._task, completed=done, note=note)
