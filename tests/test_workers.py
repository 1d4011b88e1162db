"""Jobs whose tasks an executor runs: what they give is what one process gives."""

import contextlib
import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.core.dask_executor import dask_executor
from lumitree.core.images import read_exr
from lumitree.core.process_pool import process_pool
from lumitree.core.system import num_cores
from lumitree.errors import LumitreeError
from lumitree.fit.config import QUALITIES
from lumitree.fit.light_field import batches
from lumitree.lamp import sent
from lumitree.rendering import passes, render_job
from lumitree.trace import capture as views
from support import executors
from support.executors import LastFirst
from support.variant import VARIANT

LAMP = (
    '<scene version="3.0.0"><shape type="sphere"><emitter type="area">'
    '<rgb name="radiance" value="3,2,1"/></emitter></shape><shape type="cube"><transform '
    'name="to_world"><scale x="1.5" y="0.1" z="0.1"/></transform></shape></scene>'
)
ROOM = (
    '<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="3"/>'
    '</integrator><sensor type="perspective"><transform name="to_world">'
    '<lookat origin="0,1,6" target="0,0.5,0" up="0,1,0"/></transform>'
    '<film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="12"/>'
    '</film></sensor><shape type="rectangle"><transform name="to_world">'
    '<rotate x="1" angle="-90"/><scale value="4"/></transform></shape>'
    '<emitter type="constant"><rgb name="radiance" value="0.5,0.5,0.5"/></emitter></scene>'
)
# Pixels of the room, and samples per pixel of a pass.
PIXELS, SAMPLES = 16 * 12, 4
CAPTURE = {"num_views": 5, "resolution": 8, "samples_per_pixel": 4}
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
        sent.received_luminaire, render_job._received, views._camera, batches._rays,
    ):  # fmt: skip
        cache.cache_clear()


@pytest.fixture(scope="module")
def pool():
    with process_pool(2) as executor:
        yield executor


def bake_config(**options):
    """Settings of a light field of five batches."""
    light_field = lumitree.LightFieldConfig(paths=5 * PATHS, batch=PATHS, depth=3, resolution=16)
    return lumitree.BakeConfig(
        parts=("light",), light_field=light_field, irradiance_paths=0, **options
    )


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
    assert len(executor.order) == CAPTURE["num_views"]
    assert_equal_views(captured("pool", pool), expected)


