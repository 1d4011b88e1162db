"""Halton directions and the views along them."""

import numpy as np
import pytest

from lumitree.core.directions import (
    FIRST_TEST_INDEX,
    halton_direction,
    orthographic_rays,
    radical_inverse,
    view_pose,
)


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
