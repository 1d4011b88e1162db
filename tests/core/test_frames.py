"""Axioms of frames, placements and transforms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lumitree.core.frames import (
    placement,
    proxy_box,
    rotation,
    similarity,
    similarity_scale,
    towards_viewer,
)
from lumitree.errors import LumitreeError

finite = st.floats(-100, 100)
vector = st.tuples(finite, finite, finite).filter(lambda v: np.linalg.norm(v) > 1e-3)


@given(axis=vector, degrees=st.floats(-720, 720))
def test_rotations_are_orthogonal_and_invert(axis, degrees):
    turn = rotation(axis, degrees)
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1)
    assert rotation(axis, -degrees) @ turn == pytest.approx(np.eye(3), abs=1e-9)
    assert turn @ np.asarray(axis) == pytest.approx(np.asarray(axis), abs=1e-6)


def test_rotation_is_right_handed():
    assert rotation([0, 0, 1], 90) @ [1, 0, 0] == pytest.approx([0, 1, 0])


@given(axis=vector, degrees=st.floats(-180, 180), scale=st.floats(1e-3, 1e3), move=vector)
def test_similarity_scale_is_read_back(axis, degrees, scale, move):
    matrix = similarity(rotation(axis, degrees), scale, move)
    assert similarity_scale(matrix) == pytest.approx(scale)


@given(low=vector, size=st.tuples(*[st.floats(1e-2, 50)] * 3))
def test_proxy_box_has_longest_half_side_one(low, size):
    low, high = np.array(low), np.array(low) + size
    world_from_proxy, half = proxy_box(low, high)
    assert half.max() == pytest.approx(1)
    corners = world_from_proxy @ [[*half, 1], [*-half, 1]][0]
    if half.min() > 1e-3:
        assert corners[:3] == pytest.approx(high)
    # There and back again.
    point = np.array([*low, 1])
    assert world_from_proxy @ np.linalg.inv(world_from_proxy) @ point == pytest.approx(point)


def test_flat_luminaires_keep_an_inside():
    _, half = proxy_box([0, 0, 0], [2, 0, 2])
    assert half.tolist() == [1, 1e-3, 1]


@pytest.mark.parametrize(
    "box",
    [
        ([0, 0, 0], [0, 0, 0]),
        ([0, 0, 0], [1, np.inf, 1]),
        ([0, 0, 0], [1, np.nan, 1]),
        ([1, 1, 1], [0, 0, 0]),
    ],
)
def test_empty_boxes_are_refused(box):
    with pytest.raises(LumitreeError, match="bounding box"):
        proxy_box(*box)


def test_placement_puts_the_box_where_it_is_asked():
    own, half = proxy_box([10, 20, 30], [14, 22, 31])
    placed = placement(own, at=(1, 2, 3), size=0.5, rotate=(0, 1, 0, 90))
    centre = placed @ [0, 0, 0, 1]
    end = placed @ [half[0], 0, 0, 1]
    assert centre[:3] == pytest.approx([1, 2, 3])
    assert end[:3] == pytest.approx([1, 2, 3 - 0.25])
    assert placement(own) == pytest.approx(own)


@pytest.mark.parametrize("size", [0, -1, np.nan, np.inf])
def test_bad_sizes_are_refused(size):
    with pytest.raises(LumitreeError, match="is not a length"):
        placement(np.eye(4), size=size)


def test_rotation_without_axis_is_refused():
    with pytest.raises(LumitreeError, match="no direction"):
        rotation([0, 0, 0], 30)


def test_viewer_is_where_the_ray_came_from():
    assert towards_viewer(np.array([0, 0, -1.0])).tolist() == [0, 0, 1]
