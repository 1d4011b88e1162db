"""Closed pieces face outwards, walls inwards, and normals break at creases."""

import warnings

import numpy as np
import pytest
import trimesh

from lumitree.errors import LumitreeWarning
from lumitree.importers import mesh_repair
from lumitree.importers.mesh_repair import (
    Pieces,
    closed_share,
    crease_normals,
    face_normals,
    outward,
    weld,
)
from lumitree.model.geometry import Mesh


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
    return outward(positions, faces, Pieces(faces), "glass")


def test_weld_finds_vertices_in_one_place():
    rng = np.random.default_rng(0)
    points = rng.uniform(-50, 50, (500, 3))
    again = points + rng.uniform(-1e-6, 1e-6, points.shape)
    places = weld(np.concatenate([points, again]))
    np.testing.assert_array_equal(places[:500], places[500:])
    assert len(np.unique(places)) == 500
    assert len(np.unique(weld(np.zeros((5, 3))))) == 1


def test_weld_is_not_quadratic():
    points = np.zeros((200_000, 3))
    points[0] = 1e6
    assert len(np.unique(weld(points))) == 2


def test_pieces_turned_inwards_are_turned_out():
    positions, faces = joined(ball(), ball(centre=(3, 0, 0), inwards=True))
    out = turned_out(positions, faces)
    assert min(volumes(positions, out)) > 4
    np.testing.assert_array_equal(out[: len(faces) // 2], faces[: len(faces) // 2])


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


def test_what_is_closed():
    positions, faces = ball()
    normals = np.ones_like(positions)
    assert closed_share(Mesh(positions, normals, faces)) == (1, 1)
    assert closed_share(Mesh(positions, normals, faces[1:])) == (0, 1)
    double = np.concatenate([faces[:40], faces[:40, ::-1]])
    assert closed_share(Mesh(positions, normals, double)) == (0, 1)
    # Split vertices, as hard edges have them, are one place.
    apart = Mesh(
        positions[faces.ravel()], np.ones((faces.size, 3)), np.arange(faces.size).reshape(-1, 3)
    )
    assert closed_share(apart) == (1, 1)


def test_edge_of_two_solids_is_closed():
    """Two cubes that share an edge: four faces there, two wound each way."""
    first = trimesh.creation.box((1, 1, 1))
    positions, faces = joined(
        (first.vertices, first.faces), (first.vertices + np.array([1, 1, 0]), first.faces)
    )
    faces = weld(positions)[faces]
    assert Pieces(faces).closed.tolist() == [True]


def test_too_many_pieces_are_told(monkeypatch):
    monkeypatch.setattr(mesh_repair, "_MAX_NESTING_WORK", 3)
    positions, faces = joined(ball(3), ball(2))
    with pytest.warns(LumitreeWarning, match="'glass': too many closed pieces"):
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


def test_a_fan_of_many_faces_takes_linear_time():
    count = 100_000
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rim = np.stack([np.cos(angle), np.zeros(count), np.sin(angle)], axis=1)
    positions = np.concatenate([[[0, 0.1, 0]], rim])
    faces = np.stack(
        [np.zeros(count, int), 1 + np.arange(count), 1 + (np.arange(count) + 1) % count], 1
    )
    found = normals_of(positions, faces[:, ::-1])
    np.testing.assert_allclose(np.abs(found[:, 2]), [[0, 1, 0]] * count, atol=1e-3)


def test_faces_without_area_do_no_harm():
    positions = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = normals_of(positions, faces)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1)
    np.testing.assert_allclose(found[1], [[0, 0, 1]] * 3)
