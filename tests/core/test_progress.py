"""Progress without a terminal."""

import itertools

from lumitree.core import progress as module


def test_plain_lines_with_time_left(monkeypatch, capsys):
    monkeypatch.setattr(module, "_QUIET_SECONDS", 2.0)
    clock = itertools.count(0, 10)
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with module.progress("bake", 4) as advance:
        for _ in range(4):
            advance(1, "note")
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "bake: 50 %, 20 s left, note"
    assert lines[-1] == "bake: 100 %, 0 s left, note"


def test_short_work_is_silent(monkeypatch, capsys):
    clock = itertools.count(0, 0.1)
    monkeypatch.setattr(module, "_QUIET_SECONDS", 2.0)
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with module.progress("bake", 2) as advance:
        advance(2)
    assert capsys.readouterr().err == ""
