"""The program works where it is installed: a bake, an image and figures in a process of its own.

The workflows run this with every version of Python and on every system.
"""

import os
import subprocess
import sys

import pytest

import lumitree
from lumitree.core.images import read_exr
from support.exported_lamps import lamp
from support.lamps import BALL, room


def run(folder, *arguments, **changes):
    """Run a command, with changes of its environment; it must end with status 0."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **changes}
    result = subprocess.run(
        [sys.executable, "-m", "lumitree", *arguments],
        cwd=folder,
        env={name: value for name, value in environment.items() if value is not None},
        capture_output=True,
        text=True,
        encoding="utf-8",
        errors="replace",
    )
    assert result.returncode == 0, result.stderr
    return result


def bake_and_render(folder, **changes):
    """A bake in seconds, a room with it, and its figures, by the command line."""
    (folder / "lamp.xml").write_text(BALL, encoding="utf-8")
    (folder / "room.xml").write_text(room(32, 32), encoding="utf-8")
    few = "parts = ['light']\nirradiance_paths = 0\n[light]\npaths = 65536\nbatch = 65536\n"
    (folder / "few.toml").write_text(few, encoding="utf-8")
    bake = ["bake", "lamp.xml", "-o", "lamp.lumitree", "--quality", "preview"]
    results = [run(folder, *bake, "--config", "few.toml", **changes)]
    place = ["--place", "lamp.lumitree", "--at", "0,1,0", "--size", "1"]
    render = ["render", "room.xml", "-o", "room.exr", "--spp", "4", *place]
    results.append(run(folder, *render, **changes))
    assert 0.05 < read_exr(folder / "room.exr")["RGB"].mean() < 5
    figures = ["photometry", "lamp.lumitree", "-o", "lamp.ies", "--step", "30"]
    results.append(run(folder, *figures, **changes))
    return results


@pytest.mark.skipif(os.name == "nt", reason="it has no C locale")
@pytest.mark.parametrize("arguments", [["render", "--help"], ["info", "lamp.lumitree"]])
def test_output_in_the_c_locale(tmp_path, arguments):
    """Characters that ASCII lacks become question marks."""
    lumitree.save(lamp("Größe ±"), tmp_path / "lamp.lumitree")
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": None}
    result = run(tmp_path, *arguments, **locale)
    assert result.stdout.isascii()
    assert result.stderr == ""


@pytest.mark.slow
def test_a_lamp_is_baked_rendered_and_measured(tmp_path):
    folder = tmp_path / "Ordner für Leuchten"
    folder.mkdir()
    for result in bake_and_render(folder):
        # Progress is shown after some seconds.
        assert "warning" not in result.stderr


@pytest.mark.slow
@pytest.mark.parametrize("home", ["a file", "none"])
def test_without_a_home(tmp_path, home):
    """Dr.Jit, Matplotlib and JAX keep files in it, and must do without."""
    (tmp_path / "file").write_text("", encoding="utf-8")
    work = tmp_path / "work"
    work.mkdir()
    # Nobody can make a folder there, not even root.
    place = str(tmp_path / "file" / "home") if home == "a file" else None
    names = ("HOME", "USERPROFILE", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR")
    bake_and_render(work, **dict.fromkeys(names, place))
    assert sorted(each.name for each in tmp_path.iterdir()) == ["file", "work"]
