"""Jobs that are killed or asked to stop at any moment, and full disks: nothing done is lost."""

import dataclasses
import errno
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.core.files import atomic_path
from lumitree.core.work_folder import MARKER
from lumitree.errors import LumitreeError
from lumitree.fit.network.config import PRESETS
from support import tiny_bakes
from support.fields import random_asset
from support.slow import slow

LAMP = (
    '<scene version="3.0.0"><shape type="sphere"><emitter type="area">'
    '<rgb name="radiance" value="3,2,1"/></emitter></shape></scene>'
)
BAKE = ("bake", "lamp.xml", "-o", "out/lamp.lumitree")
COMMANDS = {
    "direct": BAKE,
    "network": (*BAKE, "--method", "network"),
    "refine": ("refine", "rough.lumitree", "lamp.xml", "-o", "out/lamp.lumitree",
               "--rays", "500000"),
    "evaluate": ("evaluate", "rough.lumitree", "lamp.xml", "-o", "out/sheet.png", "--views", "3",
                 "--resolution", "64", "--spp", "64", "--irradiance-paths", "65536"),
}  # fmt: skip


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, mi):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(LAMP)
    (tmp_path / "scratch").mkdir()
    lumitree.save(random_asset(0), tmp_path / "rough.lumitree")
    return tmp_path


def start(command, **options):
    script = str(Path(tiny_bakes.__file__))
    environment = os.environ | {"TMPDIR": str(Path("scratch").resolve())}
    return subprocess.Popen(
        [sys.executable, script, *command], stderr=subprocess.PIPE, text=True, env=environment,
        stdout=subprocess.DEVNULL, **options,
    )  # fmt: skip


def work(command, folder):
    """Options that choose the folder of the state."""
    if command[0] != "bake":
        return ["--work", folder]
    Path(".bake.toml").write_text(f'work = "{folder}"')
    return ["--config", ".bake.toml"]


def left():
    """Files below the current folder, without what was there at first."""
    return sorted(
        str(path)
        for path in Path().rglob("*")
        if path.is_file() and path.name not in ("lamp.xml", "rough.lumitree", ".bake.toml")
    )


def check_stopped(process, number):
    """What must hold however far a process came before the signal."""
    _, err = process.communicate(timeout=300)
    assert process.returncode in (0, -number, 128 + number)
    if process.returncode != -number:
        # Else it died of the signal while the test's script was imported, before it was handled.
        assert "Traceback" not in err
    if process.returncode == 128 + number:
        assert "lumitree: stopping ..." in err
        assert re.fullmatch(r"lumitree: error: interrupted; .*", err.splitlines()[-1])
    asset = Path("out/lamp.lumitree")
    if asset.exists():
        lumitree.load(asset)
        if process.returncode == 128 + number:
            # The second while the irradiance around the finished asset is compared.
            complete = "the asset in out/lamp.lumitree is complete, but its irradiance was not"
            assert "the best asset so far is in out/lamp.lumitree" in err or complete in err
    return process.returncode


def stop_and_finish(name, number, moment):
    """Stop a command after so many seconds, then run it to its end."""
    process = start(COMMANDS[name])
    time.sleep(moment)
    process.send_signal(number)
    check_stopped(process, number)
    again = start(COMMANDS[name])
    _, err = again.communicate(timeout=600)
    assert again.returncode == 0, err
    sheets = ["out/sheet-irradiance.png", "out/sheet.png"]
    assert left() == (sheets if name == "evaluate" else ["out/lamp.lumitree"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "number", "moment"),
    [
        ("direct", signal.SIGKILL, 3.0),
        slow("refine", signal.SIGHUP, 3.0),
    ],
)
def test_stopped_commands_leave_nothing_broken_and_can_be_finished(name, number, moment):
    stop_and_finish(name, number, moment)


TRIANGLE_LAMP = "mtllib lamp.mtl\nusemtl light\nv 0 0 0\nv 0 0 1\nv 1 0 0\nf 1 2 3\n"
# Runs the command line, with a signal as soon as a module is being imported.
SIGNAL_IN_IMPORT = """
import signal, sys
name, number = sys.argv[1], int(sys.argv[2])

class Finder:
    def find_spec(self, found, path=None, target=None):
        if found == name:
            sys.meta_path.remove(self)
            signal.raise_signal(number)

sys.meta_path.insert(0, Finder())
sys.argv[:] = ["lumitree", *sys.argv[3:]]
from lumitree.cli import main
sys.exit(main())
"""


