"""Differences between operating systems.

Only this module imports what POSIX systems alone have. Elsewhere, as on Windows, files are not
locked: two processes may do the same work twice, and temporary files that killed processes left
stay. Nor are files renamed or removed there that any process has open. Nothing half-written is ever
under a final name, on any system.
"""

import _thread
import contextlib
import ctypes
import errno
import os
import re
import secrets
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

try:
    import fcntl
    import resource
    import termios
except ImportError:
    fcntl = resource = termios = None

# The terminal of the process was closed; None where no signal says so.
TERMINAL_CLOSED: int | None = getattr(signal, "SIGHUP", None)
# Ctrl-Break of Windows, where nothing outside of the process sends SIGTERM.
_BREAK: int | None = getattr(signal, "SIGBREAK", None)
_STOP = (signal.SIGINT, _BREAK or signal.SIGTERM, TERMINAL_CLOSED)
# The signals that ask a job to stop.
STOP_SIGNALS: tuple[int, ...] = tuple(number for number in _STOP if number is not None)
# Signal that `repeat` sends to this process: its alarm clock, or one that nobody else sends.
REPEATED: signal.Signals = getattr(signal, "SIGALRM", signal.SIGTERM)
# The signal by which the pool of `process_pool` stops a task.
TASK_STOP: signal.Signals = getattr(signal, "SIGBREAK", signal.SIGTERM)
# Whether `Process.terminate` ends a process at once, without a signal that it could handle.
TERMINATES_AT_ONCE = fcntl is None
# Longest wait for a lock, s, where a signal does not end it; None where it does.
WAIT_SECONDS: float | None = 0.2 if fcntl is None else None
# The most workers of a `ProcessPoolExecutor`: Windows waits for at most 63 things at once.
MAX_WORKERS = 61 if fcntl is None else 1024
# Whether the shell replaces patterns such as *.ies by the names of files.
SHELL_EXPANDS = fcntl is not None
# Endings of the name of a folder.
SEPARATORS = ("/", os.sep)
# Files that a desktop adds to folders by itself.
DESKTOP_FILES = frozenset({".DS_Store", "desktop.ini", "Thumbs.db"})
# Names of files have at most so many bytes where the system does not say how many.
_LONGEST_NAME = 255
# Names of files that Windows refuses, or takes for a device or a stream of another file.
_RESERVED = re.compile(
    r'(con|prn|aux|nul|com[0-9]|lpt[0-9])([. ].*)?|.*[<>:"|?*\x00-\x1f].*|.*[. ]', re.I | re.DOTALL
)
# For so long other processes may have a file open, such as an indexer of its folder, s.
_PATIENCE_SECONDS = 2.0
# Constants of `OpenProcess` and `WaitForSingleObject`.
_SYNCHRONIZE, _ACCESS_DENIED, _WAIT_TIMEOUT = 0x00100000, 5, 0x102
R = TypeVar("R")
# The thread that repeats a signal where there is no timer, by the event that ends it.
_repeating: threading.Event | None = None


def lock(handle: int, *, wait: bool = False) -> bool | None:
    """Lock an open file or folder for this process.

    Args:
        wait: whether to wait until no other process holds it.

    Returns:
        True, or False where another process holds it; None where there are no locks.
    """
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return False if error.errno in (errno.EWOULDBLOCK, errno.EACCES) else None
    return True


def keep(handle: int) -> int | None:
    """The handle of a locked file, to be closed by `release`.

    Where there are no locks the file is closed, and the result is None: Windows does not rename or
    remove files that are open.
    """
    if fcntl is not None:
        return handle
    os.close(handle)
    return None


def release(handle: int | None) -> None:
    """Close a handle that `keep` returned, which unlocks its file."""
    if handle is not None:
        os.close(handle)


@contextlib.contextmanager
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


