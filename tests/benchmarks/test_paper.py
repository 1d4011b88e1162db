"""The benchmark `paper`: its cells, its files, its time limit and its page."""

import dataclasses
import json
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.paper_tables import display_times, losses, step
from benchmarks.paper_tables.cells import Cell, Measured, Store
from benchmarks.paper_tables.found import Found
from benchmarks.paper_tables.page import all_cells, write_page
from benchmarks.paper_tables.running import Setting, run_cells
from benchmarks.paper_tables.scales import SCALES
from benchmarks.paper_tables.work import OutOfTimeError, Work, plain
from lumitree.core.interrupt import Interrupted
from lumitree.errors import LumitreeError
from lumitree.fit.network.config import PRESETS


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


@pytest.mark.parametrize("scale", ["paper", "cpu"])
def test_cells_measure_the_lamp_that_their_parameters_name(mi, scale):
    class AskedError(Exception):
        pass

    class Watch:
        def __init__(self):
            self.scale = SCALES[scale]

        def __getattr__(self, _):
            def ask(lamp, *_, **__):
                raise AskedError(lamp)

            return ask

    named = [each for each in all_cells(SCALES[scale]) if "lamp" in each.parameters]
    assert len({each.parameters["lamp"] for each in named}) == len(SCALES[scale].lamps)
    for each in named:
        with pytest.raises(AskedError) as asked:
            each.measure(Watch())
        assert asked.value.args[0] == each.parameters["lamp"]


def test_the_scale_of_the_paper_is_the_papers():
    scale = SCALES["paper"]
    assert scale.network == PRESETS["paper"]
    assert (scale.train.count, scale.train.resolution) == (100, 800)
    assert (scale.test.count, scale.network_depth, scale.samples_per_leaf) == (100, 10, 256)


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


def test_an_interrupt_is_one_line(setting):
    def run(name, setting):
        raise Interrupted

    with pytest.raises(LumitreeError, match="interrupted in a; the same command goes on"):
        run_cells([cell("a"), cell("b")], setting, run)
    assert setting.store.state(cell("a")) == "missing"


def test_no_cell_begins_after_the_time(setting, capsys):
    over = dataclasses.replace(setting, end=time.time() - 1)
    run_cells([cell("a")], over, lambda *_: pytest.fail("began"))
    assert "the time is spent" in capsys.readouterr().err


def test_training_stops_at_the_deadline_and_goes_on(tmp_path, monkeypatch):
    """Training is called with steps that fit, and what is done counts in the next call."""
    from lumitree.fit.network import train as training

    config = dataclasses.replace(SCALES["test"].network, num_steps=5000)
    done, asked = [0], []

    def train(dataset, run, config, resume, stop_after):
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
    again = Work(tmp_path, SCALES["test"]).run("bulbs", config)
    assert len(asked) == calls
    assert again == built
    other = dataclasses.replace(config, seed=1)
    assert Work(tmp_path, SCALES["test"])._at("x", {"c": other}) != Work(
        tmp_path, SCALES["test"]
    )._at("x", {"c": config})


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


def fake_method(deviation, shift=0.0, last=256):
    """A method of 1 s a sample; its image is 0.5 + shift, with noise of this deviation."""
    random = np.random.default_rng(int(1000 * deviation))

    def noisy(count, samples):
        noise = random.normal(0, deviation / samples**0.5, (count, 40, 40, 3))
        return 0.5 + shift + noise

    rungs = [
        {"samples": n, "images": noisy(1, n), "seconds": {"cpu": np.array([float(n)])}}
        for n in (1, 4, 16, 64)
    ]
    long = SimpleNamespace(
        batches=noisy(16, last / 16), seconds={"cpu": float(last)}, samples_per_pixel=last
    )
    return SimpleNamespace(rungs=rungs, long=long)


def test_an_explicit_lamp_that_does_not_converge_gives_lower_bounds():
    """Times to equal error are as variances: 100 times for `divided`; `proxy` has a bias."""
    methods = {
        "explicit": fake_method(1.0),
        "proxy": fake_method(0.1, shift=0.05),
        "divided": fake_method(0.1),
    }
    weights = np.ones((40, 40, 1))
    whole = display_times.readings(methods, (4.0, 8.0), weights, "explicit")
    assert whole["methods"]["divided"]["seconds"][0] is None
    found = display_times.readings(methods, (4.0, 8.0), weights, "divided")
    explicit, proxy = (found["methods"][name] for name in ("explicit", "proxy"))
    assert explicit["at_least"] == [True, False]
    assert explicit["seconds"][0] == 256
    # 0.05 of 0.5, exposed to 0.18 and encoded.
    assert proxy["bias"] == pytest.approx(5.3, rel=0.1)
    assert proxy["seconds"][0] is None
    bound, exact = (display_times.speedup_of(found["methods"], "divided", i) for i in (0, 1))
    assert exact == pytest.approx(100, rel=0.3)
    assert 20 < bound < 70


@pytest.mark.parametrize("scale", SCALES)
def test_arithmetic_of_a_step_is_that_of_its_weights(scale):
    import jax
    from flax import nnx

    from lumitree.fit.network.network import NerfSH

    config = SCALES[scale].network
    shapes = nnx.eval_shape(lambda: nnx.state(NerfSH(config, 0.1, nnx.Rngs(0))))
    weights = sum(leaf.size for leaf in jax.tree.leaves(shapes) if leaf.ndim == 2)
    positions = config.rays_per_batch * (2 * config.num_coarse + config.num_fine)
    assert step.flops(config) == 6 * weights * positions


