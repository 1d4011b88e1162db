"""Triangles cover their polygon exactly, whatever its shape and plane."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumitree.lamp.importers.polygons import triangulate
from lumitree.lamp.importers.topology import Pieces


def area_vectors(points, triangles):
    a, b, c = points[triangles].transpose(1, 0, 2)
    return np.cross(b - a, c - a) / 2


def newell(points):
    return np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0) / 2


def in_space(flat):
    """The plane polygon [N, 2] somewhere in space."""
    rotation, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    return np.column_stack([flat, np.zeros(len(flat))]) @ rotation.T + [3.0, -2.0, 7.0]


def check(flat):
    points = in_space(np.asarray(flat, float))
    triangles, polygon = triangulate(points[None])
    assert (polygon == 0).all()
    outlined(triangles, len(flat))
    vectors = area_vectors(points, triangles)
    total = newell(points)
    area = np.linalg.norm(total)
    # All wound like the polygon, and no more area than it has: no overlap, nothing outside.
    assert (vectors @ total > -1e-9 * area**2).all()
    areas = np.linalg.norm(vectors, axis=1)
    assert areas.sum() == pytest.approx(area)
    return areas / area


def outlined(triangles, size):
    """The triangles' outline is the polygon's, so that neighbours share its edges."""
    edges = Counter()
    for a, b, c in triangles.tolist():
        for start, stop in ((a, b), (b, c), (c, a)):
            edges[start, stop] += 1
            edges[stop, start] -= 1
    expected = {(at, (at + 1) % size): 1 for at in range(size)}
    assert {edge: count for edge, count in edges.items() if count > 0} == expected


def test_concave_shapes():
    check([[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]])
    check([[0, 0], [2, 1], [4, 0], [2, 4]])
    angle = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    radius = np.where(np.arange(30) % 2, 1.0, 0.2)
    check(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))
    check(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)[::-1])


def test_corners_on_an_edge_are_used_and_leave_no_empty_triangle():
    areas = check([[0, 0], [1, 0], [2, 0], [3, 0], [3, 2], [0, 2]])
    assert len(areas) == 4
    assert areas.min() > 0.1


@pytest.mark.parametrize("noise", [0, 1e-16, 1e-13, 1e-10])
def test_what_lies_in_line_leaves_no_empty_triangle(noise):
    """Ends of teeth in one line, and corners on edges; whatever the last bits say."""
    outline = [[0, 0], [7, 0], [7, 3], [6, 3], [6, 1], [5, 1], [5, 3], [4, 3], [4, 1], [3, 1]]
    outline += [[3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3], [0, 2], [0, 1]]
    rng = np.random.default_rng(4)
    for turn in range(len(outline)):
        rolled = np.roll(np.array(outline, float), turn, axis=0)
        areas = check(rolled + noise * rng.normal(size=rolled.shape))
        assert areas.min() > 1e-4


@settings(max_examples=60)
@given(st.integers(4, 40), st.integers(0, 10_000))
def test_any_star_shaped_polygon(corners, seed):
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * (np.arange(corners) + rng.uniform(0, 0.9, corners)) / corners
    radius = rng.uniform(0.1, 1, corners)
    check(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))


def test_crossing_and_empty_polygons_still_end():
    bow = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]], float)
    triangles, _ = triangulate(bow[None])
    outlined(triangles, 4)
    assert np.linalg.norm(area_vectors(bow, triangles), axis=1).max() >= 0.25
    for flat in (np.zeros((6, 3)), np.arange(6)[:, None] * np.ones(3)):
        outlined(triangulate(flat[None])[0], 6)


@settings(max_examples=200)
@given(st.integers(4, 24), st.integers(2, 6), st.integers(0, 10_000))
def test_any_corners_keep_their_outline(corners, side, seed):
    """On a coarse grid, where edges cross, overlap, and meet in points."""
    rng = np.random.default_rng(seed)
    points = rng.integers(0, side, (corners, 3)) * [1, 1, rng.integers(0, 2)]
    outlined(triangulate(points[None].astype(float))[0], corners)


def test_neighbours_of_a_corner_on_an_edge_stay_joined():
    """A box whose top edge is divided for two faces at its side: the piece is closed."""
    points = [[x, y, z] for x in (0, 2) for y in (0, 1) for z in (0, 1)] + [[1, 1, 0]]
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6, 8]]
    faces += [[1, 5, 7, 3], [0, 2, 8], [0, 8, 6, 4]]
    cut = []
    for face in faces:
        corners = np.array(face)
        cut.append(corners[triangulate(np.array(points, float)[corners][None])[0]])
    pieces = Pieces(np.concatenate(cut))
    assert pieces.closed.tolist() == [True]
