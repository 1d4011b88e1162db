"""From a luminaire to a picture, end to end, as small as it can be."""

import json
import signal

import pytest

import lumitree
import tiny_bakes
from lumitree import demo
from lumitree.api import baking
from lumitree.core.images import read_exr
from lumitree.core.work_folder import WorkFolder
from lumitree.nerf.config import PRESETS

LAMP = """<scene version="3.0.0">
<shape type="sphere"><float name="radius" value="0.5"/>
<emitter type="area"><rgb name="radiance" value="3,2,1"/></emitter></shape>
<shape type="cube"><transform name="to_world"><scale x="1" y="0.1" z="0.1"/></transform>
<bsdf type="diffuse"/></shape></scene>"""


@pytest.fixture
def tiny(mi, monkeypatch):
    """A direct bake of seconds."""
    config = tiny_bakes.direct_config()
    monkeypatch.setattr("lumitree.direct.bake.QUALITIES", {"preview": config, "standard": config})
    return config


@pytest.fixture
def tiny_network(monkeypatch):
    """A network's bake of seconds: few views, a small network."""
    preset = tiny_bakes.network_preset()
    monkeypatch.setitem(PRESETS, "preview", preset.train)
    monkeypatch.setitem(baking.NETWORK_BAKES, "preview", preset)


def test_bake_evaluate_render(mi, tiny, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(LAMP)
    baked = lumitree.bake("lamp.xml", "lamp.lumitree")
    assert baked.asset.info.leaves > 50
    assert baked.asset.tree_depth == 5
    assert tiny_bakes.RAYS <= baked.rays < tiny_bakes.RAYS + 6 * (1 << 14)
    assert set(baked.seconds) == {"bake"}
    assert not (tmp_path / "lamp.work").exists()
    json.dumps(baked.to_json(), allow_nan=False)
    report = lumitree.evaluate(
        "lamp.lumitree", "lamp.xml", "sheet.png", num_views=3, resolution=48, samples_per_pixel=64
    )
    metrics = report.metrics
    assert metrics["psnr_linear"] > metrics["psnr_linear_black"] + 6
    assert metrics["opacity_rmse"] < 0.2
    assert metrics["flux_error"] < 0.2
    assert (tmp_path / "sheet.png").stat().st_size > 10_000
    json.dumps(report.to_json(), allow_nan=False)


def test_network_bake_evaluate(mi, tiny_network, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(LAMP)
    baked = lumitree.bake_network("lamp.xml", "lamp.lumitree")
    assert baked.asset.info.leaves > 50
    assert set(baked.seconds) == {"capture", "train", "extract"}
    assert not (tmp_path / "lamp.work").exists()
    metrics = lumitree.evaluate(
        "lamp.lumitree", "lamp.xml", num_views=3, resolution=48, samples_per_pixel=64
    ).metrics
    assert metrics["psnr_linear"] > metrics["psnr_linear_black"] + 6


def test_an_interrupted_bake_keeps_its_best_and_continues(mi, tiny, tmp_path, monkeypatch):
    from lumitree.asset.file import load
    from lumitree.direct.refine import Refiner

    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(LAMP)
    advance, steps = Refiner.advance, []

    def interrupt(self, progress):
        steps.append(self.step + 1)
        if len(steps) == 3:
            signal.raise_signal(signal.SIGINT)
        return advance(self, progress)

    monkeypatch.setattr(Refiner, "advance", interrupt)
    stopped = lumitree.bake("lamp.xml", "lamp.lumitree")
    assert stopped.stopped_by == signal.SIGINT
    assert steps == [1, 2, 3]
    assert load("lamp.lumitree").num_leaves > 50
    assert (tmp_path / "lamp.work").exists()
    report = lumitree.bake("lamp.xml", "lamp.lumitree")
    assert steps == list(range(1, len(steps) + 1))
    assert report.rays >= tiny_bakes.RAYS
    assert not (tmp_path / "lamp.work").exists()


def test_an_interrupted_network_bake_continues(mi, tiny_network, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(LAMP)

    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("lumitree.octree.extract.extract", interrupt)
        with pytest.raises(KeyboardInterrupt):
            lumitree.bake_network("lamp.xml", "lamp.lumitree")
    assert not (tmp_path / "lamp.lumitree").exists()
    views = tmp_path / "lamp.work" / "dataset" / "view_000001.exr"
    before = views.stat().st_mtime_ns
    with monkeypatch.context() as patch:
        patch.setattr(WorkFolder, "remove", lambda *_: None)
        report = lumitree.bake_network("lamp.xml", "lamp.lumitree")
    assert (tmp_path / "lamp.lumitree").exists()
    assert views.stat().st_mtime_ns == before
    assert report.seconds["train"] < 20


def test_demo(mi, tiny, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(LAMP)
    monkeypatch.setattr(demo, "LUMINAIRE", "lamp.xml")
    monkeypatch.setattr(demo, "BAKE_SECONDS", 2)
    monkeypatch.setattr(demo, "WIDTH", 40)
    monkeypatch.setattr(demo, "SAMPLES", 8)
    monkeypatch.setattr(demo, "REFERENCE_SAMPLES", 32)
    demo.run("out")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert set(report["evaluate"]) >= {"metrics", "views", "seconds", "asset"}
    stages = {"bake", "evaluate", "room baked", "room explicit", "room reference", "total"}
    assert stages <= set(report["seconds"])
    # What is asked for is the budget of the whole bake.
    assert 2 <= report["seconds"]["bake"] < 30
    assert report["peak_memory_bytes"] > 1e8
    assert (tmp_path / "out" / "lamp.lumitree").exists()
    for name in ("evaluation", "comparison"):
        assert (tmp_path / "out" / f"{name}.png").stat().st_size > 10_000
    for name in ("baked", "explicit", "reference"):
        image = read_exr(tmp_path / "out" / f"room-{name}.exr")["RGB"]
        assert image.shape == (30, 40, 3)
        assert image.max() > 0.4
