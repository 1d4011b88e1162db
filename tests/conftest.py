"""Fixtures that many tests share."""

import pytest


@pytest.fixture(scope="session")
def mi():
    """Mitsuba with the CPU variant and the plugins registered."""
    from lumitree.core.backend import load_mitsuba
    from lumitree.render.plugins import register

    mitsuba = load_mitsuba("llvm_ad_rgb")
    register()
    return mitsuba
