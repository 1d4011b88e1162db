"""Outputs that cannot be written, or that others write, remove or read: one line, nothing else.

Every command that writes is tried with each failure. The slow tests do so on real disks: those
that are full, and those that cannot be written.
"""

import contextlib
import errno
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.core import files
from lumitree.core.images import write_exr
from lumitree.core.work_folder import WorkFolder, alone_in
from support import tiny_bakes
from support.fields import random_asset
from support.ies_text import ies_text
from support.light_fields import random_light_field

LAMP = (
    '<scene version="3.0.0"><shape type="sphere"><emitter type="area">'
    '<rgb name="radiance" value="3,2,1"/></emitter></shape></scene>'
)
ROOM = (
    '<scene version="3.0.0"><integrator type="path"/><sensor type="perspective">'
    '<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>'
    '</film></sensor><shape type="rectangle"/></scene>'
)
PLACED = ("--place", "a.lumitree", "--at", "0,0,3", "--size", "1")
# Commands that take a second or less, once modules are imported.
CHEAP = {
    "mix": ("mix", "layers.exr", "-o", "out/a.png"),
    "mix, linear": ("mix", "layers.exr", "-o", "out/a.exr"),
    "export": ("export", "a.lumitree", "-o", "out/a.rad", "--lights", "1"),
    "export to a folder": ("export", "a.lumitree", "-o", "out/a", "--lights", "1"),
    "extension": ("blender-extension", "-o", "out/a.zip"),
}
OTHERS = {
    "photometry": ("photometry", "lamp.ies", "-o", "out/a.ldt", "--step", "15"),
    "report": ("photometry", "lamp.ies", "-o", "out/a.html", "--step", "15"),
    "view": ("view", "lamp.ies", "-o", "out/a.html"),
    "bake of a photometric file": ("bake", "lamp.ies", "-o", "out/lamp.lumitree", "--parts",
                                   "light"),
    "bake": ("bake", "lamp.xml", "-o", "out/lamp.lumitree"),
    "bake of lamps": ("bake", "lamp.xml", "other.ies", "-o", "out/", "--parts", "light"),
    "bake of views": ("bake", "views", "-o", "out/lamp.lumitree", "--parts", "field"),
    "refine": ("refine", "a.lumitree", "lamp.xml", "-o", "out/lamp.lumitree", "--rays", "100000"),
    "capture": ("capture", "lamp.xml", "-o", "out/views", "--views", "3", "--resolution", "32",
                "--spp", "4"),
    "preview": ("preview", "lamp.xml", "-o", "out/a.png"),
    "evaluate": ("evaluate", "a.lumitree", "lamp.xml", "-o", "out/a.png", "--views", "1",
                 "--resolution", "32", "--spp", "4", "--irradiance-paths", "4096"),
    "render": ("render", "room.xml", *PLACED, "-o", "out/a.exr", "--spp", "1", "--layers",
               "out/layers.exr", "--aov", "out/aov.exr", "--luminance", "out/cd.png"),
    "illuminance": ("illuminance", "room.xml", *PLACED, "--plane", "0,0,0", "-o", "out/a.csv",
                    "-o", "out/a.png"),
    "export to glTF": ("export", "a.lumitree", "-o", "out/a.glb", "--lights", "1"),
}  # fmt: skip
COMMANDS = CHEAP | OTHERS


@pytest.fixture(scope="module")
def inputs(mi, tmp_path_factory):
    """A folder with what the commands read."""
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "lamp.xml").write_text(LAMP)
    (folder / "room.xml").write_text(ROOM)
    gamma = [0, 45, 90, 180]
    text = ies_text([[10, 8, 3, 1]], [0], gamma, (0.2, 0.3, 0.1))
    (folder / "lamp.ies").write_text(text)
    (folder / "other.ies").write_text(text)
    field = random_light_field(0)
    lumitree.save(random_asset(0, light_field=field), folder / "a.lumitree")
    layers = np.ones((4, 4, 3), np.float32)
    write_exr(folder / "layers.exr", {"room": layers, "lamp": layers})
    return folder


