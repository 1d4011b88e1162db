"""Lists of independent tasks on executors: any, processes of this machine, and Dask's."""

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from lumitree._version import __version__
from lumitree.core.executor import (
    _run,
    check_executor,
    dask_executor,
    packed,
    process_pool,
    run_tasks,
    tasks_at_once,
    unpacked,
)
from lumitree.core.files import BusyFolderError, WriteError
from lumitree.errors import LumitreeError, LumitreeWarning
from support import executors
from support.executors import LastFirst

TESTS = Path(__file__).parents[1]
# Longer than any test waits.
LONG = 60.0


@pytest.fixture(scope="module")
def pool():
    with process_pool(2) as executor:
        yield executor


def results(executor, function, values, **kwargs):
    arguments = [value if isinstance(value, tuple) else (value,) for value in values]
    with run_tasks(executor, function, arguments, what="numbers", **kwargs) as found:
        return list(found)


@pytest.mark.parametrize("in_order", [False, True])
def test_results_have_the_index_of_their_task(in_order):
    executor = LastFirst()
    found = results(executor, executors.double, range(20), in_order=in_order)
    assert (found if in_order else sorted(found)) == [(index, 2 * index) for index in range(20)]
    assert executor.order != sorted(executor.order)


@pytest.mark.parametrize("in_order", [False, True])
def test_few_results_are_held(in_order):
    executor, read = LastFirst(3), []

    def arguments():
        for index in range(100):
            read.append(index)
            yield (index,)

    with run_tasks(
        executor, executors.double, arguments(), what="numbers", in_order=in_order
    ) as found:
        assert read == []
        next(found)
        assert len(read) == tasks_at_once(executor) == 6
        list(found)
    assert len(read) == 100
    assert executor.most <= 6


def test_warnings_of_tasks_are_given_once():
    with pytest.warns(LumitreeWarning) as caught:
        results(LastFirst(), executors.warn, [1, 1, 2, 1])
    assert sorted(str(each.message) for each in caught) == ["only 1", "only 2"]


