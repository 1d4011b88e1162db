"""The program works where it is installed: a bake, an image and figures in a process of its own.

The workflows run this with every version of Python and on every system.
"""

import os
import subprocess
import sys

import pytest

from lumitree.core.images import read_exr

LAMP = (
    '<scene version="3.0.0"><shape type="sphere"><emitter type="area">'
    '<rgb name="radiance" value="3,2,1"/></emitter></shape></scene>'
)
ROOM = (
    '<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="4"/>'
    '</integrator><sensor type="perspective"><transform name="to_world">'
    '<lookat origin="0,1,6" target="0,0.5,0" up="0,1,0"/></transform>'
    '<film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/>'
    '</film></sensor><shape type="rectangle"><transform name="to_world">'
    '<rotate x="1" angle="-90"/><scale value="4"/></transform></shape></scene>'
)


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
    (folder / "lamp.xml").write_text(LAMP, encoding="utf-8")
    (folder / "room.xml").write_text(ROOM, encoding="utf-8")
    few = "parts = ['light']\nirradiance_paths = 0\n[light_field]\npaths = 65536\nbatch = 65536\n"
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


@pytest.mark.slow
def test_temporary_files_in_a_folder_with_spaces(tmp_path):
    place, work = tmp_path / "für Dateien (1)", tmp_path / "work"
    place.mkdir()
    work.mkdir()
    bake_and_render(work, TMPDIR=str(place), TEMP=str(place), TMP=str(place))
    assert not list(place.glob("lumitree*"))
