"""Lists of independent tasks on an executor that the caller gives, and two executors.

An executor is any `concurrent.futures.Executor`: the processes of `process_pool`, the workers of a
Dask scheduler (`dask_executor`), and others. It decides where and when a task runs. A task is a
function of a module and its arguments, all of which can be pickled.
"""

import contextlib
import importlib
import io
import itertools
import logging
import multiprocessing
import os
import pickle
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, TypeVar

import numpy as np

from lumitree._version import __version__
from lumitree.core import backend
from lumitree.core.arguments import check_count
from lumitree.core.backend import check_cluster, passed_on, turn
from lumitree.core.interruption import (
    begin_worker,
    interruptible,
    raise_if_stopped,
    stop_signals_blocked,
)
from lumitree.core.progress import reporting
from lumitree.errors import LumitreeError, LumitreeWarning, explained, shown

R = TypeVar("R")
# Tasks that are submitted and whose results are not read yet, for each worker; and the number of
# workers of an executor that does not state it.
_TASKS_PER_WORKER, _ASSUMED_WORKERS = 2, 32
# Windows waits for at most 63 things at once.
_MAX_WORKERS = 61 if os.name == "nt" else 1024
# Longest wait for a result, s: on Windows a signal does not end it.
_WAIT_SECONDS = 0.2 if os.name == "nt" else None
# Variables of OpenBLAS, MKL, Accelerate, and libraries that use OpenMP.
_BLAS_VARIABLES = (
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "OMP_NUM_THREADS",
)


def check_executor(executor: Executor | None) -> None:
    """Refuse an executor that is of another kind, or forks its processes.

    Raises:
        LumitreeError: it is neither a `concurrent.futures.Executor` nor None, or it forks.
    """
    if executor is not None and not isinstance(executor, Executor):
        kind = f"{type(executor).__module__}.{type(executor).__qualname__}"
        raise LumitreeError(
            f"executor is a {shown(kind)}; expected a concurrent.futures.Executor, such as the one "
            "of lumitree.process_pool or of dask.distributed.Client.get_executor"
        )
    context = getattr(executor, "_mp_context", None)
    if context is not None and context.get_start_method() == "fork":
        raise LumitreeError(
            "the executor forks its processes, in which Mitsuba and JAX may hang; make it with "
            'mp_context=multiprocessing.get_context("spawn"), or by lumitree.process_pool'
        )


@contextlib.contextmanager
def run_tasks(
    executor: Executor,
    function: Callable[..., R],
    arguments: Iterable[tuple[object, ...]],
    *,
    what: str,
    total: int | None = None,
    in_order: bool = False,
    remedy: str = "the same command continues",
) -> Iterator[Iterator[tuple[int, R]]]:
    """Context with an iterator over the results of tasks: (index of the task, result).

    Only a few tasks for each worker are submitted at once, so that few results wait to be read; the
    next are submitted when a result is read. At the end of the block, also by a signal or an
    error, tasks that have not begun are cancelled.

    A task reports no progress. Its warnings of lumitree become warnings of this process, each text
    once. An exception of a task is raised when its result is read. `LumitreeError` has its type and
    text.

    Args:
        executor: runs the tasks. In one process they run one after another.
        function: of a module, so that it can be pickled. It runs with the variant of Mitsuba that
            is set here, if there is one.
        arguments: of each task, as a tuple; read only when the task is submitted.
        what: name of the results in the plural, for messages, such as "views".
        total: number of tasks, for messages; None if it is not known.
        in_order: whether results come in the order of the tasks, for sums whose last digits depend
            on it; by default as the tasks finish.
        remedy: what to do if a worker is lost, for the message.

    Raises:
        LumitreeError: a worker was lost, or a task raised it.

    Example:
        >>> with run_tasks(executor, take, [(1,), (2,)], what="views", total=2) as results:
        ...     for index, view in results:
        ...         write(index, view)
    """
    check_executor(executor)
    pending: dict[Future[tuple[R, list[str]]], int] = {}
    try:
        yield _results(executor, function, arguments, pending, (what, total, remedy), in_order)
    finally:
        for future in pending:
            future.cancel()


