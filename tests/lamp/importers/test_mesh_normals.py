"""Shading normals are smooth except at creases, and follow faces that are turned."""

import warnings

import numpy as np
import trimesh

from lumitree.lamp.importers.topology import (
    Pieces,
    crease_normals,
    face_normals,
    turned_with_normals,
)
from lumitree.lamp.meshes import Mesh


def ball():
    mesh = trimesh.creation.icosphere(subdivisions=2)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


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