def test_workers_share_the_cores(pool):
    assert pool.submit(executors.num_threads).result() == max(1, num_cores() // 2)


def test_a_capture_whose_worker_is_killed_is_finished_by_the_same_call(pool):
    expected = captured("alone")
    with process_pool(1) as executor:
        worker = executor.submit(os.getpid).result()

        def kill_after_two(state):
            if state.done == 2 and not state.finished:
                os.kill(worker, signal.SIGKILL)

        # The next view may be finished too.
        message = (
            r"^a worker ended unexpectedly, perhaps for lack of memory; [23] of 5 views are "
            r"finished; the same command continues$"
        )
        with pytest.raises(LumitreeError, match=message) as raised:
            lumitree.capture(
                "lamp.xml", "shared", **CAPTURE, executor=executor, progress=kill_after_two
            )
    written = len(list(Path("shared").glob("*.exr")))
    assert f"; {written} of 5 views" in str(raised.value)
    assert_equal_views(captured("shared", pool), expected)


def test_images_are_those_of_one_process(pool):
    expected = rendered(samples_per_pixel=18, seed=3)
    for executor in (LastFirst(), pool):
        found = rendered(executor, samples_per_pixel=18, seed=3)
        assert_equal_images(found.pixels, expected.pixels)
        assert found.samples_per_pixel == 18
        assert found.noise == pytest.approx(expected.noise, rel=1e-4)
        assert found.settings == expected.settings or "noise" in found.settings


def test_images_until_a_noise_have_as_many_samples_as_those_of_one_process():
    expected = rendered(noise=0.1)
    assert 8 * SAMPLES <= expected.samples_per_pixel < 1 << 14
    found = rendered(LastFirst(), noise=0.1)
    assert found.samples_per_pixel == expected.samples_per_pixel
    assert_equal_images(found.pixels, expected.pixels)


def test_images_until_a_time_end(monkeypatch):
    executor = LastFirst()
    found = rendered(executor, time=1e-3)
    assert found.samples_per_pixel == SAMPLES
    # Passes are begun ahead, and those that are not needed are cancelled.
    assert len(executor.order) <= 2 * executor._max_workers
    found = rendered(LastFirst(), time=1.0)
    assert found.samples_per_pixel >= SAMPLES
    assert found.samples_per_pixel % SAMPLES == 0
    assert found.pixels.mean() == pytest.approx(
        rendered(samples_per_pixel=64).pixels.mean(), rel=0.1
    )


def test_a_slow_first_pass_does_not_end_an_image_of_workers(mi, monkeypatch):
    """It contains the start of the workers."""
    now = [0.0]
    monkeypatch.setattr(passes.time, "perf_counter", lambda: now[0])
    plan = passes._Plan(passes.Budget(seconds=20.0), PIXELS, 0)
    begun = iter(plan)
    for _ in range(3):
        next(begun)
    now[0] = 15.0
    plan.finish()
    assert not plan.is_over
    assert plan.seconds == 15
    assert next(begun)[1] == plan.next_samples == SAMPLES


@pytest.mark.slow
def test_layers_are_those_of_one_process():
    lumitree.bake("lamp.xml", "lamp.lumitree", bake_config(), variant=VARIANT)
    placements = [lumitree.Placement("lamp.lumitree", at=(0, 1, 0), size=1)]
    options = {"layers": True, "aov": True, "samples_per_pixel": 10, "placements": placements}
    expected, found = rendered(**options), rendered(LastFirst(), **options)
    assert list(found.layers) == list(expected.layers) == ["room", "lamp"]
    for name, layer in expected.layers.items():
        assert_equal_images(found.layers[name], layer)
    assert_equal_images(found.albedo, expected.albedo)
    assert_equal_images(found.normals, expected.normals)


@pytest.mark.slow
def test_a_dictionary_with_an_asset_is_rendered_by_workers(mi):
    asset = lumitree.bake("lamp.xml", config=bake_config(), variant=VARIANT).asset
    room = {
        "type": "scene",
        "integrator": {"type": "lumitree_path", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "film": {"type": "hdrfilm", "width": 16, "height": 12},
            "to_world": mi.ScalarTransform4f().look_at([0, 1, 6], [0, 0.5, 0], [0, 1, 0]),
        },
        "floor": {
            "type": "rectangle",
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.4, 0.3]}},
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(4),
        },
    }
    placements = [lumitree.Placement(asset, at=(0, 1, 0), size=1)]
    options = {"samples_per_pixel": 8, "variant": VARIANT}
    expected = lumitree.render(room, placements, **options)
    found = lumitree.render(room, placements, **options, executor=LastFirst())
    assert expected.pixels.mean() > 0
    assert_equal_images(found.pixels, expected.pixels)


def test_a_changed_scene_is_read_again():
    executor = LastFirst()
    before = rendered(executor, samples_per_pixel=4)
    Path("room.xml").write_text(ROOM.replace("0.5,0.5,0.5", "1,1,1"))
    after = rendered(executor, samples_per_pixel=4)
    assert after.pixels.mean() == pytest.approx(2 * before.pixels.mean(), rel=0.01)


