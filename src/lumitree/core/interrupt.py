"""Signals that ask a job to stop: SIGINT (Ctrl-C), SIGTERM and SIGHUP (its terminal was closed).

The handler at once writes a line to standard error. In a block of `interruptible` it then raises
`Interrupted`; in a block of `deferred_interrupt` it only records the signal, so that the work can
reach a state that can be saved. A signal that the parent process ignores, such as SIGHUP under
nohup, stays ignored.
"""

import contextlib
import errno
import io
import os
import signal
import sys
import termios
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


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


@contextmanager
def interruptible() -> Iterator[None]:
    """Context in which every stop signal raises `Interrupted`."""

    def stop(number: int, frame: FrameType | None) -> None:
        _announce("stopping ...", number)
        raise Interrupted(number=number)

    with _handling(stop):
        yield


@contextmanager
def deferred_interrupt() -> Iterator[Interruption]:
    """Context that only records the first stop signal; a second one acts as outside of it."""
    interruption = Interruption()
    with contextlib.ExitStack() as stack:

        def note(number: int, frame: FrameType | None) -> None:
            _announce("stopping ...; a second signal ends at once", number)
            interruption.number = number
            stack.close()

        stack.enter_context(_handling(note))
        yield interruption


@contextmanager
def _handling(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Install a handler for the stop signals that are not ignored; in the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    handled = {
        number: previous
        for number, previous in before.items()
        # None: the handler was not installed from Python.
        if previous not in (signal.SIG_IGN, None)
    }
    try:
        for number in handled:
            signal.signal(number, handler)
        yield
    finally:
        for number, previous in handled.items():
            signal.signal(number, previous)


def _announce(text: str, number: int) -> None:
    """Write a line to standard error without its buffer, which a signal may have interrupted."""
    if number == signal.SIGHUP:
        _leave_terminal()
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
        try:
            termios.tcgetattr(descriptor)
        except termios.error as error:
            if error.args[0] == errno.EIO:
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, descriptor)
                os.close(nowhere)
