"""Fixtures of the octree fit's tests."""

import itertools

import pytest

from support.lamps import scene


@pytest.fixture
def lamp(mi, tmp_path):
    """Loads a luminaire of the given shapes (texts of scene elements)."""
    from lumitree.lamp.luminaire import load_luminaire

    numbers = itertools.count()

    def load(*shapes):
        path = tmp_path / f"lamp{next(numbers)}.xml"
        path.write_text(scene(*shapes))
        return load_luminaire(path)

    return load
