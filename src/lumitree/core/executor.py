"""Lists of independent tasks on an executor that the caller gives.

An executor is any `concurrent.futures.Executor`: the pool of `core.process_pool`, that of a Dask
client, and others. It decides where and when a task runs. A task is a function of a module and its
arguments, all of which can be pickled.
"""

import contextlib
import itertools
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from typing import Any, TypeVar

from lumitree._version import __version__
from lumitree.core.backend import load_mitsuba
from lumitree.core.packing import variant_here
from lumitree.core.process_pool import stopped_by_pool
from lumitree.core.progress import reporting
from lumitree.core.system import WAIT_SECONDS
from lumitree.core.turns import passed_on, turn
from lumitree.errors import LumitreeError, LumitreeWarning, explained, shown

R = TypeVar("R")
# Tasks that are submitted and whose results are not read yet, for each worker; and the number of
# workers where the executor does not state it.
_TASKS_PER_WORKER, _ASSUMED_WORKERS = 2, 32


def check_executor(executor: Executor | None) -> None:
    """Refuse an executor that is of another kind, or forks its processes.

    Raises:
        LumitreeError: it is neither a `concurrent.futures.Executor` nor None, or it forks.
    """
    if executor is not None and not isinstance(executor, Executor):
        kind = f"{type(executor).__module__}.{type(executor).__qualname__}"
        raise LumitreeError(
            f"executor is a {shown(kind)}; expected a concurrent.futures.Executor, such as that of "
            "lumitree.process_pool or of dask.distributed.Client.get_executor"
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
    arguments: Iterable[tuple[Any, ...]],
    *,
    what: str,
    total: int | None = None,
    in_order: bool = False,
    remedy: str = "the same command continues",
) -> Iterator[Iterator[tuple[int, R]]]:
    """Context with an iterator over the results of tasks: (index of the task, result).

    Only a few tasks for each worker are submitted at once, so that few results wait to be read; the
    next are submitted when a result is asked for. At the end of the block, also by a signal or an
    error, tasks that have not begun are cancelled.

    A task reports no progress. Its warnings of lumitree become those of this process, each text
    once. An exception of a task is raised when its result is asked for. `LumitreeError` has its
    type and text.

    Args:
        executor: what runs the tasks. In one process they run one after another.
        function: of a module, so that it can be pickled. It runs with the variant of Mitsuba that
            is set here, if there is one.
        arguments: those of each task, as a tuple; read only when the task is submitted.
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
    pending: dict[Future[Any], int] = {}
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
    arguments: Iterable[tuple[Any, ...]],
    pending: dict[Future[Any], int],
    names: tuple[str, int | None, str],
    in_order: bool,
) -> Iterator[tuple[int, R]]:
    """The iterator of `run_tasks`; `pending` are the tasks whose results are not read yet."""
    limit, waiting, told = tasks_at_once(executor), enumerate(arguments), set[str]()
    for finished in itertools.count():
        with _explaining_loss(finished, *names):
            for index, each in itertools.islice(waiting, limit - len(pending)):
                # Some executors run tasks in threads of this process.
                with passed_on():
                    future = executor.submit(_run, __version__, variant_here(), function, each)
                pending[future] = index
            if not pending:
                return
            awaited, done = [next(iter(pending))] if in_order else list(pending), set[Future[Any]]()
            while not done:
                with passed_on():
                    done = wait(awaited, WAIT_SECONDS, FIRST_COMPLETED).done
            future = min(done, key=pending.__getitem__)
            result, messages = future.result()
        index = pending.pop(future)
        for message in messages:
            if message not in told:
                told.add(message)
                warnings.warn(message, LumitreeWarning, stacklevel=3)
        yield index, result


def _run(
    version: str, variant: str | None, function: Callable[..., R], arguments: tuple[Any, ...]
) -> tuple[R, list[str]]:
    if version != __version__:
        raise LumitreeError(
            f"a worker has lumitree {__version__}, but the tasks are of lumitree {version}; "
            "install the same version everywhere"
        )
    with turn(), stopped_by_pool(), reporting(None):
        if variant is not None and "mitsuba" in sys.modules:
            # Objects that a worker keeps from an earlier task belong to the variant of that task.
            load_mitsuba(variant)
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
        # Dask has an exception of its own.
        if not isinstance(error, BrokenExecutor | CancelledError) and (
            type(error).__name__ != "KilledWorker"
        ):
            raise
        count = f"{finished:,}" if total is None else f"{finished:,} of {total:,}"
        lost = "a worker ended unexpectedly, perhaps for lack of memory"
        if isinstance(error, CancelledError):
            lost = "the connection to the workers was lost, or the tasks were cancelled there"
        raise LumitreeError(f"{lost}; {count} {what} are finished; {remedy}") from error
