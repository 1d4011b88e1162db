"""Axioms of frames, placements and transforms; Halton directions and the views along them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lumitree.core.frames import (
    FIRST_TEST_INDEX,
    LocalFrame,
    from_viewer,
    halton_direction,
    orthographic_rays,
    radical_inverse,
    rotation,
    similarity,
    similarity_scale,
    towards_viewer,
    view_pose,
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
def test_local_frame_of_a_box_has_longest_half_side_one(low, size):
    low, high = np.array(low), np.array(low) + size
    frame = LocalFrame.of_box(low, high)
    half = frame.half_extents
    assert half.max() == pytest.approx(1)
    corners = frame.world_from_local @ [[*half, 1], [*-half, 1]][0]
    if half.min() > 1e-3:
        assert corners[:3] == pytest.approx(high)
    # There and back again.
    point = np.array([*low, 1])
    assert frame.world_from_local @ frame.local_from_world @ point == pytest.approx(point)
    assert frame.size[half == 1] == pytest.approx(max(size))
    assert frame.centre == pytest.approx((low + high) / 2)
    # Exactly: what is derived from the scale of a box does not depend on its rounding.
    assert frame.scale == frame.world_from_local[0, 0]
    assert np.array_equal(frame.rotation, np.eye(3))


def test_flat_luminaires_keep_an_inside():
    frame = LocalFrame.of_box([0, 0, 0], [2, 0, 2])
    assert frame.half_extents.tolist() == [1, 1e-3, 1]


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
        LocalFrame.of_box(*box)


def test_placement_puts_the_box_where_it_is_asked():
    own = LocalFrame.of_box([10, 20, 30], [14, 22, 31])
    placed = own.placed(at=(1, 2, 3), size=0.5, rotate=(0, 1, 0, 90))
    centre = placed @ [0, 0, 0, 1]
    end = placed @ [own.half_extents[0], 0, 0, 1]
    assert centre[:3] == pytest.approx([1, 2, 3])
    assert end[:3] == pytest.approx([1, 2, 3 - 0.25])
    assert own.placed() == pytest.approx(own.world_from_local)


def test_scale_and_rotation_of_a_turned_frame():
    turn = rotation([1, 2, 3], 40)
    frame = LocalFrame([1, 0.5, 0.25], similarity(turn, 2.5, [3, -1, 7]))
    assert frame.scale == pytest.approx(2.5)
    assert frame.rotation == pytest.approx(turn)
    assert frame.size == pytest.approx([5, 2.5, 1.25])


@pytest.mark.parametrize(
    ("half_extents", "matrix", "message"),
    [
        ([1, 1], np.eye(4), "half_extents are"),
        ([0.5, 0.5, 0.5], np.eye(4), "the longest 1"),
        ([1, 1, 1e-4], np.eye(4), "0.001 or more"),
        ([1, 1, np.nan], np.eye(4), "0.001 or more"),
        ([1, 1, 1], np.eye(3), "4 x 4 numbers"),
        ([1, 1, 1], np.diag([1e13, 1e13, 1e13, 1]), "at most 1e"),
        ([1, 1, 1], np.diag([1, 1, -1, 1]), "mirrors"),
        ([1, 1, 1], np.diag([1, 1, 2, 1]), "shears"),
        ([1, 1, 1], np.diag([1e-13, 1e-13, 1e-13, 1]), "has the scale 1e-13"),
    ],
)
def test_what_is_no_local_frame_is_refused(half_extents, matrix, message):
    with pytest.raises(LumitreeError, match=message):
        LocalFrame(half_extents, matrix)


def test_equal_frames_are_equal_and_do_not_change():
    half, matrix = np.ones(3), np.eye(4)
    frame = LocalFrame(half, matrix)
    matrix[0, 3] = 1
    assert frame == LocalFrame(half, np.eye(4))
    assert hash(frame) == hash(LocalFrame(half, np.eye(4)))
    assert frame != LocalFrame(half, matrix)
    with pytest.raises(ValueError, match="read-only"):
        frame.world_from_local[0, 3] = 2


@pytest.mark.parametrize("size", [0, -1, np.nan, np.inf])
def test_bad_sizes_are_refused(size):
    with pytest.raises(LumitreeError, match="is not a length"):
        LocalFrame(np.ones(3), np.eye(4)).placed(size=size)


def test_rotation_without_axis_is_refused():
    with pytest.raises(LumitreeError, match="no direction"):
        rotation([0, 0, 0], 30)


def test_viewer_is_where_the_ray_came_from():
    assert towards_viewer(np.array([0, 0, -1.0])).tolist() == [0, 0, 1]
    assert from_viewer(towards_viewer(np.array([1, 2, 3]))).tolist() == [1, 2, 3]


def test_radical_inverse():
    assert [radical_inverse(i, 2) for i in range(5)] == [0, 0.5, 0.25, 0.75, 0.125]
    assert radical_inverse(5, 3) == pytest.approx(2 / 3 + 1 / 9)


@pytest.mark.parametrize("first", [1, FIRST_TEST_INDEX])
def test_directions_cover_the_sphere(first):
    directions = np.array([halton_direction(i) for i in range(first, first + 200)])
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1)
    assert np.abs(directions.mean(axis=0)).max() < 0.03
    assert directions.T @ directions / 200 == pytest.approx(np.eye(3) / 3, abs=0.03)


@pytest.mark.parametrize("index", [1, 2, 3, 17, 100_001])
def test_poses_look_at_the_origin(index):
    pose = view_pose(index, 3.0)
    assert pose[:3, :3].T @ pose[:3, :3] == pytest.approx(np.eye(3))
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    origins, direction = orthographic_rays(pose, 1.0, 4)
    assert pose[:3, 3] + 3 * direction == pytest.approx(0, abs=1e-6)
    # Row 0 is the top, column 0 the left.
    assert (origins[0, 0] - origins[-1, 0]) @ pose[:3, 1] == pytest.approx(1.5)
    assert (origins[0, -1] - origins[0, 0]) @ pose[:3, 0] == pytest.approx(1.5)


def test_poles_have_poses():
    assert np.isfinite(view_pose(0, 1.0)).all()
