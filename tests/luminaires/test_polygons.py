"""Triangles cover their polygon exactly, whatever its shape and plane."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumitree.luminaires.polygons import triangulate


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
    triangles = triangulate(points[None])[0]
    assert triangles.shape == (len(flat) - 2, 3)
    vectors = area_vectors(points, triangles)
    total = newell(points)
    # All wound like the polygon, and no more area than it has: no overlap, nothing outside.
    assert (vectors @ total > -1e-12 * (total @ total)).all()
    assert np.linalg.norm(vectors, axis=1).sum() == pytest.approx(np.linalg.norm(total))
    return np.linalg.norm(vectors, axis=1)


def test_concave_shapes():
    check([[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]])
    check([[0, 0], [2, 1], [4, 0], [2, 4]])
    angle = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    radius = np.where(np.arange(30) % 2, 1.0, 0.2)
    check(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))
    check(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)[::-1])


def test_comb():
    teeth = [[x, 3 if (x % 2) else 1] for x in range(20, -1, -1)]
    check([[0, 0], [20, 0], *teeth])


def test_corners_on_an_edge_leave_no_empty_triangle():
    areas = check([[0, 0], [1, 0], [2, 0], [3, 0], [3, 2], [0, 2]])
    assert areas.min() > 0.1


def test_outline_with_a_hole_cut_to():
    hole = [[1, 1], [1, 3], [3, 3], [3, 1]]
    check([[0, 0], [4, 0], [4, 4], [0, 4], [0, 0], *hole, hole[0]])


@settings(deadline=None, max_examples=60)
@given(st.integers(4, 40), st.integers(0, 10_000))
def test_any_star_shaped_polygon(corners, seed):
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * (np.arange(corners) + rng.uniform(0, 0.9, corners)) / corners
    radius = rng.uniform(0.1, 1, corners)
    check(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))


def test_crossing_and_empty_polygons_still_end():
    bow = np.array([[[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]]], float)
    assert triangulate(bow).shape == (1, 2, 3)
    assert triangulate(np.zeros((2, 6, 3))).shape == (2, 4, 3)


def test_many_at_once_are_cut_one_by_one():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    dart = np.array([[0, 0, 0], [2, 1, 0], [4, 0, 0], [2, 4, 0]], float)
    both = triangulate(np.stack([square, dart, square]))
    np.testing.assert_array_equal(both[0], both[2])
    np.testing.assert_array_equal(both[1], triangulate(dart[None])[0])
