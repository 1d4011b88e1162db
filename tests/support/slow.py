"""Values of a test's parameters that are run with the slow tests only."""

from itertools import product

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


def slow_but_sets(quick, *values):
    """All combinations of values, of which only the quick sets are in the default suite."""
    sets = list(product(*values))
    unknown = [each for each in quick if each not in sets]
    assert not unknown, unknown
    return [each if each in quick else slow(*each) for each in sets]
