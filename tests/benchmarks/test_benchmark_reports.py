"""Tables, result files and timing, which all benchmarks share."""

import argparse
import itertools
import json
import types

import pytest

from benchmarks.common import timing
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import interleaved, ratios
from lumitree.errors import LumitreeError


def test_tables_in_markdown():
    table = Table(["lamp", "s", "leaves"], [["star", "1", "2,000"], ["bulbs", "20", ""]])
    assert table.markdown() == (
        "| lamp | s | leaves |\n|---|---:|---:|\n| star | 1 | 2,000 |\n| bulbs | 20 |  |\n"
    )


def test_tables_for_the_terminal_are_aligned():
    table = Table(["lamp", "room", "s"], [["star", "hall", "1"], ["bulbs", "x", "200"]], left=2)
    assert table.text().splitlines() == [
        "lamp   room    s",
        "star   hall    1",
        "bulbs  x     200",
    ]


def test_tables_refuse_rows_of_another_length():
    with pytest.raises(ValueError, match="2 cells under 1 heads"):
        Table(["lamp"], [["star", "1"]])


@pytest.fixture
def options(tmp_path):
    return argparse.Namespace(
        benchmark="query", output=tmp_path / "new" / "results", command="python -m benchmarks query"
    )


def test_results_are_written_and_read(mi, options):
    results = Results(options, rays=7)
    assert results.stored([]) == []
    results.write({"setting": results.setting(), "rows": [1, 2]}, "# A query\n")
    stored = Results(options).stored([])
    assert stored["rows"] == [1, 2]
    assert stored["setting"]["rays"] == 7
    assert (options.output / "query.md").read_text() == "# A query\n"
    assert "* rays: 7\n" in notes(stored["setting"])
    # No temporary files are left.
    assert {each.name for each in options.output.iterdir()} == {"query.json", "query.md"}


def test_a_failed_write_keeps_earlier_results(mi, options):
    results = Results(options)
    results.write({"rows": [1]})
    with pytest.raises(LumitreeError, match="not JSON compliant"):
        results.write({"rows": [float("nan")]})
    assert json.loads(results.json_path.read_text()) == {"rows": [1]}
    assert {each.name for each in options.output.iterdir()} == {"query.json"}


def test_jobs_take_turns_and_medians_leave_out_preparation(monkeypatch):
    now = [0.0]
    clock = types.SimpleNamespace(perf_counter=lambda: now[0], process_time=lambda: 2 * now[0])
    monkeypatch.setattr(timing, "time", clock)
    calls = []

    def job(name, durations):
        def prepare(index):
            now[0] += 1000  # is not timed

            def run():
                calls.append((name, index))
                now[0] += next(durations)

            return run

        return prepare

    def jobs():
        # Round 0 compiles: its time counts neither in the median nor in the number of rounds.
        slow = itertools.chain([500], [8, 2, 4, 90, 4])
        return {"slow": job("slow", slow), "fast": job("fast", itertools.repeat(2))}

    assert interleaved(jobs(), 5) == {"slow": 4, "fast": 2}
    assert calls == [(name, index) for index in range(6) for name in ("slow", "fast")]
    assert interleaved(jobs(), 5, "cpu") == {"slow": 8, "fast": 4}
    with pytest.raises(ValueError, match="4 rounds"):
        interleaved(jobs(), 4)


def test_ratios_are_against_the_baseline():
    assert ratios({"plain": 2.0, "lamp": 5.0}, "plain") == {"plain": 1.0, "lamp": 2.5}
