"""What this system says of itself."""

from pathlib import Path

from lumitree.core import system


def test_this_system_has_what_it_should():
    assert system.peak_memory_bytes() > 10_000_000
    assert system.longest_name(Path()) >= 143
    assert not system.is_read_only(Path())
    assert not system.is_closed_terminal(0)