@pytest.mark.parametrize(
    "error",
    [
        LumitreeError("a line"),
        WriteError(Path("a/b.exr"), OSError(28, "No space left on device")),
        BusyFolderError(Path("a"), "taken"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_can_be_pickled(error):
    copy = pickle.loads(pickle.dumps(error))
    assert (type(copy), str(copy), vars(copy)) == (type(error), str(error), vars(error))


def test_an_executor_of_another_kind_is_refused():
    check_executor(None)
    with pytest.raises(LumitreeError, match=r"executor is a builtins\.int; expected a concurrent"):
        check_executor(3)  # pyright: ignore[reportArgumentType]
    with (
        pytest.raises(LumitreeError, match="executor is a"),
        run_tasks(object(), executors.double, [(1,)], what="numbers"),  # pyright: ignore[reportArgumentType]
    ):
        pass


def test_processes_that_are_forked_are_refused():
    with (
        ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as executor,
        pytest.raises(LumitreeError, match=r'may hang; make it with mp_context=.*"spawn"'),
    ):
        check_executor(executor)


class Lossy(Executor):
    """Loses its workers with an exception after some tasks."""

    def __init__(self, error, after):
        self.error, self.left = error, after

    def submit(self, function, /, *args, **kwargs):
        future = Future()
        if self.left:
            future.set_result(function(*args, **kwargs))
            self.left -= 1
        else:
            future.set_exception(self.error)
        return future


class KilledWorker(Exception):  # noqa: N818
    """As Dask's."""


@pytest.mark.parametrize(
    ("error", "loss"),
    [
        (BrokenExecutor("broken"), "a worker ended unexpectedly, perhaps for lack of memory"),
        (KilledWorker("a task"), "a worker ended unexpectedly, perhaps for lack of memory"),
        (CancelledError(), "the connection to the workers was lost, or the tasks were cancelled"),
    ],
)
def test_the_loss_of_a_worker_is_one_line(error, loss):
    expected = f"^{loss}.*; 3 of 5 numbers are finished; the same command continues$"
    with pytest.raises(LumitreeError, match=expected):
        results(Lossy(error, 3), executors.double, range(5), total=5, in_order=True)


def test_tasks_run_with_the_variant_that_was_set_where_they_were_submitted(monkeypatch):
    """A worker keeps objects of an earlier task's variant, which another variant cannot use."""
    loaded = []
    monkeypatch.setattr("lumitree.core.backend.load_mitsuba", loaded.append)
    # As after a task that has used it.
    monkeypatch.setitem(sys.modules, "mitsuba", sys.modules.get("mitsuba"))
    for variant in ("llvm_ad_spectral", "llvm_ad_rgb", None):
        monkeypatch.setattr("lumitree.core.executor.variant_here", lambda variant=variant: variant)
        assert results(LastFirst(), executors.double, [1]) == [(0, 2)]
    assert loaded == ["llvm_ad_spectral", "llvm_ad_rgb"]


def test_a_pool_runs_tasks_in_its_processes(pool):
    found = results(pool, executors.pid, range(8))
    processes = {process for _, process in found}
    assert 1 <= len(processes) <= 2
    assert os.getpid() not in processes


def test_workers_import_what_their_tasks_need(pool):
    assert sorted(results(pool, executors.heavy_imports, [(), ()])) == [(0, []), (1, [])]


def test_a_worker_of_another_version_is_refused():
    expected = r"^a worker has lumitree .*, but the tasks are of lumitree 0\.0\.1; install the same"
    with pytest.raises(LumitreeError, match=expected):
        _run("0.0.1", None, executors.double, (1,))


def test_errors_and_warnings_cross_processes(pool):
    with pytest.warns(LumitreeWarning, match="^only 4$"):
        results(pool, executors.warn, [4, 4])
    with pytest.raises(LumitreeError, match="no 3"):
        results(pool, executors.fail, [3])
    with pytest.raises(WriteError, match=r"^cannot write a/b: No space left") as raised:
        results(pool, executors.fail_to_write, ["a/b"])
    assert raised.value.full
    # The pool is whole.
    assert results(pool, executors.double, [1]) == [(0, 2)]


def test_a_killed_worker_is_one_line():
    with process_pool(1) as executor, pytest.raises(LumitreeError) as raised:
        results(executor, executors.kill_itself, range(5), total=5, remedy="run it again")
    assert str(raised.value) == (
        "a worker ended unexpectedly, perhaps for lack of memory; 2 of 5 numbers are finished; "
        "run it again"
    )


def test_the_end_of_a_pool_stops_tasks(tmp_path):
    """Those that save their state do so; what waits does not begin."""
    with process_pool(2) as executor:
        for name, task in (
            ("a", executors.begin_and_wait),
            ("b", executors.begin_and_save),
            ("c", executors.begin_and_save),
        ):
            executor.submit(_task, task, tmp_path, name)
        while len(list(tmp_path.iterdir())) < 2:
            time.sleep(0.01)
    assert sorted(path.name.partition(".")[0] for path in tmp_path.iterdir()) == ["a", "b", "b"]
    assert (tmp_path / "b.saved").exists()


def _task(*arguments):
    return _run(__version__, None, arguments[0], arguments[1:])


SCRIPT = """
import sys
from lumitree.core.executor import process_pool, run_tasks
from lumitree.core.interruption import interruptible
from support import executors

if __name__ == "__main__":
    tasks = [(sys.argv[1], str(index)) for index in range(9)]
    with interruptible(), process_pool(2) as executor:
        with run_tasks(executor, executors.begin_and_wait, tasks, what="tasks") as results:
            list(results)
"""


def start_script(folder):
    """A script with two workers, each of which has begun a task; and their process ids."""
    script = folder / "script.py"
    script.write_text(textwrap.dedent(SCRIPT))
    tasks = folder / "tasks"
    tasks.mkdir()
    process = subprocess.Popen(
        [sys.executable, script, tasks],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS), *sys.path])},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + LONG
    while len(list(tasks.iterdir())) < 2:
        assert time.monotonic() < deadline
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.01)
    return process, [int(path.name.partition(".")[2]) for path in tasks.iterdir()]


