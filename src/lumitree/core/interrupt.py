"""Signals that ask a job to stop: SIGINT (Ctrl-C), SIGTERM and SIGHUP (the terminal has gone).

Every one is answered at once by a line on standard error. Work that may end anywhere is ended by
`Interrupted`; work that must not be cut in half defers it. A signal that the parent process chose
to ignore, such as SIGHUP under nohup, stays ignored.
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
        number: of the signal.
    """

    def __init__(self, message: str = "", number: int = signal.SIGINT) -> None:
        super().__init__(message)
        self.number = int(number)


class Interruption:
    """Whether a stop signal has come, and which.

    Attributes:
        number: of the signal; None as long as there is none.
    """

    def __init__(self) -> None:
        self.number: int | None = None

    def __bool__(self) -> bool:
        return self.number is not None


@contextmanager
def interruptible() -> Iterator[None]:
    """Within the block every stop signal raises `Interrupted`."""

    def stop(number: int, frame: FrameType | None) -> None:
        _announce("stopping ...", number)
        raise Interrupted(number=number)

    with _handling(stop):
        yield


@contextmanager
def deferred_interrupt() -> Iterator[Interruption]:
    """Within the block a stop signal is only noted; a second one acts as it would outside."""
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
    """Handle the stop signals that are not ignored; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    handled = {
        number: previous
        for number, previous in before.items()
        # None: set by code that is not Python's.
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
    """Write a line to standard error, which may be in the middle of writing something else."""
    if number == signal.SIGHUP:
        _leave_terminal()
    # A terminal shows ^C and perhaps a progress bar in that line already.
    line = ("\n" if sys.stderr.isatty() else "") + f"lumitree: {text}\n"
    try:
        descriptor = sys.stderr.fileno()
    except io.UnsupportedOperation:  # in a notebook
        sys.stderr.write(line)
        return
    with contextlib.suppress(OSError):
        os.write(descriptor, line.encode())


def _leave_terminal() -> None:
    """Send output to nowhere where its terminal has gone, so that no later line fails."""
    for descriptor in (1, 2):
        try:
            termios.tcgetattr(descriptor)
        except termios.error as error:
            if error.args[0] == errno.EIO:
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, descriptor)
                os.close(nowhere)
