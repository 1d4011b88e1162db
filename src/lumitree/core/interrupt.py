"""Signals that ask a job to stop: SIGINT (Ctrl-C), SIGTERM and SIGHUP (its terminal was closed).

On Windows they are SIGINT and SIGBREAK (Ctrl-Break).

The handler at once writes a line to standard error. In a block of `interruptible` it then raises
`Interrupted`; in a block of `deferred_interrupt` it only records the signal, so that the work can
reach a state that can be saved. A signal that the parent process ignores, such as SIGHUP under
nohup, stays ignored.

`Interrupted` may be raised anywhere, and libraries catch it: trimesh does so while it imports its
optional dependencies, and Mitsuba while it makes a plugin. Therefore it is raised after an import,
not within it, and it is raised again until the block ends.
"""

import contextlib
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType

from lumitree.core.system import (
    REPEATED,
    STOP_SIGNALS,
    TERMINAL_CLOSED,
    is_closed_terminal,
    repeat,
    stop_repeating,
)

# Interval at which `Interrupted` is raised again, s.
_AGAIN_SECONDS = 0.02
# File name of the frames that import a module.
_IMPORTS = "<frozen importlib._bootstrap>"

# Whether signals are handled without a line on standard error.
_silent = False

_Handler = Callable[[int, FrameType | None], None]


class Interrupted(KeyboardInterrupt):
    """A stop signal ended the work.

    Attributes:
        number: number of the signal.
    """

    def __init__(self, message: str = "", number: int = signal.SIGINT) -> None:
        super().__init__(message)
        self.number = int(number)


def interruption_behind(error: BaseException | None) -> Interrupted | None:
    """The signal that caused an error; None if it was not a signal.

    Dr.Jit wraps an exception that is raised while it traces a loop.
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error if error is None or isinstance(error, Interrupted) else Interrupted()


class Interruption:
    """Whether a stop signal was received, and which one.

    Attributes:
        number: number of the signal; None if none was received.
    """

    def __init__(self) -> None:
        self.number: int | None = None

    def __bool__(self) -> bool:
        return self.number is not None


class _Block:
    """A block of `interruptible`; `number` is the signal by which it is to end, or None."""

    def __init__(self, outer: "_Block | None") -> None:
        self.number: int | None = None
        self._outer, self._closed = outer, False
        # The whole block may be in an `except`, or in a module that is being imported.
        self._handled, self._imports = sys.exception(), _imports(sys._getframe())

    def receive(self, number: int, frame: FrameType | None) -> None:
        """Handle a stop signal: raise `Interrupted`, but in an import defer the first signal."""
        deferred = self._closed or (self.number is None and _imports(frame) > self._imports)
        self.number = number
        _announce("stopping ...", number)
        if not self._closed:
            repeat(_AGAIN_SECONDS)
        if not deferred:
            raise Interrupted(number=number)

    def receive_again(self, _: int, frame: FrameType | None) -> None:
        """Handle the timer: raise what was deferred, or caught by a library.

        While an exception is handled nothing is raised: it may be on its way, and clean up.
        """
        imports = _imports(frame) > self._imports
        if not (self._closed or imports or sys.exception() is not self._handled):
            self.end()

    def end(self) -> None:
        if self.number is not None:
            raise Interrupted(number=self.number)

    def close(self) -> None:
        self._closed = True
        if self._outer is None:
            stop_repeating()


_innermost: _Block | None = None


@contextmanager
def interruptible() -> Iterator[None]:
    """Context in which every stop signal raises `Interrupted`; in the main thread only.

    After a signal any exception that leaves the block becomes `Interrupted`, since a library may
    have caught that one and raised its own. If no exception leaves the block, its work is complete;
    the enclosing block, if there is one, then gets the signal.
    """
    global _innermost
    if not _in_main_thread():
        yield
        return
    outer = _innermost
    block = _innermost = _Block(outer)
    if outer is not None:
        block.number, outer.number = outer.number, None
    handlers: dict[int, _Handler] = dict.fromkeys(STOP_SIGNALS, block.receive)
    handlers[REPEATED] = block.receive_again
    try:
        with _handling(handlers):
            try:
                yield
            except Exception:
                block.end()
                raise
            finally:
                block.close()
        if outer is not None and block.number is not None:
            outer.number = block.number
            repeat(_AGAIN_SECONDS)
    finally:
        _innermost = outer


@contextmanager
def deferred_interrupt(
    text: str = "stopping ...; a second signal ends at once",
) -> Iterator[Interruption]:
    """Context that only records the first stop signal; a second one acts as outside of it.

    Args:
        text: the line that the first signal prints.
    """
    interruption = Interruption()
    if not _in_main_thread():
        yield interruption
        return
    if _innermost is not None:
        _innermost.receive_again(REPEATED, sys._getframe())
    with contextlib.ExitStack() as stack:

        def note(number: int, frame: FrameType | None) -> None:
            _announce(text, number)
            interruption.number = number
            stack.close()

        stack.enter_context(_handling(dict.fromkeys(STOP_SIGNALS, note)))
        yield interruption


def announce_nothing() -> None:
    """Handle signals without a line on standard error, in processes whose parent writes it."""
    global _silent
    _silent = True


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def _imports(frame: FrameType | None) -> int:
    """Number of frames that import a module, in the calls that led to a frame."""
    count = 0
    while frame is not None:
        count += frame.f_code.co_filename == _IMPORTS
        frame = frame.f_back
    return count


def _install(handlers: Mapping[int, _Handler]) -> dict[int, _Handler | int]:
    """Install handlers for the signals that are not ignored; returns those before."""
    before = {number: signal.getsignal(number) for number in handlers}
    # None: the handler was not installed from Python.
    handled = {
        number: previous
        for number, previous in before.items()
        if previous not in (signal.SIG_IGN, None)
    }
    for number in handled:
        signal.signal(number, handlers[number])
    return handled


@contextmanager
def _handling(handlers: Mapping[int, _Handler]) -> Iterator[None]:
    """Context in which the signals that are not ignored have handlers."""
    before = _install(handlers)
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def _announce(text: str, number: int) -> None:
    """Write a line to standard error without its buffer, which a signal may have interrupted."""
    if number == TERMINAL_CLOSED:
        _leave_terminal()
    if _silent:
        return
    # On a terminal the current line already shows ^C, and perhaps a progress bar.
    line = ("\n" if sys.stderr.isatty() else "") + f"lumitree: {text}\n"
    try:
        descriptor = sys.stderr.fileno()
    except io.UnsupportedOperation:  # in a notebook
        sys.stderr.write(line)
        return
    with contextlib.suppress(OSError):
        os.write(descriptor, line.encode())


def _leave_terminal() -> None:
    """Redirect output to the null device if its terminal is closed: later writes then succeed."""
    for descriptor in (1, 2):
        if is_closed_terminal(descriptor):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, descriptor)
            os.close(nowhere)
