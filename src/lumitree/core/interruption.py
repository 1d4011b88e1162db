"""Signals that ask a job to stop: SIGINT (Ctrl-C), SIGTERM and SIGHUP (its terminal was closed).

On Windows they are SIGINT and SIGBREAK (Ctrl-Break).

The handler at once writes a line to standard error. In a block of `interruptible` it then raises
`Interrupted`; in a block of `deferred_interrupt` it only records the signal, so that the work can
reach a state that can be saved. A signal that the parent process ignores, such as SIGHUP under
nohup, stays ignored.

`Interrupted` may be raised anywhere, and libraries catch it: trimesh does so while it imports its
optional dependencies, and Mitsuba while it makes a plugin. Therefore the signal stays pending until
the block ends, and each report of progress raises `Interrupted` again. In an import it is left to
the next report, because a module that is half imported is broken.

The program `lumitree` ends at once by a signal before its command begins (`exit_on_signals`), and
ignores signals once its exit status is known.
"""

import contextlib
import errno
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import Any

try:
    import termios
except ImportError:  # Windows
    termios = None

_SIGHUP: int | None = getattr(signal, "SIGHUP", None)
# On Windows nothing outside of the process sends SIGTERM.
_TERMINATE: int = getattr(signal, "SIGBREAK", signal.SIGTERM)
# The signals that ask a job to stop.
STOP_SIGNALS = tuple(each for each in (signal.SIGINT, _TERMINATE, _SIGHUP) if each is not None)
# File name of the frames that import a module.
_IMPORTS = "<frozen importlib._bootstrap>"

# Set once a job has a state on the disk from which the same call continues.
STATE_IS_KEPT = threading.Event()

_Handler = Callable[[int, FrameType | None], None]

# Blocks of `interruptible` that the main thread is in, and the signal that they have received.
_blocks = 0
_pending: int | None = None
# In a worker of a pool: whether its pool has stopped it; None in other processes.
_stopped: bool | None = None


class Interrupted(KeyboardInterrupt):
    """A stop signal ended the work.

    Attributes:
        number: number of the signal.
    """

    def __init__(self, message: str = "", number: int = signal.SIGINT) -> None:
        super().__init__(message)
        self.number = int(number)


class Interruption:
    """Whether a stop signal was received, and which one.

    Attributes:
        number: number of the signal; None if none was received.
    """

    def __init__(self) -> None:
        self.number: int | None = None

    def __bool__(self) -> bool:
        return self.number is not None


def interruption_behind(error: BaseException | None) -> Interrupted | None:
    """The signal that caused an error; None if it was not a signal.

    Dr.Jit wraps an exception that is raised while it traces a loop.
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error if error is None or isinstance(error, Interrupted) else Interrupted()


@contextmanager
def interruptible() -> Iterator[None]:
    """Context in which every stop signal raises `Interrupted`; in the main thread only.

    After a signal any exception that leaves the block becomes `Interrupted`, since a library may
    have caught that one and raised its own. If nothing leaves the block, its work is complete, and
    the signal is pending in the block around it, if there is one.
    """
    global _blocks, _pending
    if not _in_main_thread():
        yield
        return
    imports = _imports(sys._getframe())

    def receive(number: int, frame: FrameType | None) -> None:
        global _pending
        _announce("stopping ...", number)
        again, _pending = _pending is not None, number
        if again or _imports(frame) <= imports:
            raise Interrupted(number=number)

    _blocks += 1
    try:
        with _handling(dict.fromkeys(STOP_SIGNALS, receive)):
            try:
                yield
            except Exception:
                raise_interruption()
                raise
    except BaseException:
        _pending = None
        raise
    finally:
        _blocks -= 1
        if not _blocks:
            _pending = None


def raise_interruption() -> None:
    """Raise `Interrupted` if the block of `interruptible` around has received a signal."""
    if _pending is not None and _in_main_thread():
        raise Interrupted(number=_pending)


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
    raise_interruption()
    with contextlib.ExitStack() as stack:

        def note(number: int, _: FrameType | None) -> None:
            _announce(text, number)
            interruption.number = number
            stack.close()

        stack.enter_context(_handling(dict.fromkeys(STOP_SIGNALS, note)))
        yield interruption


def is_program() -> bool:
    """Whether the process is the command line, and not a program that imports lumitree."""
    name = os.path.basename(sys.argv[0]) if getattr(sys, "argv", None) else ""
    # While Python locates the module of `python -m`, the name is -m. Windows has programs .exe.
    module = " ".join(sys.orig_argv).partition(" -m ")[2].split()[:1]
    return name in ("lumitree", "lumitree.exe") or (name == "-m" and module == ["lumitree"])


def exit_on_signals() -> None:
    """Let every stop signal that is not ignored end the process at once, with one line."""

    def end(number: int, _: object) -> None:
        try:
            os.write(2, b"lumitree: error: interrupted before the command began\n")
        finally:
            os._exit(128 + number)

    for number in STOP_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, end)


def ignore_signals() -> None:
    """Ignore stop signals from now on: the exit status is known."""
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


class _Messages(io.FileIO):
    """Standard error that drops messages which cannot be written, as to a pipe that is closed."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError:
            return len(data)


