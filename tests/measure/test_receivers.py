"""Planes and points from arrays and files, and the command that takes them."""

import csv
import json

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.measure import receivers
from lumitree.measure.receivers import read_points


def test_a_floor_is_seen_from_above_with_x_to_the_right():
    plane = lumitree.Plane((1, 2, 3), (0, 2, 0), extent=(2, 1), spacing=0.5)
    points, normals = plane.points()
    assert plane.shape == (2, 4)
    assert plane.axes == pytest.approx(np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]))
    assert points[0] == pytest.approx([0.25, 2, 3.25])
    assert points[-1] == pytest.approx([1.75, 2, 2.75])
    assert (normals == [0, 1, 0]).all()


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (-1, 0, 0), (0.3, -2, 0.7)])
def test_axes_are_right_handed_and_in_the_plane(normal):
    axes = lumitree.Plane((0, 0, 0), normal).axes
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.cross(axes[0], axes[1]) == pytest.approx(axes[2])
    assert axes[2] == pytest.approx(np.array(normal) / np.linalg.norm(normal))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"centre": (0, 0)}, "centre is"),
        ({"normal": (0, 0, 0)}, "normal of a plane is 0"),
        ({"extent": (1, -1)}, "two lengths above 0"),
        ({"spacing": 0}, "spacing is 0"),
        ({"centre": (0, np.inf, 0)}, "expected 3 finite numbers"),
        ({"extent": (1e4, 1e4)}, "use a larger spacing"),
        ({"extent": (0.01, 1e6)}, "4,000,000 points.* use a larger spacing"),
    ],
)
def test_wrong_planes_are_refused(arguments, message):
    with pytest.raises(lumitree.LumitreeError, match=message):
        lumitree.Plane(**{"centre": (0, 0, 0), **arguments})


@pytest.mark.parametrize("points", [[[0, 0], [0]], [[0, 0]]])
def test_points_of_other_shapes_are_refused(points):
    with pytest.raises(lumitree.LumitreeError, match="do not match"):
        receivers.collect((), (), (), points, [0, 1, 0], 0)


def test_points_are_read_by_the_names_of_columns(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("name, nz,ny,nx, x,y,z\na, 0,1,0, 1,2,3\nb, 1,0,0, 4,5,6\n")
    points, normals = read_points(path)
    assert points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert normals.tolist() == [[0, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "lacks x, y, z"),
        ("x,y,z\n1,2,3\n", "lacks nx, ny, nz"),
        ("x,y,z,nx,ny,nz\n1,2,3,0,one,0\n", "line 2: expected six numbers"),
        ("x,y,z,nx,ny,nz\n1,2,3\n", "line 2: expected six numbers"),
        ("x,y,z,nx,ny,nz\n", "has no points"),
        ("x,y,z,nx,ny,nz\n1,2,3,0,1,0\n1,2,3\n", "line 3: expected six numbers"),
        ("x,y,z,nx,ny,nz\n1,2,3,0,1,0" + 100_000 * ",", "is no CSV file"),
        ("x,y,z,nx,ny,nz\n" + 21 * "1,2,3,0,1,0\n", "use a larger spacing"),
    ],
)
def test_damaged_files_of_points_are_refused(tmp_path, content, message, monkeypatch):
    monkeypatch.setattr(receivers, "MAX_POINTS", 20)
    path = tmp_path / "points.csv"
    path.write_text(content)
    with pytest.raises(lumitree.LumitreeError, match=message):
        read_points(path)


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
        (["--surface", "desk", "--normal", "0,1,0"], "--normal comes before any --plane"),
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
