"""Executors for tests, and tasks that they run."""

import os
import queue
import signal
import sys
import threading
import time
import warnings
from concurrent.futures import Executor, Future
from pathlib import Path

from lumitree.core.backend import load_mitsuba
from lumitree.core.files import WriteError
from lumitree.core.interruption import deferred_interrupt
from lumitree.errors import LumitreeError, LumitreeWarning
from support.variant import VARIANT


class _Task(Future):
    """A future that notes whether its result was read."""

    read = False

    def result(self, timeout=None):
        self.read = True
        return super().result(timeout)


class LastFirst(Executor):
    """Runs tasks in a thread of this process, those that were submitted last first.

    Attributes:
        most: largest number of tasks that were submitted and not read at once.
        order: first argument of each task, in the order in which they ran.
    """

    def __init__(self, workers=2):
        self._max_workers = workers
        self._tasks = queue.LifoQueue()
        self.most, self.order, self._held = 0, [], set()
        self._pause = threading.Lock()
        threading.Thread(target=self._work, daemon=True).start()

    def submit(self, function, /, *args, **kwargs):
        future = _Task()
        self._held = {each for each in self._held if not each.read}
        self._held.add(future)
        self.most = max(self.most, len(self._held))
        self._tasks.put((time.monotonic(), id(future), future, function, args, kwargs))
        return future

    def _work(self):
        while True:
            task = self._tasks.get()
            # More may be submitted.
            time.sleep(0.01)
            self._tasks.put(task)
            _, _, future, function, args, kwargs = self._tasks.get()
            if not future.set_running_or_notify_cancel():
                continue
            self.order.append(args[-1][0])
            try:
                future.set_result(function(*args, **kwargs))
            except BaseException as error:
                future.set_exception(error)


# Arguments of `count` in this process.
calls = []


def count(value):
    calls.append(value)


def double(value):
    return 2 * value


def warn(value):
    warnings.warn(f"only {value}", LumitreeWarning, stacklevel=1)
    return value


def fail(value):
    raise LumitreeError(f"no {value}")


def fail_to_write(path):
    raise WriteError(Path(path), OSError(28, "No space left on device"))


def kill_itself(value):
    if value == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return value


def pid(value):
    return os.getpid()


def heavy_imports():
    """Packages imported in this process that take long to import."""
    return sorted({"mitsuba", "drjit", "jax"} & set(sys.modules))


def num_threads():
    """Threads of Dr.Jit in this process."""
    import drjit

    load_mitsuba(VARIANT)
    return drjit.thread_count()


def begin_and_wait(folder, name):
    """Say that the task has begun, and work until a signal."""
    (Path(folder) / f"{name}.{os.getpid()}").touch()
    time.sleep(60)


def begin_and_save(folder, name):
    """Say that the task has begun, and save its state when a signal is received."""
    with deferred_interrupt() as stop:
        (Path(folder) / f"{name}.{os.getpid()}").touch()
        while not stop:
            time.sleep(0.01)
    (Path(folder) / f"{name}.saved").touch()
