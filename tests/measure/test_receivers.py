"""Planes, and points from arrays and files."""

import numpy as np
import pytest

import lumitree
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
