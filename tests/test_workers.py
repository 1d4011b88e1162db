"""Jobs whose tasks an executor runs: what they give is what one process gives."""

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.core.backend import num_cores
from lumitree.core.executor import process_pool
from lumitree.core.images import read_exr
from lumitree.errors import LumitreeError
from lumitree.fit.light_field import bake as light_field_bake
from lumitree.lamp import luminaire as sent
from lumitree.rendering import passes, render_job
from lumitree.trace import cameras as views
from support import executors
from support.executors import LastFirst
from support.lamps import room
from support.variant import VARIANT

LAMP = (
    '<scene version="3.0.0"><shape type="sphere"><emitter type="area">'
    '<rgb name="radiance" value="3,2,1"/></emitter></shape><shape type="cube"><transform '
    'name="to_world"><scale x="1.5" y="0.1" z="0.1"/></transform></shape></scene>'
)
SKY = '<emitter type="constant"><rgb name="radiance" value="0.5,0.5,0.5"/></emitter>'
ROOM = room(16, 12, SKY)
# Pixels of the room, and samples per pixel of a pass.
PIXELS, SAMPLES = 16 * 12, 4
CAPTURE: dict[str, Any] = {"views": 5, "resolution": 8, "spp": 4}
PATHS = 1 << 14


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, mi):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(LAMP)
    (tmp_path / "room.xml").write_text(ROOM)
    monkeypatch.setattr(
        passes, "_SAMPLES_PER_PASS", dict.fromkeys(passes._SAMPLES_PER_PASS, SAMPLES * PIXELS)
    )
    return tmp_path


@pytest.fixture(scope="module", autouse=True)
def _no_scenes_of_tasks():
    """Tasks in this process keep their scenes."""
    yield
    for cache in (
        sent.received_luminaire, render_job._received, views._camera, light_field_bake._rays,
    ):  # fmt: skip
        cache.cache_clear()


@pytest.fixture(scope="module")
def pool():
    with process_pool(2) as executor:
        yield executor


def bake_config(**options):
    """Settings of a light field of five batches."""
    light_field = lumitree.LightFieldConfig(paths=5 * PATHS, batch=PATHS, depth=3, resolution=16)
    return lumitree.BakeConfig(parts=("light",), light=light_field, irradiance_paths=0, **options)


def captured(name, executor=None, **options):
    """The channels of all views of a capture."""
    lumitree.capture("lamp.xml", name, **(CAPTURE | options), executor=executor, variant=VARIANT)
    return {path.name: read_exr(path) for path in sorted(Path(name).glob("*.exr"))}


def assert_equal_views(found, expected):
    assert list(found) == list(expected)
    for name, channels in expected.items():
        for channel, pixels in channels.items():
            assert np.array_equal(found[name][channel], pixels), (name, channel)


def rendered(executor=None, **options):
    return lumitree.render("room.xml", executor=executor, variant=VARIANT, **options)


def assert_equal_images(found, expected):
    """But for rounding: Mitsuba adds up the samples of a pass in no fixed order."""
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-6)


@pytest.mark.slow
def test_views_are_those_of_one_process(pool):
    expected = captured("alone")
    executor = LastFirst()
    assert_equal_views(captured("shared", executor), expected)
    assert len(executor.order) == CAPTURE["views"]
    assert_equal_views(captured("pool", pool), expected)


