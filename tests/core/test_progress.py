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


def test_the_time_left_forgets_a_slow_beginning(monkeypatch):
    """The first unit takes 60 s, and each further one 1 s."""
    seen = []
    times = iter([0, 60, *range(61, 200), 200])
    monkeypatch.setattr(module.time, "monotonic", lambda: next(times))
    with module.reporting(seen.append), module.progress("bake", 200) as advance:
        for _ in range(140):
            advance(1)
    left = {report.done: report.seconds_left for report in seen[:-1]}
    assert left[1] == 199 * 60
    # Half of the time lies after the first unit.
    assert left[62] == 138
    assert left[140] == 60


def test_short_work_is_silent(monkeypatch, capsys):
    clock = itertools.count(0, 0.1)
    monkeypatch.setattr(module, "_QUIET_SECONDS", 2.0)
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with module.progress("bake", 2) as advance:
        advance(2)
    assert capsys.readouterr().err == ""


def test_a_task_within_another_reports_it(monkeypatch):
    seen = []
    with module.reporting(seen.append), module.progress("list", 2) as advance:
        for name in ("a", "b"):
            with module.progress(name, 1) as inner:
                inner(1)
            advance(1, f"{name} is done")
    inner = [report for report in seen if report.task != "list"]
    assert [(each.task, each.within.task, each.within.done) for each in inner] == [
        ("a", "list", 0), ("a", "list", 0), ("b", "list", 1), ("b", "list", 1),
    ]  # fmt: skip
    outer = [report for report in seen if report.task == "list"]
    assert [report.within for report in outer] == [None] * 3
    assert outer[-1].finished
    with module.reporting(seen.append), module.progress("later", 1):
        pass
    assert seen[-1].within is None


def test_a_terminal_has_a_bar_for_each_level(monkeypatch):
    monkeypatch.setattr(module, "_QUIET_SECONDS", 0.0)
    monkeypatch.setattr(module.sys.stderr, "isatty", lambda: True, raising=False)
    display, rows = module._Display(), []
    with module.reporting(display), module.progress("list", 2) as advance:
        for name in ("a", "b"):
            with module.progress(name, 1) as inner:
                inner(1)
                rows.append([task.description for task in display._bar.tasks])
            advance(1)
            rows.append([task.description for task in display._bar.tasks])
    assert rows == [["list", "a"], ["list"], ["list", "b"], ["list"]]
    assert display._bar is None


def test_lines_name_the_outer_task(monkeypatch, capsys):
    monkeypatch.setattr(module, "_QUIET_SECONDS", 2.0)
    clock = itertools.count(0, 10)
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with module.progress("3 lamps", 3, 1), module.progress("bake", 4) as advance:
        advance(4)
        advance(0, "told once")
    assert capsys.readouterr().err == "3 lamps, 1 done; bake: 100 %, 0 s left\n"