def tasks_at_once(executor: Executor) -> int:
    """How many tasks are submitted before the result of one is read."""
    workers = getattr(executor, "_max_workers", None)
    if (client := getattr(executor, "_client", None)) is not None:  # of Dask
        workers = sum(client.nthreads().values())
    if not isinstance(workers, int) or workers <= 0:
        workers = _ASSUMED_WORKERS
    return _TASKS_PER_WORKER * workers


def _results(
    executor: Executor,
    function: Callable[..., R],
    arguments: Iterable[tuple[object, ...]],
    pending: dict[Future[tuple[R, list[str]]], int],
    names: tuple[str, int | None, str],
    in_order: bool,
) -> Iterator[tuple[int, R]]:
    """The iterator of `run_tasks`; `pending` are the tasks whose results are not read yet."""
    limit, waiting, warned = tasks_at_once(executor), enumerate(arguments), set[str]()
    for finished in itertools.count():
        with _explaining_loss(finished, *names):
            for index, each in itertools.islice(waiting, limit - len(pending)):
                # Some executors run tasks in threads of this process.
                with passed_on():
                    future = executor.submit(_run, __version__, variant_here(), function, each)
                pending[future] = index
            if not pending:
                return
            awaited, done = (
                [next(iter(pending))] if in_order else list(pending),
                set[Future[tuple[R, list[str]]]](),
            )
            while not done:
                with passed_on():
                    done = wait(awaited, _WAIT_SECONDS, FIRST_COMPLETED).done
            future = min(done, key=pending.__getitem__)
            result, messages = future.result()
        index = pending.pop(future)
        for message in messages:
            if message not in warned:
                warned.add(message)
                warnings.warn(message, LumitreeWarning, stacklevel=3)
        yield index, result


def _run(
    version: str, variant: str | None, function: Callable[..., R], arguments: tuple[object, ...]
) -> tuple[R, list[str]]:
    """Run a task in a worker; returns its result, and the texts of its warnings."""
    if version != __version__:
        raise LumitreeError(
            f"a worker has lumitree {__version__}, but the tasks are of lumitree {version}; "
            "install the same version everywhere"
        )
    with turn(), interruptible(), reporting(None):
        raise_if_stopped()
        if variant is not None and "mitsuba" in sys.modules:
            # Objects that a worker keeps from an earlier task belong to the variant of that task.
            backend.load_mitsuba(variant)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", LumitreeWarning)
            result = explained(function)(*arguments)
        messages = []
        for each in caught:
            if issubclass(each.category, LumitreeWarning):
                messages.append(str(each.message))
            else:
                warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)
    return result, messages


@contextlib.contextmanager
def _explaining_loss(finished: int, what: str, total: int | None, remedy: str) -> Iterator[None]:
    """Context in which the loss of a worker becomes a `LumitreeError` of one line."""
    try:
        yield
    except Exception as error:
        # Dask raises another exception.
        if not isinstance(error, BrokenExecutor | CancelledError) and (
            type(error).__name__ != "KilledWorker"
        ):
            raise
        count = f"{finished:,}" if total is None else f"{finished:,} of {total:,}"
        lost = "a worker ended unexpectedly, perhaps for lack of memory"
        if isinstance(error, CancelledError):
            lost = "the connection to the workers was lost, or the tasks were cancelled there"
        raise LumitreeError(f"{lost}; {count} {what} are finished; {remedy}") from error


def variant_here() -> str | None:
    """The variant of Mitsuba that this process has set; None if it has set none."""
    return sys.modules["mitsuba"].variant() if "mitsuba" in sys.modules else None


def packed(value: object, name: str, expected: str) -> bytes:
    """A value as bytes, an argument of tasks that is the same for all; `unpacked` is the inverse.

    Equal values have equal bytes, so that a worker keeps the objects that it makes of them.

    Args:
        name: of the value, for the message.
        expected: what can be given in its place, for the message.

    Raises:
        LumitreeError: it cannot be pickled.
    """
    memory = io.BytesIO()
    try:
        _Pickler(memory).dump(value)
    except Exception as error:
        reason = " ".join(str(error).split())
        raise LumitreeError(
            f"{name} cannot be sent to other processes ({shown(reason, 200)}); give {expected}"
        ) from error
    return pickle.dumps((variant_here(), memory.getvalue()))