def test_assets_have_the_bytes_of_those_of_one_process(folder, pool):
    lumitree.bake("lamp.xml", "alone.lumitree", bake_config(seed=4), variant=VARIANT)
    expected = (folder / "alone.lumitree").read_bytes()
    for name, executor in (("last", LastFirst()), ("pool", pool)):
        lumitree.bake(
            "lamp.xml", f"{name}.lumitree", bake_config(seed=4), executor=executor, variant=VARIANT
        )
        assert (folder / f"{name}.lumitree").read_bytes() == expected


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_assets_of_the_workers_of_dask_have_the_same_bytes(folder):
    distributed = pytest.importorskip(
        "distributed", reason="the optional dependency cluster is not installed"
    )
    lumitree.bake("lamp.xml", "alone.lumitree", bake_config(), variant=VARIANT)
    with (
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=False,
            protocol="tcp://",
            dashboard_address=":0",
        ) as cluster,
        dask_executor(cluster.scheduler_address) as executor,
    ):
        lumitree.bake(
            "lamp.xml", "dask.lumitree", bake_config(), executor=executor, variant=VARIANT
        )
    assert (folder / "dask.lumitree").read_bytes() == (folder / "alone.lumitree").read_bytes()


def test_the_network_gets_light_paths_and_views_of_workers(network_packages, monkeypatch):
    from lumitree.fit import bake_network

    class Trained(Exception):  # noqa: N818
        """What follows is not shared."""

    def stop(*_):
        raise Trained

    monkeypatch.setattr(bake_network, "_train", stop)
    executor, light_field = LastFirst(), bake_config().light_field
    config = lumitree.NetworkConfig(num_views=3, resolution=8, light_field=light_field)
    with pytest.raises(Trained):
        lumitree.bake_network("lamp.xml", "a.lumitree", config, executor=executor, variant=VARIANT)
    assert len(executor.order) == 5 + 3
    assert len(list(Path("a.work/dataset").glob("*.exr"))) == 3


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
    for call in (
        lambda: lumitree.bake("lamp.xml", executor="two"),
        lambda: lumitree.capture("lamp.xml", "views", executor="two"),
        lambda: lumitree.render("room.xml", executor="two"),
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
    """An executor in place of those of the options."""
    executor, asked = LastFirst(), []

    @contextlib.contextmanager
    def given(value):
        asked.append(value)
        yield executor

    monkeypatch.setattr("lumitree.core.process_pool.process_pool", given)
    monkeypatch.setattr("lumitree.core.dask_executor.dask_executor", given)
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
    for name in QUALITIES:
        monkeypatch.setitem(QUALITIES, name, bake_config())
    executor, asked = shared_by
    assert main([*command.split(), *option]) == 0, capsys.readouterr().err
    assert len(executor.order) >= 2
    assert asked == [value]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--workers", "0"), "workers is 0; expected 1 to 1,024"),
        (("--workers", "2", "--scheduler", "tcp://a:1"), "not allowed with argument"),
    ],
)
def test_wrong_options_for_workers_are_refused(arguments, message, capsys):
    assert main(["render", "room.xml", "-o", "room.exr", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line


def test_workers_are_refused_where_there_are_no_light_paths(folder, capsys):
    (folder / "a.ies").write_text("IESNA:LM-63-2002\nTILT=NONE\n")
    for luminaire, more, message in (
        ("a.ies", (), r"--workers: not for a photometric file such as a\.ies; leave it out"),
        ("lamp.xml", ("--parts", "field"), "--workers: for the light paths of the part light"),
    ):
        command = ["bake", luminaire, "-o", "a.lumitree", "--workers", "2", *more]
        assert main(command) == 2
        assert re.search(message, capsys.readouterr().err)


def test_without_dask_the_option_says_what_to_install(monkeypatch, capsys):
    from lumitree.core import extras

    monkeypatch.setattr(extras, "CLUSTER", {"no_such_module": "distributed"})
    assert main(["render", "room.xml", "-o", "room.exr", "--scheduler", "tcp://a:1"]) == 2
    assert capsys.readouterr().err == (
        "lumitree: error: a Dask scheduler needs packages that are not installed (distributed); "
        "install them with `pip install 'lumitree[cluster]'`\n"
    )