@pytest.mark.parametrize(
    ("module", "number", "command"),
    [
        ("lumitree.cli.app", signal.SIGINT, ("info", "rough.lumitree")),
        # trimesh catches what these imports raise, and a model of triangles imports it.
        ("scipy.spatial", signal.SIGTERM, ("photometry", "lamp.obj")),
        ("mitsuba", signal.SIGINT, ("render", "no.xml", "-o", "a.png")),
    ],
)
def test_a_signal_while_modules_are_imported_ends_the_command(module, number, command):
    """Processes of some seconds, since that is when all of these modules are imported."""
    Path("lamp.obj").write_text(TRIANGLE_LAMP)
    Path("lamp.mtl").write_text("newmtl light\nKd 0 0 0\nKe 3 2 1\n")
    there = left()
    process = subprocess.run(
        [sys.executable, "-c", SIGNAL_IN_IMPORT, module, str(int(number)), *command],
        capture_output=True, text=True,
    )  # fmt: skip
    assert process.returncode == 128 + number
    assert process.stdout == ""
    *first, last = process.stderr.splitlines()
    assert first in ([], ["lumitree: stopping ..."])
    assert last.startswith("lumitree: error: interrupted")
    assert left() == there


ROOM = (
    '<scene version="3.0.0"><integrator type="path"/><sensor type="perspective">'
    '<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>'
    '</film></sensor><shape type="rectangle"/></scene>'
)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_mitsuba_makes_a_plugin_ends_the_command(monkeypatch, capfd, number):
    """Mitsuba turns it into RuntimeError."""
    from lumitree.rendering.plugins import shape as proxy_shape

    make = proxy_shape._proxy

    def signalled(*args):
        signal.raise_signal(number)
        return make(*args)

    monkeypatch.setattr(proxy_shape, "_proxy", signalled)
    Path("room.xml").write_text(ROOM)
    command = ["render", "room.xml", "--place", "rough.lumitree", "--at", "0,9,0", "-o", "a.png"]
    assert main(command) == 128 + number
    first, last = capfd.readouterr().err.splitlines()
    assert first == "lumitree: stopping ..."
    assert last.startswith("lumitree: error: interrupted; ")
    assert not Path("a.png").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_results_are_printed_changes_nothing(monkeypatch, capfd, number):
    from lumitree.cli import info

    show = info.print_report

    def signalled(report):
        signal.raise_signal(number)
        show(report)

    monkeypatch.setattr(info, "print_report", signalled)
    assert main(["info", "rough.lumitree", "--json", "a.json"]) == 0
    captured = capfd.readouterr()
    assert "leaves" in captured.out
    assert captured.err == "lumitree: the work is complete; a second signal ends at once\n"
    assert Path("a.json").exists()


def test_a_signal_after_a_bake_is_complete_changes_nothing(tiny, monkeypatch, capfd):
    """Its asset is written, and its irradiance is not to be compared."""
    from lumitree.fit import finishing

    save = finishing.save_asset

    def signalled(*args):
        signal.raise_signal(signal.SIGTERM)
        return save(*args)

    monkeypatch.setattr(finishing, "save_asset", signalled)
    command = [*BAKE, "--parts", "light", "--config", ".bake.toml"]
    Path(".bake.toml").write_text("irradiance_paths = 0")
    assert main(command) == 0
    assert left() == ["out/lamp.lumitree"]
    Path(".bake.toml").write_text("irradiance_paths = 1024")
    assert main(command) == 143
    assert "is complete, but its irradiance was not compared" in capfd.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("network_packages")
