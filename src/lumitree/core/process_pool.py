"""A pool of processes on this machine, whose workers share its cores.

Workers are spawned, never forked: Mitsuba and JAX have threads, which a fork does not copy. They
import what their tasks need, and nothing else.

Ctrl-C and the closing of a terminal reach all processes of a command. The workers ignore them, and
the parent decides. At the end of the pool it sends SIGTERM to workers that have a task, by which
the task ends as any work of lumitree does, with its state saved. Where there is no such signal, on
Windows, each worker looks at a shared flag, and interrupts its task itself.
"""

import _thread
import contextlib
import ctypes
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.sharedctypes import RawValue
from typing import Any

from lumitree.core import backend
from lumitree.core.arguments import check_count
from lumitree.core.interruption import (
    STOP_SIGNALS,
    Interrupted,
    announce_nothing,
    interruptible,
)
from lumitree.core.system import (
    MAX_WORKERS,
    TASK_STOP,
    TERMINATES_AT_ONCE,
    stop_signals_blocked,
    unblock_stop_signals,
)

# Interval at which a worker looks at the flag of its pool, s.
_LOOK_SECONDS = 0.2
# Variables of OpenBLAS, MKL, Accelerate, and libraries that use OpenMP.
_BLAS_VARIABLES = (
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "OMP_NUM_THREADS",
)
# In a worker: whether its pool has ended (a shared flag); None in other processes.
_ended: Any = None


@contextlib.contextmanager
def process_pool(workers: int) -> Iterator[Executor]:
    """Context with an executor that runs tasks in processes of this machine.

    Each process takes an equal share of the cores. A process begins when there is a task for it. At
    the end of the block tasks that are not finished are stopped.

    As all processes that are spawned, these import the script that is run, which therefore begins
    its work below `if __name__ == "__main__":`.

    Args:
        workers: number of processes, 1 to 1024; on Windows to 61.

    Raises:
        LumitreeError: the number is out of range.

    Example:
        >>> with lumitree.process_pool(4) as executor:
        ...     lumitree.render("room.xml", executor=executor).save("room.exr")
    """
    check_count("workers", workers, 1, MAX_WORKERS)
    threads, ended = max(1, backend.num_cores() // workers), RawValue(ctypes.c_bool, False)
    context = _Context(threads)
    settings = (ended, threads, backend.is_quiet())
    # It starts the process that removes Python's semaphores, which the signals would end too.
    with stop_signals_blocked():
        executor = ProcessPoolExecutor(workers, context, _begin_worker, settings)
    try:
        yield executor
    finally:
        ended.value = True
        begun = [process for process in context.made if process.pid is not None]
        try:
            if TERMINATES_AT_ONCE:
                # They end by themselves; signals reach only waits that are short.
                executor.shutdown(wait=False, cancel_futures=True)
                while any(process.is_alive() for process in begun):
                    time.sleep(_LOOK_SECONDS)
            else:
                for process in begun:
                    process.terminate()
                executor.shutdown(cancel_futures=True)
        except BaseException:
            # A second signal.
            for process in begun:
                process.kill()
            raise


@contextlib.contextmanager
def stopped_by_pool() -> Iterator[None]:
    """Context of a task: in a worker of a pool the end of the pool raises `Interrupted` in it.

    A signal that reaches a worker first ends the pool too: otherwise the next task would begin.
    """
    if _ended is None:
        yield
        return
    try:
        with interruptible():
            if _ended.value:
                raise Interrupted(number=signal.SIGTERM)
            yield
    except Interrupted:
        _ended.value = True
        raise


class _Process(SpawnProcess):
    """A process that receives stop signals only when it can handle them, see `_begin_worker`."""

    threads = 1

    def start(self) -> None:
        with stop_signals_blocked(), _threads_of_blas(self.threads):
            super().start()


class _Context(SpawnContext):
    """Start method of a pool whose processes compute with so many threads each."""

    def __init__(self, threads: int) -> None:
        super().__init__()
        self.made: list[_Process] = []
        self._threads = threads

    def Process(self, *args: Any, **kwargs: Any) -> _Process:  # noqa: N802  # pyright: ignore
        process = _Process(*args, **kwargs)
        process.threads = self._threads
        self.made.append(process)
        return process


@contextlib.contextmanager
def _threads_of_blas(count: int) -> Iterator[None]:
    """Context in which processes that begin have so many threads for NumPy's matrix products.

    Otherwise each has as many as there are cores, which wait for each other in loops. NumPy reads
    the variables when it is imported, and those that the user has set stay.
    """
    names = [name for name in _BLAS_VARIABLES if name not in os.environ]
    os.environ |= dict.fromkeys(names, str(count))
    try:
        yield
    finally:
        for name in names:
            del os.environ[name]


def _begin_worker(ended: Any, threads: int, quiet: bool) -> None:
    """Prepare a worker; imports neither Mitsuba nor JAX."""
    global _ended
    _ended = ended
    announce_nothing()
    for number in STOP_SIGNALS:
        # Between tasks there is nothing to stop, but an ignored signal would stay so in them.
        between = (lambda *_: None) if number == TASK_STOP else signal.SIG_IGN
        signal.signal(number, between)
    unblock_stop_signals()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if TERMINATES_AT_ONCE:
        threading.Thread(target=_end_with_pool, daemon=True).start()
    backend.use_threads(threads)
    if quiet:
        backend.quieten()


def _end_with_pool() -> None:
    """Stop the task of this worker when its pool has ended."""
    while not _ended.value:
        time.sleep(_LOOK_SECONDS)
    _thread.interrupt_main(TASK_STOP)


def _end_with_parent() -> None:
    """End this worker when its parent was killed: its queue of tasks would stay open."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