def open_streams() -> None:
    """Open the null device in place of standard streams that the parent process has closed.

    Otherwise files would get their descriptors, and messages would be written into these files. A
    standard error that nobody reads any more does not end the work either.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            # The lowest number that is free, for this process and its children.
            descriptor = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(descriptor, True)
            setattr(sys, name, os.fdopen(descriptor, mode, closefd=False))
    if not sys.stderr.isatty():
        raw = _Messages(sys.stderr.fileno(), "w", closefd=False)
        sys.stderr = io.TextIOWrapper(
            io.BufferedWriter(raw), sys.stderr.encoding, sys.stderr.errors, write_through=True
        )


@contextmanager
def stop_signals_blocked() -> Iterator[None]:
    """Context whose processes are started with stop signals blocked, where that can be done."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def begin_worker() -> None:
    """Let only the parent of this process stop its tasks, by SIGTERM, and announce nothing.

    Ctrl-C and the closing of a terminal reach all processes of a command, and the parent decides.
    """
    global _stopped
    _stopped = False
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    # Between tasks there is nothing to stop, but an ignored signal would stay so in them.
    signal.signal(_TERMINATE, lambda number, _: _announce("", number))
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOP_SIGNALS)


def raise_if_stopped() -> None:
    """Raise `Interrupted` in a worker whose pool has stopped an earlier task of it."""
    if _stopped:
        raise Interrupted(number=_TERMINATE)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def _imports(frame: FrameType | None) -> int:
    """Number of frames that import a module, in the calls that led to a frame."""
    count = 0
    while frame is not None:
        count += frame.f_code.co_filename == _IMPORTS
        frame = frame.f_back
    return count


@contextmanager
def _handling(handlers: Mapping[int, _Handler]) -> Iterator[None]:
    """Context in which the signals that are not ignored have handlers."""
    # None: the handler was not installed from Python.
    before = {number: signal.getsignal(number) for number in handlers}
    before = {key: each for key, each in before.items() if each not in (signal.SIG_IGN, None)}
    for number in before:
        signal.signal(number, handlers[number])
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def _announce(text: str, number: int) -> None:
    """Write a line to standard error without its buffer, which a signal may have interrupted."""
    global _stopped
    if _stopped is not None:
        # The parent process writes it.
        _stopped = True
        return
    if number == _SIGHUP:
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
    assert termios is not None
    for descriptor in (1, 2):
        try:
            termios.tcgetattr(descriptor)
        except termios.error as error:
            if error.args[0] == errno.EIO:
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, descriptor)
                os.close(nowhere)