@pytest.fixture(autouse=True)
def folder(inputs, tmp_path, monkeypatch):
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    tiny_bakes.set_qualities(monkeypatch.setitem)
    return tmp_path


def left():
    """Files of the output."""
    return sorted(str(path) for path in Path("out").rglob("*") if path.is_file())


def check_inputs(inputs):
    for path in inputs.iterdir():
        assert path.read_bytes() == Path(path.name).read_bytes()


def error_line(text):
    """The only line of an error; warnings may come before it."""
    *before, last = text.splitlines()
    assert all(line.startswith("lumitree: warning: ") for line in before), text
    assert last.startswith("lumitree: error: "), text
    return last.removeprefix("lumitree: error: ")


def refuse_new_files(number, monkeypatch):
    """Let the system refuse every temporary file in the folder of the output."""

    def refused(function):
        def make(*args, dir=None, **options):
            if dir is not None and Path(dir).resolve().is_relative_to(Path("out").resolve()):
                raise OSError(number, os.strerror(number), str(dir))
            return function(*args, dir=dir, **options)

        return make

    for name in ("mkstemp", "mkdtemp"):
        monkeypatch.setattr(tempfile, name, refused(getattr(tempfile, name)))


NUMBERS = [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO]


@pytest.mark.parametrize(
    ("name", "number"),
    [(name, NUMBERS[index % len(NUMBERS)]) for index, name in enumerate(CHEAP)],
)
def test_an_output_that_cannot_be_begun_is_one_line(inputs, monkeypatch, capfd, name, number):
    refuse_new_files(number, monkeypatch)
    assert main(list(COMMANDS[name])) == 2
    line = error_line(capfd.readouterr().err)
    assert re.match(rf"cannot write out/?\S*: {os.strerror(number)}; ", line)
    assert left() == []
    check_inputs(inputs)


@pytest.mark.parametrize("name", CHEAP)
def test_a_disk_that_is_full_at_the_end_is_one_line(inputs, monkeypatch, capfd, name):
    flush = files.flush_to_disk

    def full(path):
        if Path(path).resolve().is_relative_to(Path("out").resolve()):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(path)

    for module in ("files", "work_folder"):
        monkeypatch.setattr(f"lumitree.core.{module}.flush_to_disk", full)
    assert main(list(COMMANDS[name])) == 2
    line = error_line(capfd.readouterr().err)
    assert re.match(r"cannot write out/?\S*: No space left on device; free some space or ", line)
    assert left() == []
    check_inputs(inputs)


@pytest.mark.parametrize("name", CHEAP)
def test_a_folder_that_vanishes_is_one_line(inputs, monkeypatch, capfd, name):
    def vanish(_):
        shutil.rmtree("out")
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))

    for module in ("files", "work_folder"):
        monkeypatch.setattr(f"lumitree.core.{module}.flush_to_disk", vanish)
    assert main(list(COMMANDS[name])) == 2
    line = error_line(capfd.readouterr().err)
    assert re.match(r"cannot write out/?\S*: No such file or directory; choose another", line)
    assert left() == []
    check_inputs(inputs)


def test_a_clock_that_jumps_changes_nothing(monkeypatch, capfd):
    """Forwards and backwards by years at each question."""
    assert main(list(CHEAP["export"])) == 0
    before = {path: Path(path).read_bytes() for path in left()}
    shutil.rmtree("out")
    times = iter(range(10**6))
    years = 365 * 86400.0
    monkeypatch.setattr(time, "time", lambda: (next(times) % 7 - 3) * 30 * years + 2e9)
    for name in CHEAP:
        assert main(list(CHEAP[name])) == 0, name
    assert before.items() <= {path: Path(path).read_bytes() for path in left()}.items()


def test_a_folder_of_results_has_one_writer(capfd):
    with alone_in(Path("out/views")):
        assert main(list(COMMANDS["capture"])) == 2
    line = "another process works in out/views; wait for it, or choose another output with -o"
    assert error_line(capfd.readouterr().err) == line
    assert left() == []


