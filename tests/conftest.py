"""Fixtures that many tests share."""

import gc
import math
import signal

import pytest

from lumitree.core import progress


@pytest.fixture(scope="session", autouse=True)
def _default_signals():
    """A shell ignores SIGINT for what it runs in the background, and nohup SIGHUP."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


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
    """Mitsuba with the CPU variant and the plugins registered."""
    from lumitree.core.backend import load_mitsuba
    from lumitree.rendering.plugins import register

    mitsuba = load_mitsuba("llvm_ad_rgb")
    register()
    return mitsuba
