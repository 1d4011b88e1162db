"""Tasks on the workers of a Dask scheduler."""

import pytest

from lumitree.core.dask_executor import dask_executor
from lumitree.core.executor import run_tasks
from lumitree.errors import LumitreeError, LumitreeWarning
from support import executors

distributed = pytest.importorskip(
    "distributed", reason="the optional dependency cluster is not installed"
)
# Dask's own, of its event loops.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")


@pytest.fixture(scope="module")
def address():
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        protocol="tcp://",
        dashboard_address=":0",
    ) as cluster:
        yield cluster.scheduler_address


def results(executor, function, values, **options):
    arguments = [(value,) for value in values]
    with run_tasks(executor, function, arguments, what="numbers", **options) as found:
        return list(found)


def test_results_errors_and_warnings(address):
    with dask_executor(address) as executor:
        expected = [(index, 2 * index) for index in range(20)]
        assert results(executor, executors.double, range(20), in_order=True) == expected
        assert sorted(results(executor, executors.double, range(20))) == expected
        with pytest.warns(LumitreeWarning, match=r"^only 4$"):
            results(executor, executors.warn, [4, 4])
        with pytest.raises(LumitreeError, match=r"^no 3$"):
            results(executor, executors.fail, [3])


def test_equal_tasks_run_twice(address):
    """They may write files."""
    executors.calls.clear()
    with dask_executor(address) as executor:
        for _ in range(2):
            results(executor, executors.count, [1, 1, 1])
    assert executors.calls == [1] * 6


def test_no_scheduler_and_no_workers_are_one_line():
    import dask

    with (
        pytest.raises(LumitreeError, match=r"^no Dask scheduler answers at tcp://127.0.0.1:9 \("),
        dask.config.set({"distributed.comm.timeouts.connect": "0.1s"}),
        dask_executor("tcp://127.0.0.1:9"),
    ):
        pass
    with (
        pytest.raises(LumitreeError, match="no Dask scheduler answers at nowhere at all"),
        dask_executor("nowhere at all"),
    ):
        pass
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, protocol="tcp://", dashboard_address=":0"
        ) as cluster,
        pytest.raises(LumitreeError, match="has no workers; start some with `dask worker"),
        dask_executor(cluster.scheduler_address),
    ):
        pass
