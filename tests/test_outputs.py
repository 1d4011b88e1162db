"""Outputs that cannot be written, or that another process writes: one line, nothing else."""

import errno
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.core import files
from lumitree.core.files import WorkFolder, exclusive
from lumitree.core.images import write_exr
from support import tiny_bakes
from support.fields import random_asset
from support.lamps import BALL
from support.light_fields import random_light_field

COMMANDS = {
    "mix": ("mix", "layers.exr", "-o", "out/a.png"),
    "mix, linear": ("mix", "layers.exr", "-o", "out/a.exr"),
    "export": ("export", "a.lumitree", "-o", "out/a.rad", "--lights", "1"),
    "export to a folder": ("export", "a.lumitree", "-o", "out/a", "--lights", "1"),
    "extension": ("blender-extension", "-o", "out/a.zip"),
}


@pytest.fixture(scope="module")
def inputs(mi, tmp_path_factory):
    """A folder with what the commands read."""
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "lamp.xml").write_text(BALL)
    field = random_light_field(0)
    lumitree.save(random_asset(0, light_field=field), folder / "a.lumitree")
    layers = np.ones((4, 4, 3), np.float32)
    write_exr(folder / "layers.exr", {"room": layers, "lamp": layers})
    return folder


@pytest.fixture(autouse=True)
def folder(inputs, tmp_path, monkeypatch):
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    tiny_bakes.set_qualities(monkeypatch.setattr)
    return tmp_path


def left():
    """Files of the output."""
    return sorted(str(path) for path in Path("out").rglob("*") if path.is_file())


def error_line(text):
    """The only line of an error; warnings may come before it."""
    *before, last = text.splitlines()
    assert all(line.startswith("lumitree: warning: ") for line in before), text
    assert last.startswith("lumitree: error: "), text
    return last.removeprefix("lumitree: error: ")


def refuse_new_files(monkeypatch):
    """Let the system refuse every temporary file in the folder of the output."""
    lock = files._lock

    def refused(path, **options):
        if path.resolve().is_relative_to(Path("out").resolve()):
            raise OSError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return lock(path, **options)

    monkeypatch.setattr(files, "_lock", refused)
    return "Permission denied; "


def fill_the_disk(monkeypatch):
    """Let the disk of the output be full when a file is complete."""
    flush = files.flush_to_disk

    def full(path):
        if Path(path).resolve().is_relative_to(Path("out").resolve()):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(path)

    monkeypatch.setattr(files, "flush_to_disk", full)
    return "No space left on device; free some space or "


def remove_the_folder(monkeypatch):
    """Let another program remove the folder of the output when a file is complete."""

    def vanish(_):
        shutil.rmtree("out")
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))

    monkeypatch.setattr(files, "flush_to_disk", vanish)
    return "No such file or directory; choose another"


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("fault", [refuse_new_files, fill_the_disk, remove_the_folder])
def test_an_output_that_cannot_be_written_is_one_line(inputs, monkeypatch, capfd, name, fault):
    message = fault(monkeypatch)
    assert main(list(COMMANDS[name])) == 2
    assert re.match(rf"cannot write out/?\S*: {message}", error_line(capfd.readouterr().err))
    assert left() == []
    for path in inputs.iterdir():
        assert path.read_bytes() == Path(path.name).read_bytes()


@pytest.mark.parametrize(
    ("holder", "place", "command"),
    [
        (exclusive, "out/views", "capture lamp.xml -o out/views --views 3 --resolution 32"),
        (WorkFolder, "out/lamp.work", "bake lamp.xml -o out/lamp.lumitree"),
    ],
)
def test_a_folder_has_one_writer(capfd, holder, place, command):
    with holder(Path(place)):
        assert main(command.split()) == 2
    line = f"another process works in {place}; wait for it, or choose another "
    assert error_line(capfd.readouterr().err).startswith(line)
    assert left() == []


@pytest.mark.usefixtures("network_packages")
def test_a_run_has_one_writer(capfd):
    views = ("--views", "4", "--resolution", "16", "--spp", "4")
    assert main(["capture", "lamp.xml", "-o", "views", *views]) == 0
    capfd.readouterr()
    with exclusive(Path("out/run")):
        assert main(["train", "views", "-o", "out/run"]) == 2
    line = "another process works in out/run; wait for it, or choose another output with -o"
    assert error_line(capfd.readouterr().err) == line
    assert left() == []