def test_workers_share_the_cores(pool):
    assert pool.submit(executors.num_threads).result() == max(1, num_cores() // 2)


@pytest.mark.slow
def test_images_are_those_of_one_process(pool):
    expected = rendered(spp=18, seed=3)
    for executor in (LastFirst(), pool):
        found = rendered(executor, spp=18, seed=3)
        assert_equal_images(found.pixels, expected.pixels)
        assert found.spp == 18
        assert found.noise == pytest.approx(expected.noise, rel=1e-4)
        assert found.settings == expected.settings or "noise" in found.settings


def test_images_until_a_noise_have_as_many_samples_as_those_of_one_process():
    expected = rendered(noise=0.1)
    assert 8 * SAMPLES <= expected.spp < 1 << 14
    found = rendered(LastFirst(), noise=0.1)
    assert found.spp == expected.spp
    assert_equal_images(found.pixels, expected.pixels)


@pytest.mark.slow
def test_layers_are_those_of_one_process():
    lumitree.bake("lamp.xml", "lamp.lumitree", bake_config(), variant=VARIANT)
    placements = [lumitree.Placement("lamp.lumitree", at=(0, 1, 0), size=1)]
    options = {"layers": True, "aov": True, "spp": 10, "placements": placements}
    expected, found = rendered(**options), rendered(LastFirst(), **options)
    assert list(found.layers) == list(expected.layers) == ["room", "lamp"]
    for name, layer in expected.layers.items():
        assert_equal_images(found.layers[name], layer)
    assert_equal_images(found.albedo, expected.albedo)
    assert_equal_images(found.normals, expected.normals)


def test_a_changed_scene_is_read_again():
    executor = LastFirst()
    before = rendered(executor, spp=4)
    Path("room.xml").write_text(ROOM.replace("0.5,0.5,0.5", "1,1,1"))
    after = rendered(executor, spp=4)
    assert after.pixels.mean() == pytest.approx(2 * before.pixels.mean(), rel=0.01)


def test_assets_have_the_bytes_of_those_of_one_process(folder, pool):
    lumitree.bake("lamp.xml", "alone.lumitree", bake_config(seed=4), variant=VARIANT)
    expected = (folder / "alone.lumitree").read_bytes()
    lumitree.bake("lamp.xml", "pool.lumitree", bake_config(seed=4), executor=pool, variant=VARIANT)
    assert (folder / "pool.lumitree").read_bytes() == expected


def test_what_cannot_be_sent_is_refused_before_any_work(mi, folder):
    executor = LastFirst()
    lamp = lumitree.load_luminaire("lamp.xml", variant=VARIANT)
    loaded = "is loaded already, and cannot be sent to other processes; give its name, its path"
    with pytest.raises(LumitreeError, match=loaded):
        lumitree.bake(lamp, "a.lumitree", bake_config(), executor=executor)
    with pytest.raises(LumitreeError, match=loaded):
        lumitree.capture(lamp, "views", **CAPTURE, executor=executor)
    with pytest.raises(LumitreeError, match=loaded):
        lumitree.render("room.xml", [lumitree.Placement(lamp)], executor=executor)
    scene = mi.load_file("room.xml")
    message = r"^the scene cannot be sent to other processes \(.*\); give its path, or a dictionary"
    with pytest.raises(LumitreeError, match=message):
        lumitree.render(scene, executor=executor)
    with pytest.raises(LumitreeError, match=message):
        lumitree.render({"type": "scene", "scene": scene}, executor=executor)
    with pytest.raises(LumitreeError, match="cannot be sent to other processes"):
        lumitree.capture(mi.load_file("lamp.xml"), "views", **CAPTURE, executor=executor)
    two: Any = "two"
    for call in (
        lambda: lumitree.bake("lamp.xml", executor=two),
        lambda: lumitree.capture("lamp.xml", "views", executor=two),
        lambda: lumitree.render("room.xml", executor=two),
    ):
        with pytest.raises(LumitreeError, match=r"^executor is a builtins\.str; expected a"):
            call()
    assert executor.order == []


def test_a_luminaire_that_differs_is_refused(folder, monkeypatch):
    executor = LastFirst()
    submit, other = executor.submit, [LAMP.replace("3,2,1", "1,2,3")]

    def change(*args):
        if other:
            (folder / "lamp.xml").write_text(other.pop())
        return submit(*args)

    monkeypatch.setattr(executor, "submit", change)
    with pytest.raises(LumitreeError, match="differs between a worker and the process that sent"):
        captured("views", executor)


@pytest.fixture
def shared_by(monkeypatch):
    """An executor in place of the executors that the options name."""
    executor, asked = LastFirst(), []

    @contextlib.contextmanager
    def given(value):
        asked.append(value)
        yield executor

    monkeypatch.setattr("lumitree.core.executor.process_pool", given)
    monkeypatch.setattr("lumitree.core.executor.dask_executor", given)
    return executor, asked


@pytest.mark.parametrize(
    ("command", "option", "value"),
    [
        (
            "capture lamp.xml -o views --views 2 --resolution 8 --spp 4",
            ("--scheduler", "tcp://a:1"),
            "tcp://a:1",
        ),
        ("render room.xml -o room.exr --spp 8", ("--workers", "2"), 2),
        ("bake lamp.xml -o lamp.lumitree", ("--workers", "2"), 2),
    ],
    ids=lambda value: str(value).partition(" ")[0],
)
def test_commands_have_options_for_workers(command, option, value, shared_by, monkeypatch, capsys):
    monkeypatch.setattr(lumitree.BakeConfig, "of", staticmethod(lambda *_: bake_config()))
    executor, asked = shared_by
    assert main([*command.split(), *option]) == 0, capsys.readouterr().err
    assert len(executor.order) >= 2
    assert asked == [value]
