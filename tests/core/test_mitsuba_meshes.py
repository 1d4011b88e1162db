"""Meshes of Mitsuba: made, read, changed and hit by rays."""

import numpy as np
import pytest

from lumitree.core.backend import load_mitsuba

mi = load_mitsuba()

from lumitree.core.mitsuba_meshes import (  # noqa: E402
    VERTEX_COLOUR,
    change_mesh,
    copy_mesh,
    is_flipped,
    make_mesh,
    mesh_arrays,
    mesh_triangles,
    mesh_vertices,
)

# A square of side 2 that faces up (z), in two triangles. Its normals lean to x.
SQUARE = {
    "vertices": np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32),
    "faces": np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
}
REST = {
    "normals": np.tile(np.float32([0.6, 0, 0.8]), (4, 1)),
    "texcoords": np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32),
    "colours": np.array([[0, 0, 0], [1, 0, 0.5], [1, 1, 0.5], [0, 1, 0]], np.float32),
}
PLACES = np.array([[0.5, -0.25], [-0.5, 0.25]])


def hits(mesh):
    """Where rays straight down from z = 3 meet a mesh."""
    scene = mi.load_dict({"type": "scene", "mesh": mesh})
    origin = mi.Point3f(*PLACES.T.astype(np.float32), 3)
    return scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(0, 0, -1)))


def rows(vectors):
    return np.array(vectors).T


def same(found, expected):
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)
        assert found[name].dtype == values.dtype


@pytest.mark.parametrize("arrays", [SQUARE, SQUARE | REST], ids=["least", "all"])
def test_arrays_are_read_as_they_were_given(arrays):
    nothing = dict.fromkeys(REST) | {"colours": np.zeros((0, 3))}
    mesh = make_mesh("square", nothing | arrays)
    same(mesh_arrays(mesh), arrays)
    np.testing.assert_array_equal(mesh_vertices(mesh), SQUARE["vertices"])
    np.testing.assert_array_equal(mesh_triangles(mesh), SQUARE["vertices"][SQUARE["faces"]])


def test_rays_meet_all_that_was_given():
    mesh = make_mesh("square", SQUARE | REST)
    si = hits(mesh)
    assert np.array(si.t) == pytest.approx(3)
    assert rows(si.n) == pytest.approx(np.tile([0, 0, 1], (2, 1)))
    assert rows(si.sh_frame.n) == pytest.approx(np.tile([0.6, 0, 0.8], (2, 1)), abs=1e-6)
    uv = (PLACES + 1) / 2
    assert rows(si.uv) == pytest.approx(uv, abs=1e-6)
    colours = rows(mesh.eval_attribute_3(VERTEX_COLOUR, si))
    assert colours == pytest.approx(np.stack([*uv.T, uv[:, 0] / 2], axis=1), abs=1e-6)


def test_a_mesh_without_normals_is_flat():
    """The two triangles of a roof are not smoothed along the edge that they share."""
    roof = SQUARE["vertices"] + np.float32([[0, 0, 0], [0, 0, 1], [0, 0, 0], [0, 0, 1]])
    si = hits(make_mesh("roof", SQUARE | {"vertices": roof}))
    np.testing.assert_array_equal(np.array(si.sh_frame.n), np.array(si.n))
    assert np.array(si.n)[0] == pytest.approx(np.array([-2, 2]) / 24**0.5)


def test_a_changed_mesh_is_met_where_it_is_now():
    mesh = make_mesh("square", SQUARE | REST)
    change = {"vertices": SQUARE["vertices"] + np.float32([0, 0, 1]), "normals": -REST["normals"]}
    change_mesh(mesh, change | {"faces": SQUARE["faces"][:, ::-1]})
    same(mesh_arrays(mesh), SQUARE | REST | change | {"faces": SQUARE["faces"][:, ::-1]})
    si = hits(mesh)
    assert np.array(si.t) == pytest.approx(2)
    assert np.array(si.n)[2] == pytest.approx(-1)


@pytest.mark.parametrize("flip", [False, True])
def test_properties_are_those_of_the_mesh(flip):
    props = mi.Properties()
    props["flip_normals"], props["bsdf"] = flip, mi.load_dict({"type": "dielectric", "id": "glass"})
    mesh = make_mesh("square", SQUARE, props)
    assert mesh.bsdf().id() == "glass"
    a, b, c = mesh_triangles(mesh)[0]
    front = np.cross(b - a, c - a)[2] * (-1 if is_flipped(mesh) else 1)
    assert np.sign(front) == (-1 if flip else 1)
    assert np.array(hits(mesh).n)[2] == pytest.approx(np.sign(front))


def test_a_subclass_is_constructed_with_the_arrays_of_a_mesh():
    class Copy(mi.Mesh):
        def __init__(self, props):
            copy_mesh(self, cube, props)

    to_world = mi.ScalarTransform4f().translate([0, 0, 1]).scale(0.5)
    cube = mi.load_dict({"type": "cube", "to_world": to_world})
    props = mi.Properties("copy")
    props.set_id("box")
    copy = Copy(props)
    assert copy.id() == "box"
    same(mesh_arrays(copy), mesh_arrays(cube))
    assert np.array(hits(copy).t) == pytest.approx([1.5, 1.5])
