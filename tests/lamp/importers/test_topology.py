"""Closed and solid pieces of a mesh, their orientation, and shading normals."""

import warnings

import numpy as np
import pytest
import trimesh

from lumitree.errors import LumitreeWarning
from lumitree.lamp.importers import topology
from lumitree.lamp.importers.topology import (
    Pieces,
    count_solids,
    crease_normals,
    face_normals,
    faces_to_turn,
    is_solid,
    turned_with_normals,
    weld,
)
from lumitree.lamp.meshes import Mesh


def ball(radius=1.0, centre=(0, 0, 0), inwards=False):
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    faces = mesh.faces[:, ::-1] if inwards else mesh.faces
    return np.asarray(mesh.vertices) + centre, np.asarray(faces)


def joined(*surfaces):
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in surfaces)])
    return (
        np.concatenate([vertices for vertices, _ in surfaces]),
        np.concatenate([faces + at for (_, faces), at in zip(surfaces, offsets, strict=False)]),
    )


def volumes(positions, faces):
    mesh = trimesh.Trimesh(positions, faces, process=False)
    return [piece.volume for piece in mesh.split(only_watertight=False, repair=False)]


def turned_out(positions, faces):
    turn = faces_to_turn(positions, faces, Pieces(faces), "material 'glass'")
    return np.where(turn[:, None], faces[:, ::-1], faces)


def test_weld_finds_vertices_in_one_place():
    rng = np.random.default_rng(0)
    points = rng.uniform(-50, 50, (500, 3))
    again = points + rng.uniform(-1e-6, 1e-6, points.shape)
    places = weld(np.concatenate([points, again]))
    np.testing.assert_array_equal(places[:500], places[500:])
    assert len(np.unique(places)) == 500
    assert len(np.unique(weld(np.zeros((5, 3))))) == 1


@pytest.mark.parametrize("inwards", [False, True])
def test_inner_side_of_a_wall_faces_into_the_hollow(inwards):
    """A ball with a cavity and a ball in the cavity, however the file winds them."""
    positions, faces = joined(ball(3, inwards=inwards), ball(2, inwards=inwards), ball(1))
    outer, cavity, core = volumes(positions, turned_out(positions, faces))
    assert outer > 0 > cavity
    assert core > 0


def test_overlapping_pieces_do_not_count_as_hollow():
    positions, faces = joined(ball(2), ball(1, centre=(2, 0, 0)), ball(1, centre=(0, 1.2, 0)))
    assert min(volumes(positions, turned_out(positions, faces))) > 0


def test_mixed_winding_is_made_consistent():
    positions, faces = ball()
    faces = faces.copy()
    faces[::3] = faces[::3, ::-1]
    assert not Pieces(faces).consistent.any()
    out = turned_out(positions, faces)
    assert Pieces(out).consistent.all()
    assert volumes(positions, out)[0] > 4


def solids(positions, faces):
    return count_solids(Mesh(positions, np.ones_like(positions), faces))


def test_two_sheets_in_one_place_are_closed_but_not_solid():
    positions, faces = ball()
    double = np.concatenate([faces[:40], faces[:40, ::-1]])
    assert Pieces(double).closed.all()
    assert solids(positions, double) == (0, 1)


def test_a_face_wound_against_its_neighbours_is_closed_but_not_solid():
    positions, faces = ball()
    faces = faces.copy()
    faces[5] = faces[5, ::-1]
    assert Pieces(faces).closed.all()
    assert solids(positions, faces) == (0, 1)
    assert solids(positions, turned_out(positions, faces)) == (1, 1)


def test_a_mesh_is_solid_if_all_its_pieces_are():
    whole, opened = ball(), (ball(centre=(3, 0, 0))[0], ball()[1][1:])
    for second, expected in ((ball(centre=(3, 0, 0)), True), (opened, False)):
        positions, faces = joined(whole, second)
        assert is_solid(Mesh(positions, np.ones_like(positions), faces)) == expected


def test_edge_of_two_solids_is_closed():
    """Two cubes that share an edge: four faces there, two wound each way."""
    first = trimesh.creation.box((1, 1, 1))
    positions, faces = joined(
        (first.vertices, first.faces), (first.vertices + np.array([1, 1, 0]), first.faces)
    )
    faces = weld(positions)[faces]
    assert Pieces(faces).closed.tolist() == [True]


def test_too_many_pieces_give_a_warning(monkeypatch):
    monkeypatch.setattr(topology, "_MAX_NESTING_WORK", 3)
    positions, faces = joined(ball(3), ball(2))
    with pytest.warns(LumitreeWarning, match="material 'glass': too many closed pieces"):
        out = turned_out(positions, faces)
    assert min(volumes(positions, out)) > 0


def normals_of(positions, faces, groups=None, crease=40.0):
    groups = np.ones(len(faces), np.int64) if groups is None else groups
    index, normals = crease_normals(positions, faces, Pieces(faces), groups, crease)
    return normals[index]


def test_creases_of_a_box_are_hard_and_of_a_ball_smooth():
    box = trimesh.creation.box((1, 2, 3))
    found = normals_of(box.vertices, box.faces)
    np.testing.assert_allclose(found, np.repeat(box.face_normals[:, None], 3, 1), atol=1e-12)
    positions, faces = ball()
    np.testing.assert_allclose(normals_of(positions, faces), positions[faces], atol=0.02)


def test_smoothing_groups_and_none():
    positions, faces = ball()
    flat = np.repeat(face_normals(positions, faces)[:, None], 3, axis=1)
    np.testing.assert_allclose(normals_of(positions, faces, np.zeros(len(faces), int)), flat)
    groups = 1 + (positions[faces].mean(axis=1)[:, 1] > 0)
    found = normals_of(positions, faces, groups)
    index, _ = crease_normals(positions, faces, Pieces(faces), groups)
    assert not set(index[groups == 1].ravel()) & set(index[groups == 2].ravel())
    assert not np.allclose(found, flat)


def test_faces_without_area_do_no_harm():
    positions = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = normals_of(positions, faces)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1)
    np.testing.assert_allclose(found[1], [[0, 0, 1]] * 3)


def test_normals_follow_their_faces():
    positions, faces = ball()
    right = Mesh(positions, positions, faces)
    for normals in (positions, -positions):
        for wound, turn in ((faces, False), (faces[:, ::-1], True)):
            given = Mesh(positions, normals, wound)
            turned = turned_with_normals(given, np.full(len(faces), turn))
            np.testing.assert_array_equal(turned.faces, right.faces)
            np.testing.assert_array_equal(turned.normals, right.normals)