def test_a_bake_has_one_writer(capfd):
    with WorkFolder("out/lamp.work"):
        assert main(list(COMMANDS["bake"])) == 2
    line = "another process works in out/lamp.work; wait for it, or choose another folder with"
    assert error_line(capfd.readouterr().err).startswith(line)
    assert left() == []


@pytest.mark.usefixtures("network_packages")
def test_a_run_has_one_writer(capfd):
    views = ("--views", "4", "--resolution", "16", "--spp", "4")
    assert main(["capture", "lamp.xml", "-o", "views", *views]) == 0
    capfd.readouterr()
    with alone_in(Path("out/run")):
        assert main(["train", "views", "-o", "out/run"]) == 2
    line = "another process works in out/run; wait for it, or choose another output with -o"
    assert error_line(capfd.readouterr().err) == line
    assert left() == []


def on_disk(command, options, before=""):
    """Run a command of the shell's own view of the disks, with a disk mounted at `out`.

    Returns:
        The exit status, standard error, and the files of the output.
    """
    program = [sys.executable, tiny_bakes.__file__, *command]
    script = (
        f'mkdir -p out && mount -t tmpfs -o {options} tmpfs out && {before} "$@"; status=$?; '
        'echo "status $status"; find out -type f'
    )
    run = subprocess.run(
        ["unshare", "--map-root-user", "--mount", "sh", "-c", script, "sh", *program],
        capture_output=True, text=True, timeout=600,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    lines = run.stdout.splitlines()
    if not any(line.startswith("status") for line in lines):
        pytest.skip(f"no disk can be mounted here: {run.stderr}")
    first = next(index for index, line in enumerate(lines) if line.startswith("status "))
    return int(lines[first].split()[1]), run.stderr, lines[first + 1 :]


@pytest.fixture
def disks():
    with contextlib.suppress(OSError):
        if subprocess.run(["unshare", "--map-root-user", "--mount", "true"]).returncode == 0:
            return
    pytest.skip("unshare cannot give a process disks of its own here")


def make_views(name):
    if name == "bake of views":
        views = ("--views", "12", "--resolution", "32", "--spp", "16")
        assert main(["capture", "lamp.xml", "-o", "views", *views]) == 0


@pytest.mark.slow
@pytest.mark.usefixtures("disks")
@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk_is_one_line(inputs, name):
    make_views(name)
    command = COMMANDS[name]
    # One page, in which the folder is. Larger disks hold parts of what is written.
    for size in ("4k", "8k", "20k"):
        status, err, found = on_disk(command, f"size={size}")
        assert "Traceback" not in err
        if status == 0:
            continue
        assert status == 2, err
        last = err.splitlines()[-1]
        assert "No space left on device" in last, err
        assert last.startswith("lumitree: error: "), err
        state = re.compile(r"out/lamp\.work/|out/views/|out/index-files/")
        assert all(state.match(each) for each in found if not is_whole(each, name)), found
    check_inputs(inputs)


def is_whole(path, name):
    """Whether a file is one of several outputs, which was written before the disk was full."""
    several = {
        "render": ("out/layers.exr", "out/aov.exr", "out/cd.png"),
        "illuminance": ("out/a.csv",),
        "evaluate": ("out/a.png",),
        "bake of lamps": ("out/lamp.lumitree", "out/other.lumitree", "out/index.html"),
    }
    return path in several.get(name, ())


@pytest.mark.slow
@pytest.mark.usefixtures("disks")
@pytest.mark.parametrize("name", COMMANDS)
def test_a_read_only_disk_is_refused_before_any_work(inputs, name):
    make_views(name)
    before = "mount -o remount,ro out && "
    status, err, found = on_disk(COMMANDS[name], "size=1m", before)
    assert status == 2, err
    assert "Read-only file system" in error_line(err)
    assert found == []
    check_inputs(inputs)
