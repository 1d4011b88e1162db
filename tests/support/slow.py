"""Values of a test's parameters that are run with the slow tests only."""

import pytest


def slow(*values):
    """One set of values."""
    return pytest.param(*values, marks=pytest.mark.slow)


def slow_but(quick, names):
    """All names, of which only the quick ones are in the default suite."""
    names = list(names)
    unknown = set(quick) - set(names)
    assert not unknown, unknown
    return [name if name in quick else slow(name) for name in names]