@pytest.mark.parametrize("seed", range(50))
def test_stops_at_random_moments(seed):
    choice = random.Random(seed)
    number = choice.choice([signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
    stop_and_finish(choice.choice(list(COMMANDS)), number, choice.uniform(0.5, 15.0))


@pytest.fixture
def tiny(monkeypatch):
    tiny_bakes.set_qualities(monkeypatch.setitem)


@pytest.fixture
def steps(monkeypatch):
    """The steps of the descent that are begun; `steps.before[n]` is called before step n."""
    from lumitree.fit.octree.refine import Refiner

    class Steps(list):
        before: ClassVar[dict[int, Callable[[], None]]] = {}

    advance, done = Refiner.advance, Steps()
    done.before.clear()

    def counted(self, progress):
        done.append(self.step + 1)
        done.before.pop(self.step + 1, lambda: None)()
        return advance(self, progress)

    monkeypatch.setattr(Refiner, "advance", counted)
    return done


def die(*_, **__):
    """As good as a kill: nothing of lumitree's handles it."""
    raise ZeroDivisionError


def run_out_of_disk(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


UNFINISHED = [f"out/lamp.work/{name}" for name in (MARKER, "light.lumitree", "state.npz")]
# Of a light field that could not be saved.
UNSAVED = [UNFINISHED[0], UNFINISHED[2]]


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        slow(signal.SIGINT),
        slow(signal.SIGHUP),
    ],
)
def test_a_stopped_bake_writes_its_best_and_continues(tiny, steps, capfd, number):
    steps.before[3] = lambda: signal.raise_signal(number)
    assert main(list(BAKE)) == 128 + number
    lines = capfd.readouterr().err.splitlines()
    assert lines[0] == "lumitree: stopping ...; a second signal ends at once"
    assert "the best asset so far is in out/lamp.lumitree; the same command" in lines[-1]
    assert steps == [1, 2, 3]
    assert lumitree.load("out/lamp.lumitree").num_leaves > 50
    assert left() == ["out/lamp.lumitree", *UNFINISHED]
    assert main(list(BAKE)) == 0
    assert steps == list(range(1, len(steps) + 1))
    assert left() == ["out/lamp.lumitree"]


@pytest.mark.slow
def test_a_bake_killed_in_its_first_step_continues_from_the_estimate(tiny, steps, monkeypatch):
    steps.before[1] = die
    assert main(list(BAKE)) == 1
    assert left() == UNFINISHED
    monkeypatch.setattr("lumitree.fit.octree.bake._first_field", die)
    assert main(list(BAKE)) == 0
    assert left() == ["out/lamp.lumitree"]


@pytest.mark.slow
def test_a_bake_killed_while_it_calibrates_continues_there(tiny, steps, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("lumitree.fit.octree.bake.flux_correction", die)
        assert main(list(BAKE)) == 1
    done = list(steps)
    assert len(done) > 5
    assert main(list(BAKE)) == 0
    assert steps == done
    assert left() == ["out/lamp.lumitree"]


@pytest.mark.slow
def test_a_killed_bake_repeats_one_step_and_gives_the_same_bytes(tiny, steps, monkeypatch):
    often = {"save_seconds": 0.0, "save_time_factor": 0.0}
    tiny_bakes.set_qualities(monkeypatch.setitem, rays=1 << 18, schedule=often)
    assert main([*BAKE[:-1], "whole.lumitree"]) == 0
    done = list(steps)
    steps.clear()
    for step in (3, 5):
        steps.before[step] = die
        assert main(list(BAKE)) == 1
    assert main(list(BAKE)) == 0
    # The steps that were begun when the process died are done again, and no others.
    assert sorted(steps) == sorted([*done, 3, 5])
    assert Path("out/lamp.lumitree").read_bytes() == Path("whole.lumitree").read_bytes()


def test_a_field_that_only_a_stop_made_the_best_is_not_saved(tiny, steps, monkeypatch):
    """An uninterrupted bake would not keep it."""
    from lumitree.fit.octree.heldout import Score

    # Each step would be a time to compare fields in so short a bake.
    tiny_bakes.set_qualities(monkeypatch.setitem, schedule={"score_interval": 0.9})
    # Every field is kept that is compared.
    monkeypatch.setattr(Score, "rank", property(lambda _: 0.0))
    steps.before[2] = lambda: signal.raise_signal(signal.SIGTERM)
    assert main(list(BAKE)) == 143
    with np.load("out/lamp.work/state.npz") as state:
        assert state["steps"][0] == 2
        assert not np.array_equal(state["best_log_density"], state["log_density"])


@pytest.mark.slow
@pytest.mark.parametrize("command", [BAKE, COMMANDS["refine"]])
def test_a_full_work_disk_is_warned_of_once_and_the_bake_goes_on(
    tiny, steps, monkeypatch, capsys, command
):
    often = {"save_seconds": 0.0, "save_time_factor": 0.0}
    tiny_bakes.set_qualities(monkeypatch.setitem, schedule=often)
    monkeypatch.setattr(np, "savez", run_out_of_disk)
    assert main([*command, *work(command, "full")]) == 0
    err = capsys.readouterr().err
    assert err.count("No space left on device") == 1
    assert "the bake goes on" in err
    assert len(steps) > 5
    kept = [f"full/{MARKER}", "full/light.lumitree"] if command is BAKE else []
    assert left() == [*kept, "out/lamp.lumitree"]


@pytest.mark.slow
def test_a_full_disk_at_the_end_loses_no_work(tiny, steps, monkeypatch, capsys):
    with monkeypatch.context() as patch:
        patch.setattr("safetensors.numpy.save", run_out_of_disk)
        assert main(list(BAKE)) == 2
    err = capsys.readouterr().err
    assert "cannot save the light field" in err
    assert "cannot write out/lamp.lumitree: No space left on device" in err
    done = list(steps)
    assert left() == UNSAVED
    assert main(list(BAKE)) == 0
    assert steps == done
    assert left() == ["out/lamp.lumitree"]


@pytest.mark.slow
def test_a_full_disk_ends_a_list_of_bakes(tiny, monkeypatch, capsys):
    """And fails no lamp: the next one could not be written either."""
    Path("next.xml").write_text(LAMP)
    command = ["bake", "lamp.xml", "next.xml", "-o", "out/", "--parts", "light"]
    with monkeypatch.context() as patch:
        patch.setattr("safetensors.numpy.save", run_out_of_disk)
        assert main(command) == 2
    captured = capsys.readouterr()
    expected = "cannot write out/lamp.lumitree: No space left on device; free some space or choose"
    assert captured.err.splitlines()[-1] == f"lumitree: error: {expected} another output"
    assert captured.out == ""
    # What marks the folder, complete.
    assert left() == ["next.xml", "out/index-files/folder/version.json"]
    assert main(command) == 0


def test_state_that_stays_on_a_full_disk_is_said(tiny, monkeypatch, capsys):
    from lumitree.fit import finishing

    def fail(*_):
        with atomic_path("out/lamp.lumitree"):
            run_out_of_disk()

    monkeypatch.setattr(finishing, "save_asset", fail)
    assert main([*BAKE, "--parts", "light"]) == 2
    assert capsys.readouterr().err.endswith(
        "; free some space or choose another output; the same command continues from what "
        "out/lamp.work holds\n"
    )
    assert left() == UNFINISHED[:2]


def test_results_that_cannot_be_printed_are_an_error(monkeypatch, capfd):
    with open("/dev/full", "w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main(["info", "rough.lumitree"]) == 2
    expected = "cannot print the results: No space left on device; print them elsewhere"
    assert capfd.readouterr().err == f"lumitree: error: {expected}\n"


@pytest.mark.usefixtures("network_packages")
def test_a_run_without_a_checkpoint_is_removed_from_a_full_disk(tmp_path):
    from lumitree.fit.network import run

    class Manager:
        def latest_step(self):
            return None

        def save(self, step, **_):
            partial = folder / run.CHECKPOINTS / f"{step}.orbax-checkpoint-tmp"
            partial.mkdir(parents=True)
            (partial / "data").write_text("x" * 1000)
            raise ValueError('Failed writing: "/x/10": No space left on device [os_error_code=28]')

    folder = tmp_path / "run"
    folder.mkdir()
    (folder / run.RECORD).write_text("{}")
    line = f"cannot write a checkpoint to {folder}: No space left on device; free some space or"
    with pytest.raises(LumitreeError, match=f"^{re.escape(line)} choose another output$"):
        run.save_checkpoint(folder, Manager(), 10, {"a": np.zeros(3)})
    assert left() == ["run/run.json"]
    # A run that can be continued stays.
    checkpoint = folder / run.CHECKPOINTS / "5" / "data"
    checkpoint.parent.mkdir()
    checkpoint.write_text("x")
    with pytest.raises(LumitreeError, match="and continue with --resume"):
        run.save_checkpoint(folder, Manager(), 10, {"a": np.zeros(3)})
    run.remove_unfinished(folder, made=True)
    assert left() == ["run/checkpoints/5/data", "run/run.json"]
    checkpoint.unlink()
    checkpoint.parent.rmdir()
    run.remove_unfinished(folder, made=True)
    assert not folder.exists()


@pytest.mark.parametrize("name", ["precious.txt", "run/precious.txt"])
@pytest.mark.parametrize("option", [False, True])
@pytest.mark.parametrize("method", ["octree", "network"])
def test_a_folder_of_others_is_neither_used_nor_removed(
    tiny, request, capsys, name, option, method
):
    if method == "network":
        request.getfixturevalue("network_packages")
    path = Path("proj" if option else "out/lamp.work") / name
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    chosen = work(BAKE, "proj") if option else []
    assert main([*BAKE, *chosen, "--method", method]) == 2
    assert "holds what lumitree did not write" in capsys.readouterr().err
    assert left() == [str(path)]


@pytest.mark.slow
def test_a_named_work_folder_stays(tiny, steps, capsys):
    assert main([*BAKE, *work(BAKE, "w")]) == 0
    assert left() == ["out/lamp.lumitree", f"w/{MARKER}", "w/light.lumitree", "w/state.npz"]


@pytest.mark.slow
def test_pictures_are_baked_too(tiny, capsys):
    assert main(["capture", "lamp.xml", "-o", "d", "--views", "12", "--resolution", "32",
                 "--spp", "16"]) == 0  # fmt: skip
    before = left()
    assert main(["bake", "d", "-o", "out/lamp.lumitree", "--parts", "field"]) == 0
    assert left() == [*before, "out/lamp.lumitree"]
    assert lumitree.load("out/lamp.lumitree").num_leaves > 50


@pytest.mark.slow
@pytest.mark.usefixtures("network_packages")
def test_training_that_was_killed_before_its_first_checkpoint_starts_again(monkeypatch, capsys):
    train = dataclasses.replace(tiny_bakes.network_config().train, num_steps=20)
    monkeypatch.setitem(PRESETS, "preview", train)
    assert main(["capture", "lamp.xml", "-o", "d", "--views", "8", "--resolution", "32",
                 "--spp", "16"]) == 0  # fmt: skip
    command = ["train", "d", "-o", "run"]
    for again in (command, [*command, "--resume"]):
        with monkeypatch.context() as patch:
            patch.setattr("lumitree.fit.network.train._Loop.run", die)
            assert main(again) == 1
        assert Path("run/run.json").exists()
    assert main([*command, "--resume"]) == 0
    capsys.readouterr()
    assert main(command) == 2
    assert "run is not empty; continue it with --resume" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("network_packages")
def test_training_goes_on_where_a_checkpoint_cannot_be_written(monkeypatch, capsys):
    from lumitree.fit.network import train as training

    train = dataclasses.replace(tiny_bakes.network_config().train, num_steps=20)
    monkeypatch.setitem(PRESETS, "preview", train)
    assert main(["capture", "lamp.xml", "-o", "d", "--views", "8", "--resolution", "32",
                 "--spp", "16"]) == 0  # fmt: skip
    save, failed = training.save_checkpoint, []

    def fail_at_first(*args):
        if not failed:
            failed.append(1)
            raise LumitreeError("cannot write a checkpoint")
        return save(*args)

    monkeypatch.setattr(training, "save_checkpoint", fail_at_first)
    monkeypatch.setattr(training, "_CHECKPOINT_SECONDS", 0.0)
    assert main(["train", "d", "-o", "run"]) == 0
    assert "the training continues" in capsys.readouterr().err
    assert Path("run/checkpoints").is_dir()
