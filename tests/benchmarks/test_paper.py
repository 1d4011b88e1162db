"""The benchmark `paper`: its cells, its files, its time limit and its page."""

import dataclasses
import json
import shutil
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.paper import SHOWN, Setting, run_cells
from benchmarks.paper_tables import methods as display_times
from benchmarks.paper_tables.cells import Cell, Measured, Store
from benchmarks.paper_tables.page import all_cells, write_page
from benchmarks.paper_tables.scales import SCALES
from benchmarks.paper_tables.work import OutOfTimeError, Work, plain
from lumitree.errors import LumitreeError

ROOT = Path(__file__).parents[2]


@pytest.fixture
def setting(tmp_path):
    return Setting(
        "test", tmp_path / "results", tmp_path / "images", tmp_path, tmp_path, None, "run", None
    )


def cell(name, parameters=(1, 2.5), measure=lambda work: Measured({"x": 1})):
    return Cell(name, 1, {"p": parameters}, 1.0, measure)


def runner(setting, cells):
    """Measures cells in this process; returns the function and the names it was called with."""
    called = []

    def run(name, setting):
        called.append(name)
        work = Work(setting.work, SCALES["test"])
        setting.store.measure(next(each for each in cells if each.name == name), work, "command")
        return True

    return run, called


@pytest.mark.parametrize("scale", SCALES)
def test_cells_have_names_of_their_own_and_parameters_that_json_holds(scale):
    cells = all_cells(SCALES[scale])
    assert len({each.name for each in cells}) == len(cells)
    for each in cells:
        assert json.loads(json.dumps(plain(each.parameters))) == plain(each.parameters)
        if scale == "cpu":
            assert each.minutes <= 30


def test_a_cell_is_measured_once(mi, setting):
    cells = [cell("a"), cell("b")]
    run, called = runner(setting, cells)
    assert [setting.store.state(each) for each in cells] == ["missing", "missing"]
    run_cells(cells, setting, run)
    assert called == ["a", "b"]
    assert [setting.store.state(each) for each in cells] == ["done", "done"]
    run_cells(cells, setting, run)
    assert called == ["a", "b"]
    # Other parameters: it is measured again.
    cells[1] = cell("b", (1, 3))
    assert setting.store.state(cells[1]) == "outdated"
    run_cells(cells, setting, runner(setting, cells)[0])
    assert setting.store.state(cells[1]) == "done"
    record = setting.store.record("b")
    assert record["values"] == {"x": 1}
    assert record["setting"]["command"] == "command"
    for key in ("commit", "device", "accelerator", "scale", "mitsuba", "jax"):
        assert record["setting"][key]
    assert record["peak_memory_bytes"] > 0
    assert record["seconds"] >= 0


def test_what_fails_leaves_no_file_and_does_not_stop_the_others(mi, setting, capsys):
    def fail(work):
        raise LumitreeError("no room")

    cells = [cell("a", measure=fail), cell("b")]
    with pytest.raises(LumitreeError, match="1 cells were not measured: a: no room"):
        run_cells(cells, setting, runner(setting, cells)[0])
    assert [path.name for path in setting.store.folder.iterdir()] == ["b.json"]


def test_training_stops_at_the_deadline_and_goes_on(tmp_path, monkeypatch):
    """Training is called with steps that fit, and what is done counts in the next call."""
    from lumitree.fit.network import train as training

    config = dataclasses.replace(SCALES["test"].network, num_steps=5000)
    done, asked = [0], []

    def train(dataset, run, config, seed, resume, stop_after):
        assert resume == bool(done[0])
        run.mkdir(exist_ok=True)
        asked.append(stop_after)
        done[0] = min(config.num_steps, done[0] + stop_after)
        time.sleep(0.01)
        return SimpleNamespace(steps=done[0], seconds=1.0, rays_per_second=2.0, stopped_by=None)

    monkeypatch.setattr(training, "train", train)
    views = SimpleNamespace(path=tmp_path)
    monkeypatch.setattr(Work, "views", lambda *_: views)
    with pytest.raises(OutOfTimeError):
        Work(tmp_path, SCALES["test"], deadline=time.monotonic()).run("bulbs", config)
    assert done[0] == asked[0] < config.num_steps
    built = Work(tmp_path, SCALES["test"]).run("bulbs", config)
    assert done[0] == config.num_steps
    assert built.seconds > 0
    assert built.details["train_seconds"] == 1.0
    calls = len(asked)
    assert Work(tmp_path, SCALES["test"]).run("bulbs", config) == built
    assert len(asked) == calls


@pytest.mark.parametrize(("bias", "noise"), [(0.0, 2.0), (3.0, 2.0)])
def test_times_beyond_the_ladder_know_the_bias(bias, noise):
    """Errors of √(bias² + noise² · 100 s / time), measured up to 100 s."""

    def error(seconds):
        return float(np.sqrt(bias**2 + noise**2 * 100 / seconds))

    points = [{"seconds": t, "rmse": error(t)} for t in (1.0, 2, 4, 8, 16, 32, 64, 100)]
    for level in (error(10.0), error(400.0), error(4000.0)):
        exact = 100 * noise**2 / (level**2 - bias**2)
        found = display_times.seconds_at(level, points, bias, 0.0, 100.0, noise)
        assert found == pytest.approx(exact, rel=0.05)
    if bias:
        assert display_times.seconds_at(2.9, points, bias, 0.0, 100.0, noise) is None
    assert display_times.seconds_at(0.5, points, bias, 0.6, 100.0, noise) is None


def test_the_page_shows_the_records(mi, tmp_path):
    page, images = tmp_path / "paper.md", tmp_path / "paper" / "images"
    results = ROOT / "benchmarks" / "results"
    shutil.copytree(results / "paper" / "images", images)
    write_page(page, {name: Store(results, images, name) for name in SHOWN})
    assert page.read_text() == (results / "paper.md").read_text()
