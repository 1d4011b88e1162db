"""Jobs that are killed or asked to stop at any moment, and full disks: nothing done is lost."""

import errno
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.core import checkpoint
from lumitree.core.files import MARKER, atomic_path
from support import tiny_bakes
from support.fields import random_asset
from support.lamps import BALL, room

BAKE = ("bake", "lamp.xml", "-o", "out/lamp.lumitree")
REFINE = ("refine", "rough.lumitree", "lamp.xml", "-o", "out/lamp.lumitree", "--rays", "500000")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, mi):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(BALL)
    lumitree.save(random_asset(0), tmp_path / "rough.lumitree")
    return tmp_path


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


def test_a_signal_while_mitsuba_makes_a_plugin_ends_the_command(monkeypatch, capfd):
    """Mitsuba turns it into RuntimeError."""
    from lumitree.rendering import shapes as proxy_shape

    make = proxy_shape._proxy

    def signalled(*args):
        signal.raise_signal(signal.SIGTERM)
        return make(*args)

    monkeypatch.setattr(proxy_shape, "_proxy", signalled)
    Path("room.xml").write_text(room(8, 8))
    command = ["render", "room.xml", "--place", "rough.lumitree", "--at", "0,9,0", "-o", "a.png"]
    assert main(command) == 128 + signal.SIGTERM
    first, last = capfd.readouterr().err.splitlines()
    assert first == "lumitree: stopping ..."
    assert last.startswith("lumitree: error: interrupted; ")
    assert not Path("a.png").exists()


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


@pytest.fixture
def tiny(monkeypatch):
    tiny_bakes.set_qualities(monkeypatch.setattr)


@pytest.fixture
def steps(monkeypatch):
    """The steps of the descent that are begun; `steps.before[n]` is called before step n."""
    from lumitree.fit.octree.descent import Refiner

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


def save_often(monkeypatch):
    """A checkpoint after each step."""
    monkeypatch.setattr(checkpoint, "_SECONDS", 0.0)
    monkeypatch.setattr(checkpoint, "_MOST_TIME", np.inf)


def die(*_, **__):
    """As good as a kill: nothing of lumitree's handles it."""
    raise ZeroDivisionError


def run_out_of_disk(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


UNFINISHED = [f"out/lamp.work/{name}" for name in (MARKER, "light.npz", "octree.npz")]


@pytest.mark.slow
def test_a_stopped_bake_writes_its_best_and_continues(tiny, steps, capfd):
    steps.before[3] = lambda: signal.raise_signal(signal.SIGTERM)
    assert main(list(BAKE)) == 128 + signal.SIGTERM
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
def test_a_killed_bake_repeats_one_step_and_gives_the_same_bytes(tiny, steps, monkeypatch):
    tiny_bakes.set_qualities(monkeypatch.setattr, rays=1 << 18)
    save_often(monkeypatch)
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


@pytest.mark.slow
@pytest.mark.parametrize("command", [BAKE, REFINE])
def test_a_full_work_disk_is_warned_of_once_and_the_bake_goes_on(
    tiny, steps, monkeypatch, capsys, command
):
    save_often(monkeypatch)
    monkeypatch.setattr(np, "savez", run_out_of_disk)
    assert main([*command, *work(command, "full")]) == 0
    err = capsys.readouterr().err
    # Once for each checkpoint: of the light field and of the octree fit.
    assert err.count("No space left on device") == (2 if command is BAKE else 1)
    assert "it goes on" in err
    assert len(steps) > 5
    assert left() == ["out/lamp.lumitree"]


@pytest.mark.slow
def test_a_full_disk_at_the_end_loses_no_work(tiny, steps, monkeypatch, capsys):
    with monkeypatch.context() as patch:
        patch.setattr("safetensors.numpy.save", run_out_of_disk)
        assert main(list(BAKE)) == 2
    err = capsys.readouterr().err
    assert "cannot write out/lamp.lumitree: No space left on device" in err
    done = list(steps)
    assert left() == UNFINISHED
    assert main(list(BAKE)) == 0
    assert steps == done
    assert left() == ["out/lamp.lumitree"]


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


@pytest.mark.slow
def test_a_named_work_folder_stays(tiny, steps, capsys):
    assert main([*BAKE, *work(BAKE, "w")]) == 0
    assert left() == ["out/lamp.lumitree", f"w/{MARKER}", "w/light.npz", "w/octree.npz"]