def full_store(store, scale):
    """Records of all cells with invented values, and images of 8 x 8 pixels."""
    from lumitree.measure.metrics import METRICS

    metrics = dict.fromkeys(METRICS, 12.3456)
    methods = {
        name: {
            "bias": 1.5,
            "seconds": [s, s / 4, None],
            "samples": [8.0, 2.0, None],
            "at_least": [name == "explicit", False, False],
            "points": [],
        }
        for name, s in (("explicit", 100.0), ("proxy", 50.0), ("leaves", 10.0), ("divided", 4.0))
    }
    part = {"reference": 2.5, "floor": 5.0, "levels": [6.8, 12.0, 25.0], "methods": methods}
    step_values = {"seconds": 0.5, "flops": 1e10, "flops_per_second": 2e10, "layers_share": 0.5}
    step_values["networks_share"] = 0.75
    values = {
        1: {"network": metrics, "octree": metrics, "direct": metrics}
        | {
            f"{name}_{views}": metrics
            for name in ("octree", "direct")
            for views in ("few", "large")
        }
        | {"bytes": 2_000_000, "leaves": 1000, "costs": {"run": 60.0}, "peak_memory_bytes": 10**9},
        2: {"metrics": metrics, "opacity_rmse_geometric": 0.25},
        3: {"metrics": metrics, "bytes": 2_000_000, "leaves": 1000, "view_seconds": 0.5},
        4: {
            "network": metrics,
            "octree": metrics,
            "nanoseconds": {"linear": 77.0, "exponential": 80.0},
        },
        5: {
            "room": "cellar",
            "parts": {key: {"whole": part, "beside": part} for key in ("explicit", "divided")},
            "seconds_per_sample": {"explicit": 1.0, "proxy": 1.25, "leaves": 1.0, "divided": 0.5},
        },
        9: {"leaves": 1000},
        0: {"of this scale": step_values | {"peak_flops_per_second": 1e11}},
    }
    for each in all_cells(scale):
        found = values[each.table]
        work = SimpleNamespace(scale=scale)
        image = {"view": np.zeros((8, 8, 3), np.uint8)} if each.table == 2 else {}
        known = dataclasses.replace(each, measure=lambda _, v=found, i=image: Measured(v, i))
        store.measure(known, work, "python -m benchmarks paper")


def test_the_page_shows_the_papers_figures_ours_and_what_is_missing(mi, tmp_path):
    page, images = tmp_path / "docs" / "paper.md", tmp_path / "docs" / "images" / "paper"
    stores = {name: Store(tmp_path / "results", images, name) for name in ("cpu", "paper")}
    write_page(page, stores, tmp_path / "results")
    text = page.read_text()
    assert "| dallas | 31.51 | 0.937 | not measured yet |" in text
    assert "The paper's scale: not measured on GPU." in text
    assert "Measured by" not in text

    full_store(stores["cpu"], SCALES["cpu"])
    (tmp_path / "results" / "zhu.md").write_text("# Zhu\n\n| a |\n|---|\n| 10.96 |\n\nBeside it.\n")
    (tmp_path / "results" / "zhu.png").write_bytes(b"plot")
    write_page(page, stores, tmp_path / "results")
    text = page.read_text()
    assert (images / "zhu.png").read_bytes() == b"plot"
    # What remains are the results of `representations`.
    assert text.count("not measured yet") == 0
    assert "Not measured yet: `python -m benchmarks representations`" in text
    assert "| 10.96 |" in text
    assert "Beside it." not in text
    # Table 1, 2, 4, 5 and 8.
    assert "| dallas | 31.51 | 0.937 | 12.35 | 12.35 | 12.346 |" in text
    assert "| MSE | 19.85 | 0.699 | 0.362 | 12.35 |" in text
    assert "| portica | linear | 28.67 | 0.8594 | 3 | 12.35 ± 0.00 |" in text
    assert "96.2 | > 8, 100 | 8, 50 | > 2 | 8, 10 | > 10 | 8, 4 | > 25 |" in text
    assert "| +25% | -50% |" in text
    assert "* `python -m benchmarks paper`;" in text
    # Every image is there, and every title of a section differs from the others.
    for line in text.splitlines():
        if line.startswith("!["):
            assert (page.parent / line.rpartition("(")[2].rstrip(")")).is_file()
    assert (images / "cpu-page-ladder.jpg").is_file()
    headings = [line for line in text.splitlines() if line.startswith("#")]
    assert len(set(headings)) == len(headings)
    # A page is a function of the records alone.
    write_page(page, stores, tmp_path / "results")
    assert page.read_text() == text


def test_the_ablation_has_the_papers_rows_in_its_order():
    rows = [paper for _, _, paper in losses.VARIANTS.values() if paper is not None]
    assert rows == [(19.8547, 0.6987, 0.3617), (28.1237, 0.9062, 0.1853), (26.8784, 0.8829, 0.0358)]


def test_listing_measures_nothing(mi, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["paper", "--scale", "test", "--list", "-o", "out"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["cell", "state", "minutes"]
    assert len(lines) > 10
    assert all("missing" in line for line in lines[1:] if line)
    assert not list(tmp_path.iterdir())
    for argv, named in ((["--cell", "none", "step"], "none"), (["--table", "2", "6"], "6")):
        assert main(["paper", "--scale", "test", "--list", *argv]) == 2
        assert f"no cells of {named}; --list" in capsys.readouterr().err
    assert main(["paper", "--scale", "test", "--list", "--table", "2", "--cell", "2-mse"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines() if line] == [
        "cell",
        "2-mse",
    ]


def test_a_missing_value_says_why(tmp_path):
    for name, word in (("cpu", "yet"), ("paper", "GPU")):
        store = Store(tmp_path, tmp_path, name)
        assert Found(store, SCALES[name], Path("page.md")).number(None, 2).endswith(word)
