"""Fixtures of the direct bake's tests."""

import itertools

import pytest

from lamps import scene


@pytest.fixture
def lamp(mi, tmp_path):
    """Loads a luminaire of the given shapes (texts of scene elements)."""
    from lumitree.luminaire.luminaire import load_luminaire

    numbers = itertools.count()

    def load(*shapes):
        path = tmp_path / f"lamp{next(numbers)}.xml"
        path.write_text(scene(*shapes))
        return load_luminaire(path)

    return load


@pytest.fixture
def small_batches(mi, monkeypatch):
    """Everything in a bake but its own settings takes few rays, so that it takes seconds."""
    few = {
        "bake._ESTIMATE_DEPTH": 4,
        "estimate._START_LEVEL": 3,
        "estimate._BATCH": 1 << 15,
        "balance._LINES": 1 << 12,
        "balance._TOTAL_LINES": 1 << 14,
        "heldout._NUM_LINES": 1 << 12,
        "refine._BLAME_LINES": 1 << 12,
    }
    for name, value in few.items():
        monkeypatch.setattr(f"lumitree.direct.{name}", value)
