"""Fixtures of the octree fit's tests."""

import pytest

from support.lamps import lamp_of


@pytest.fixture
def lamp(mi, tmp_path_factory):
    """Loads a luminaire of the given shapes (texts of scene elements)."""
    return lambda *shapes: lamp_of(tmp_path_factory.mktemp("lamp"), *shapes)