def unblock_stop_signals() -> None:
    """Receive stop signals in a process that `stop_signals_blocked` has started."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOP_SIGNALS)


def num_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def open_folder(folder: Path) -> int | None:
    """Handle of a folder, to be locked; None where there are no locks."""
    return None if fcntl is None else os.open(folder, os.O_RDONLY)


def is_running(process: int) -> bool:
    """Whether there is a process of this number; True where it is not known."""
    # On Windows `os.kill` would send Ctrl-C.
    if fcntl is None:
        kernel = _kernel32()
        return kernel is None or _is_running(kernel, process)
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass
    return True


def _kernel32() -> Any:
    """Functions of Windows on processes; None on other systems."""
    if not hasattr(ctypes, "WinDLL"):
        return None
    kernel = ctypes.WinDLL("kernel32", use_last_error=True)  # type: ignore[attr-defined]
    kernel.OpenProcess.restype = ctypes.c_void_p
    kernel.WaitForSingleObject.argtypes = (ctypes.c_void_p, ctypes.c_uint32)
    kernel.CloseHandle.argtypes = (ctypes.c_void_p,)
    return kernel


def _is_running(kernel: Any, process: int) -> bool:
    """As `is_running`, by the functions of Windows."""
    handle = kernel.OpenProcess(_SYNCHRONIZE, False, ctypes.c_uint32(process))
    if not handle:
        # Nothing else is known of a process of another user.
        return ctypes.get_last_error() == _ACCESS_DENIED  # type: ignore[attr-defined]
    try:
        return kernel.WaitForSingleObject(handle, 0) == _WAIT_TIMEOUT
    finally:
        kernel.CloseHandle(handle)


def replace(source: Path, target: Path) -> None:
    """Rename a file or a folder to another name, whose file it replaces."""
    patiently(os.replace, source, target)


def remove(path: Path) -> None:
    """Remove a file, if there is one."""
    with contextlib.suppress(FileNotFoundError):
        patiently(os.unlink, path)


def patiently(function: Callable[..., R], *arguments: Any) -> R:
    """Call a function on files, which Windows refuses while another process has them open.

    Raises:
        PermissionError: it is still refused after a while; on other systems at once.
    """
    end = time.monotonic() + (_PATIENCE_SECONDS if fcntl is None else 0.0)
    while True:
        try:
            return function(*arguments)
        except PermissionError:
            if time.monotonic() >= end:
                raise
            time.sleep(0.05)


def peak_memory_bytes() -> int:
    """Largest resident memory of this process so far, in bytes; 0 where it is not known."""
    if resource is None:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def longest_name(folder: Path) -> int:
    """Largest number of bytes of the name of a file in a folder."""
    if hasattr(os, "pathconf"):
        return os.pathconf(folder, "PC_NAME_MAX")
    return _LONGEST_NAME


def accepts_name(name: str) -> bool:
    """Whether a file may have this name, apart from its length."""
    return fcntl is not None or _RESERVED.fullmatch(name) is None


def is_writable(folder: Path) -> bool:
    """Whether files can be made in a folder, by this process."""
    if fcntl is not None:
        return os.access(folder, os.W_OK | os.X_OK)
    # There `os.access` knows nothing of who may write.
    probe = folder / f".lumitree-{secrets.token_hex(8)}"
    try:
        os.close(os.open(probe, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
    except OSError:
        return False
    remove(probe)
    return True


def is_read_only(folder: Path) -> bool:
    """Whether the file system of a folder is mounted read-only; False where it is not known."""
    return hasattr(os, "statvfs") and bool(os.statvfs(folder).f_flag & os.ST_RDONLY)


def is_broken_pipe(error: OSError) -> bool:
    """Whether the program that reads the output has ended."""
    # Windows says no more than that the argument is invalid.
    return isinstance(error, BrokenPipeError) or (fcntl is None and error.errno == errno.EINVAL)


def is_closed_terminal(descriptor: int) -> bool:
    """Whether a file descriptor is of a terminal that was closed."""
    if termios is None:
        return False
    try:
        termios.tcgetattr(descriptor)
    except termios.error as error:
        return error.args[0] == errno.EIO
    return False


def repeat(seconds: float) -> None:
    """Send `REPEATED` to this process again and again until `stop_repeating`.

    Its handler runs in the main thread.

    Args:
        seconds: interval.
    """
    global _repeating
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, seconds, seconds)
    elif _repeating is None:
        _repeating = threading.Event()
        threading.Thread(target=_send, args=(seconds, _repeating.wait), daemon=True).start()


def stop_repeating() -> None:
    """Undo `repeat`."""
    global _repeating
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0)
    elif _repeating is not None:
        _repeating.set()
        _repeating = None


def _send(seconds: float, ended: Callable[[float], bool]) -> None:
    while not ended(seconds):
        _thread.interrupt_main(REPEATED)
