"""pytest plugin: a test whose worker process died is run once more, in a new worker.

Dr.Jit or LLVM crashed in one of some dozens of runs of the suite, in a test that passes otherwise.
The summary counts it as "rerun". A test that fails, or that crashes twice, fails.
"""

_crashed: set[str] = set()


def pytest_handlecrashitem(crashitem, report, sched):
    if crashitem not in _crashed:
        _crashed.add(crashitem)
        report.outcome = "rerun"
        sched.mark_test_pending(crashitem)
