"""Fixtures that many tests share."""

import math

import pytest

from lumitree.core import progress


@pytest.fixture(autouse=True)
def _no_progress(monkeypatch):
    """Progress is shown after some seconds, so what a test prints would depend on the machine."""
    monkeypatch.setattr(progress, "_QUIET_SECONDS", math.inf)


@pytest.fixture(scope="session")
def mi():
    """Mitsuba with the CPU variant and the plugins registered."""
    from lumitree.core.backend import load_mitsuba
    from lumitree.rendering.plugins import register

    mitsuba = load_mitsuba("llvm_ad_rgb")
    register()
    return mitsuba
