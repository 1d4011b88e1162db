"""Fixtures that many tests share."""

import gc
import math
import os
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from lumitree.core import progress
from lumitree.core.backend import check_network
from lumitree.core.interruption import STOP_SIGNALS
from lumitree.errors import LumitreeError
from support.variant import VARIANT

TESTS = Path(__file__).parent
# Modules of which most tests import JAX.
JAX_TESTS = (
    "fit/network/*",
    "benchmarks/test_paper.py",
)
# Modules that use what POSIX systems alone have; elsewhere they are not collected.
POSIX_TESTS = (
    "core/test_files.py",
    "core/test_interruption.py",
    "core/test_reading.py",
    "test_stops.py",
)
collect_ignore = list(POSIX_TESTS) if os.name == "nt" else []
# How long an example takes depends on the machine.
_UNTIMED = "without limits of time"
settings.register_profile(_UNTIMED, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile(_UNTIMED)


def skip_without_network():
    """Skip what is collected or run if the extra `network` is not installed."""
    try:
        check_network()
    except LumitreeError as error:
        pytest.skip(str(error), allow_module_level=True)


class JaxModule(pytest.Module):
    """A module of tests that cannot be imported without JAX."""

    def collect(self):
        skip_without_network()
        return super().collect()


def pytest_pycollect_makemodule(module_path, parent):
    if any(module_path.match(str(TESTS / pattern)) for pattern in JAX_TESTS):
        return JaxModule.from_parent(parent, path=module_path)
    return None


def pytest_collection_finish():
    """Leave modules and tests, of which there are many, out of later collections of garbage."""
    gc.freeze()


@pytest.fixture
def network_packages():
    """For single tests that need the extra `network`."""
    skip_without_network()


@pytest.fixture(scope="session", autouse=True)
def _default_signals():
    """A shell ignores SIGINT for what it runs in the background, and nohup SIGHUP."""
    for number in STOP_SIGNALS:
        handler = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
        signal.signal(number, handler)


@pytest.fixture(autouse=True)
def _no_progress(monkeypatch):
    """Progress is shown after some seconds, so what a test prints would depend on the machine."""
    monkeypatch.setattr(progress, "_QUIET_SECONDS", math.inf)


@pytest.fixture(scope="module", autouse=True)
def _no_scenes_of_other_modules():
    """Kernels contain the emitters and BSDFs of all scenes that exist."""
    gc.collect()


@pytest.fixture(scope="session")
def mi():
    """Mitsuba with the plugins registered."""
    from lumitree.core.backend import load_mitsuba
    from lumitree.rendering.register import register

    mitsuba = load_mitsuba(VARIANT)
    register()
    return mitsuba
