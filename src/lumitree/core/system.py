"""Differences between operating systems in processes."""

import contextlib
import ctypes
import errno
import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from lumitree.core.interruption import STOP_SIGNALS

try:
    import fcntl
except ImportError:
    fcntl = None

# The signal by which the pool of `process_pool` stops a task.
TASK_STOP: signal.Signals = getattr(signal, "SIGBREAK", signal.SIGTERM)
# Whether `Process.terminate` ends a process at once, without a signal that it could handle.
TERMINATES_AT_ONCE = fcntl is None
# Longest wait for a lock, s, where a signal does not end it; None where it does.
WAIT_SECONDS: float | None = 0.2 if fcntl is None else None
# The most workers of a `ProcessPoolExecutor`: Windows waits for at most 63 things at once.
MAX_WORKERS = 61 if fcntl is None else 1024
_PATIENCE_SECONDS = 2.0
# Constants of `OpenProcess` and `WaitForSingleObject`.
_SYNCHRONIZE, _ACCESS_DENIED, _WAIT_TIMEOUT = 0x00100000, 5, 0x102
R = TypeVar("R")


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
