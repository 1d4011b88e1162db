"""`lumitree illuminance`."""

import csv
import json

import pytest

from lumitree.cli import main

ROOM = """<scene version="3.0.0">
<shape type="sphere" id="wall"><float name="radius" value="3"/>
<boolean name="flip_normals" value="true"/>
<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
<emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>
<shape type="rectangle" id="desk"><transform name="to_world"><scale value="0.2"/>
<rotate x="1" angle="-90"/></transform></shape>
</scene>"""


@pytest.fixture
def room(tmp_path):
    path = tmp_path / "room.xml"
    path.write_text(ROOM)
    return str(path)


def test_planes_surfaces_and_points_are_written(mi, room, tmp_path, capsys):
    points = tmp_path / "points.csv"
    points.write_text("x,y,z,nx,ny,nz\n0,-1,0,0,-1,0\n")
    files = [tmp_path / f"lux.{each}" for each in ("csv", "json")]
    arguments = ["--plane", "-0.5,0.5,0", "--normal", "0,1,0", "--extent", "1,0.5"]
    arguments += ["--spacing", "0.5", "--name", "high", "--surface", "desk", "--spacing", "0.2"]
    arguments += ["--points", str(points), "--error", "0.02", "--direct"]
    for file in files:
        arguments += ["-o", str(file)]
    assert main(["illuminance", room, *arguments]) == 0
    rows = list(csv.DictReader(files[0].open()))
    assert [row["area"] for row in rows] == ["high"] * 2 + ["desk"] * 4 + ["points"]
    for row in rows:
        assert float(row["total_lx"]) == pytest.approx(683 * 3.14159, rel=0.12)
    assert json.loads(files[1].read_text())["direct_only"] is True
    printed = capsys.readouterr().out
    assert "high" in printed
    assert f"Open: {files[0]}" in printed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--normal", "0,1,0", "--plane", "0,0,0"], "--normal comes before any --plane"),
        (["--surface", "desk", "--normal", "0,1,0"], "it is for a --plane"),
        (["--plane", "0,0,0", "--spacing", "1", "--spacing", "2"], "--spacing is given twice"),
        (["--plane", "0,0,0", "-o", "lux.txt"], "does not end in one of .csv"),
        (["--points", "missing.csv"], "does not exist"),
        ([], "no plane, surface or points"),
        (["--plane", "0,0,0", "--variant", "llvm_ad_spectral"], "spectral"),
    ],
)
def test_mistakes_are_told_in_one_line(room, capsys, arguments, message):
    assert main(["illuminance", room, *arguments]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert message in line
