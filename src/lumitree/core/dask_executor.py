"""The executor of a Dask scheduler: an optional dependency, `lumitree[cluster]`."""

import contextlib
import importlib
import logging
from collections.abc import Iterator
from concurrent.futures import Executor

from lumitree.core.extras import check_cluster
from lumitree.errors import LumitreeError, shown


@contextlib.contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Context with an executor that runs tasks on the workers of a Dask scheduler.

    Dask places the tasks, and repeats those whose worker is lost. At the end of the block tasks
    that have not begun are cancelled; those that run are not stopped.

    Args:
        address: of the scheduler, such as "tcp://192.168.0.2:8786".

    Raises:
        LumitreeError: Dask is not installed, there is no scheduler, or it has no workers.
    """
    check_cluster()
    distributed = importlib.import_module("distributed")

    # Loss of connection is an exception; Dask logs it on many lines too.
    # Some of its loggers have levels of their own.
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