def is_running(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    if not os.path.isdir("/proc"):
        return True
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def wait_for_end(processes):
    deadline = time.monotonic() + LONG
    while any(map(is_running, processes)):
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.skipif(os.name == "nt", reason="it has no groups of processes")
def test_a_signal_to_all_processes_ends_them(tmp_path):
    """As Ctrl-C does; only the parent writes of it."""
    process, workers = start_script(tmp_path)
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=LONG)
    wait_for_end(workers)
    assert error.count("lumitree: stopping ...") == 1
    assert error.rstrip().splitlines()[-1].startswith("lumitree.core.interruption.Interrupted")
    assert len(list((tmp_path / "tasks").iterdir())) == 2


@pytest.mark.skipif(os.name == "nt", reason="there os.kill ends a process")
def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    process, workers = start_script(tmp_path)
    process.kill()
    process.communicate()
    wait_for_end(workers)


def test_values_are_unpacked():
    value = {"a": (1, "b"), "c": np.arange(3)}
    found = unpacked(packed(value, "the scene", "a path"))
    assert found["a"] == value["a"]
    assert np.array_equal(found["c"], value["c"])
    assert packed(value, "the scene", "a path") == packed(value, "the scene", "a path")


@pytest.mark.parametrize(
    "kind", ["ScalarTransform4f", "ScalarProjectiveTransform4f", "Transform4f", "ScalarTransform3f"]
)
def test_transforms_are_unpacked(mi, kind):
    transform = getattr(mi, kind)().translate([1, 2, 3][: int(kind[-2]) - 1])
    transform = transform @ type(transform)().scale(2.5)
    (found,) = unpacked(packed([transform], "the scene", "a path"))
    assert type(found) is type(transform)
    assert np.array_equal(np.array(found.matrix), np.array(transform.matrix))
    inverse = np.array(transform.inverse().matrix)
    assert np.array(found.inverse().matrix) == pytest.approx(inverse, rel=1e-5, abs=1e-6)


def test_arrays_and_points_of_mitsuba_are_unpacked(mi):
    value = [mi.ScalarPoint3f(1, 2, 3), mi.TensorXf(np.ones((2, 3)))]
    point, tensor = unpacked(packed(value, "the scene", "a path"))
    assert list(point) == [1, 2, 3]
    assert np.array(tensor).tolist() == np.ones((2, 3)).tolist()


def test_other_objects_are_refused(mi):
    expected = r"^the scene cannot be sent to other processes \(.+\); give a path$"
    for value in (lambda: 0, mi.load_dict({"type": "sphere"})):
        with pytest.raises(LumitreeError, match=expected):
            packed({"a": value}, "the scene", "a path")


# Its event loops leave sockets open.
DASK = pytest.mark.filterwarnings("ignore::ResourceWarning")


@pytest.fixture(scope="module")
def cluster():
    distributed = pytest.importorskip("distributed")
    options = {"processes": False, "protocol": "tcp://", "dashboard_address": ":0"}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, **options) as made:
        yield made


@DASK
def test_dask_gives_results_errors_and_warnings(cluster):
    executors.calls.clear()
    with dask_executor(cluster.scheduler_address) as executor:
        expected = [(index, 2 * index) for index in range(20)]
        assert results(executor, executors.double, range(20), in_order=True) == expected
        with pytest.warns(LumitreeWarning, match=r"^only 4$"):
            results(executor, executors.warn, [4, 4])
        with pytest.raises(LumitreeError, match=r"^no 3$"):
            results(executor, executors.fail, [3])
        # Equal tasks run twice: they may write files.
        for _ in range(2):
            results(executor, executors.count, [1, 1, 1])
    assert executors.calls == [1] * 6


@DASK
def test_dask_without_a_scheduler_or_workers_is_one_line(cluster):
    import dask.config

    with dask.config.set({"distributed.comm.timeouts.connect": "0.1s"}):
        for address in ("tcp://127.0.0.1:9", "nowhere at all"):
            with (
                pytest.raises(LumitreeError, match=f"^no Dask scheduler answers at {address} "),
                dask_executor(address),
            ):
                pass
    cluster.scale(0)
    cluster.sync(cluster._correct_state)
    with (
        pytest.raises(LumitreeError, match="has no workers; start some with `dask worker"),
        dask_executor(cluster.scheduler_address),
    ):
        pass