def unpacked(data: bytes) -> Any:
    """The value of `packed`; sets the variant of Mitsuba that was set there."""
    variant, value = pickle.loads(data)
    if variant is not None:
        backend.load_mitsuba(variant)
    return pickle.loads(value)


class _Pickler(pickle.Pickler):
    """Pickles Mitsuba's transforms too, which dictionaries of scenes have."""

    def reducer_override(self, obj: object) -> Any:
        kind = type(obj)
        if kind.__module__.partition(".")[0] == "mitsuba" and "Transform" in kind.__name__:
            return _transform, (kind.__name__, np.array(obj.matrix))  # pyright: ignore
        return NotImplemented


def _transform(kind: str, matrix: np.ndarray) -> Any:
    return getattr(sys.modules["mitsuba"], kind)(matrix)


@contextlib.contextmanager
def process_pool(workers: int) -> Iterator[Executor]:
    """Context with an executor that runs tasks in processes of this machine.

    Each process takes an equal share of the cores. A process begins when there is a task for it. At
    the end of the block tasks that are not finished are stopped: they save their state, except on
    Windows.

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
    check_count("workers", workers, 1, _MAX_WORKERS)
    threads = max(1, backend.num_cores() // workers)
    # It starts the process that removes Python's semaphores, which the signals would end too.
    with stop_signals_blocked():
        executor = ProcessPoolExecutor(
            workers, _Context(), _begin_worker, (threads, backend.is_quiet())
        )
    with _threads_of_blas(threads):
        try:
            yield executor
        finally:
            processes = list((executor._processes or {}).values())
            try:
                for process in processes:
                    process.terminate()
                executor.shutdown(cancel_futures=True)
            except BaseException:
                # A second signal.
                for process in processes:
                    process.kill()
                raise


class _Process(SpawnProcess):
    """A process that receives stop signals only when it can handle them, see `begin_worker`."""

    def start(self) -> None:
        with stop_signals_blocked():
            super().start()


class _Context(SpawnContext):
    Process = _Process  # pyright: ignore[reportAssignmentType]


@contextlib.contextmanager
def _threads_of_blas(count: int) -> Iterator[None]:
    """Context in which processes that begin have `count` threads for NumPy's matrix products.

    Otherwise each has as many as there are cores, which wait for each other in loops. NumPy reads
    the variables when it is imported. Values that the user has set stay.
    """
    names = [name for name in _BLAS_VARIABLES if name not in os.environ]
    os.environ |= dict.fromkeys(names, str(count))
    try:
        yield
    finally:
        for name in names:
            os.environ.pop(name, None)


def _begin_worker(threads: int, quiet: bool) -> None:
    """Prepare a worker; imports neither Mitsuba nor JAX."""
    begin_worker()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    backend.use_threads(threads)
    if quiet:
        backend.quieten()


def _end_with_parent() -> None:
    """End this worker when its parent was killed: its queue of tasks would stay open."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextlib.contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Context with an executor that runs tasks on the workers of a Dask scheduler.

    Dask places the tasks, and repeats those whose worker is lost. At the end of the block tasks
    that have not begun are cancelled; those that run are not stopped.

    Args:
        address: of the scheduler, such as "tcp://192.168.0.2:8786".

    Raises:
        LumitreeError: Dask is not installed (`lumitree[cluster]`), there is no scheduler, or it has
            no workers.
    """
    check_cluster()
    distributed = importlib.import_module("distributed")

    # Loss of connection is an exception; Dask logs it on many lines too.
    # Each of its loggers may have another level.
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        # A client of a wrong address cannot be closed.
        distributed.comm.get_address_host_port(address)
        client = distributed.Client(address, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise LumitreeError(
            f"no Dask scheduler answers at {shown(address)} ({shown(reason, 200)}); start one with "
            "`dask scheduler`, and give the address that it prints"
        ) from error
    with client:
        if not client.nthreads():
            raise LumitreeError(
                f"the Dask scheduler at {shown(address)} has no workers; start some with "
                f"`dask worker {shown(address)} --nthreads 1`"
            )
        # The same task of two calls is not one task: it writes files.
        yield client.get_executor(pure=False)
