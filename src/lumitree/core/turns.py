"""Calls of several threads wait for each other: the state of Mitsuba belongs to a process.

Dr.Jit traces the methods of all objects of the process, also of those that another thread is just
creating, in any scene.
"""

import contextlib
import functools
import threading
from collections.abc import Callable, Iterator
from typing import Any, TypeVar, cast

from lumitree.errors import explained

F = TypeVar("F", bound=Callable[..., Any])

_lock = threading.Lock()
# The thread that holds the lock.
_holder: int | None = None


@contextlib.contextmanager
def turn() -> Iterator[None]:
    """Context that only one thread of the process is in; a thread may enter it again."""
    global _holder
    if _holder == threading.get_ident():
        yield
        return
    _lock.acquire()
    _holder = threading.get_ident()
    try:
        yield
    finally:
        # A signal may have ended `passed_on` while it waited.
        if _holder == threading.get_ident():
            _holder = None
            _lock.release()


@contextlib.contextmanager
def passed_on() -> Iterator[None]:
    """Context in which other threads may have the turn of this one, which waits for them."""
    global _holder
    if _holder != threading.get_ident():
        yield
        return
    _holder = None
    _lock.release()
    try:
        yield
    finally:
        _lock.acquire()
        _holder = threading.get_ident()


def in_turn(function: F) -> F:
    """Decorator of public functions that compute with Mitsuba: `explained`, and by `turn`."""

    @functools.wraps(function)
    def run(*args: Any, **kwargs: Any) -> Any:
        with turn():
            return function(*args, **kwargs)

    return cast(F, explained(run))
