"""The trainable field: its integral against the renderer and the reference implementation."""

import numpy as np
import pytest

from lumitree.core.device import on_device
from support import reference_field as reference
from support.field_rays import NUM_RAYS, rays_on_device, targeted_rays
from support.fields import leaf_field, make_asset, random_asset


@pytest.mark.parametrize("law", ["linear", "exponential"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_integral_agrees_with_renderer_and_reference(mi, law, seed):
    from lumitree.octree.field import Field

    half = np.array([1.0, 0.61, 0.37]) if seed == 1 else np.ones(3)
    asset = random_asset(seed, l_max=seed - 1, law=law, density_scale=0.7, half_extents=half)
    origins, directions = targeted_rays(seed)
    o, d = rays_on_device(mi, origins, directions)
    radiance, through, _ = (np.array(value).T for value in leaf_field(asset).integrate(o, d))
    rendered, rendered_through = (np.array(value).T for value in Field(asset).emission(o, d))
    # Leaves with a weight below 1e-4 are left out; a ray crosses few of them.
    assert radiance == pytest.approx(rendered / asset.max_radiance, abs=1e-3)
    assert through == pytest.approx(rendered_through, abs=1e-6)
    for i in range(NUM_RAYS):
        expected, expected_through = reference.integrate_ray(
            asset, origins[i].astype(float), directions[i].astype(float)
        )
        assert radiance[i] == pytest.approx(expected / asset.max_radiance, abs=2e-3)
        assert through[i] == pytest.approx(expected_through, abs=1.2e-3)


def test_meets_is_true_of_rays_that_cross_a_leaf(mi):
    asset = random_asset(9, tree_depth=3)
    lower, upper = reference.leaf_boxes(asset)
    random = np.random.default_rng(9)
    directions = random.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = random.uniform(-1.5, 1.5, (400, 3))
    first = (lower - origins[:, None]) / directions[:, None]
    second = (upper - origins[:, None]) / directions[:, None]
    length = np.maximum(first, second).min(axis=2) - np.minimum(first, second).max(axis=2)
    # Rays that graze an edge may go either way in single precision.
    clear = np.abs(length.max(axis=1)) > 1e-4
    expected = length.max(axis=1) > 0
    met = np.array(leaf_field(asset).meets(*rays_on_device(mi, origins, directions)))
    assert (met == expected)[clear].all()
    assert 0.05 < expected[clear].mean() < 0.95


def test_find_leaf_is_the_leaf_whose_box_holds_the_point(mi):
    asset = random_asset(11, tree_depth=3)
    lower, upper = reference.leaf_boxes(asset)
    random = np.random.default_rng(11)
    points = random.uniform(-1.2, 1.2, (2000, 3)).astype(np.float32)
    # Corners belong to the leaf above them, as intervals are half open.
    points = np.concatenate([points, lower, [[0, -1.0001, 0]]]).astype(np.float32)
    holds = ((points[:, None] >= lower) & (points[:, None] < upper)).all(axis=2)
    holds &= (np.abs(points) <= asset.frame.half_extents).all(axis=1, keepdims=True)
    leaf, found = (
        np.array(value)
        for value in leaf_field(asset).octree.find_leaf(on_device(mi.Point3f, points))
    )
    assert np.array_equal(found, holds.any(axis=1))
    assert np.array_equal(leaf[found], holds.argmax(axis=1)[found])
    assert 0 < found.sum() < len(points)


def test_what_lies_on_the_border_is_found_within(mi):
    """Give or take a rounding, whether or not the border is one of the cells."""
    half = np.array([1, 0.5, 0.4])
    cells = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), -1).reshape(-1, 3)
    asset = make_asset(
        cells, np.full(512, 3), np.ones(512), np.zeros((512, 3, 1)), half_extents=half
    )
    octree = leaf_field(asset).octree
    for axis in range(3):
        for side in (-1, 1):
            # Within, about the border, and beyond.
            points = np.full((5, 3), 0.1, np.float32)
            points[:, axis] = side * (half[axis] + np.array([-0.01, -1e-6, 0, 1e-6, 1e-3]))
            leaf, found = octree.find_leaf(on_device(mi.Point3f, points))
            assert np.array(found).tolist() == [True] * 4 + [False]
            assert (np.array(leaf)[:4] == np.array(leaf)[0]).all()


def test_find_leaf_leaves_masked_points_alone(mi):
    asset = random_asset(11, tree_depth=3)
    centre = reference.leaf_boxes(asset)[0][:2] + 1e-3
    octree = leaf_field(asset).octree
    _, found = octree.find_leaf(on_device(mi.Point3f, centre), mi.Bool([True, False]))
    assert np.array(found).tolist() == [True, False]


def neighbours(asset):
    """Leaf [M, 6] across the middle of each face, -1 where there is none, by search."""
    lower, upper = reference.leaf_boxes(asset)
    finest = 2.0 ** (1 - asset.tree_depth)
    found = np.full((len(lower), 6), -1)
    for i in range(len(lower)):
        for face in range(6):
            axis, above = divmod(face, 2)
            # The finest cell that touches the middle from beyond, and above.
            point = (lower[i] + upper[i] + finest) / 2
            if (upper - lower)[i, 0] == finest:
                point = (lower[i] + upper[i]) / 2
            point[axis] = (upper[i] if above else lower[i])[axis] + (above - 0.5) * finest
            holds = np.flatnonzero(((point > lower) & (point < upper)).all(axis=1))
            if len(holds):
                found[i, face] = holds[0]
    return found


def test_neighbours_are_the_leaves_beyond_the_faces(mi):
    asset = random_asset(12, tree_depth=3)
    expected = neighbours(asset)
    for face, (leaf, there) in enumerate(leaf_field(asset).neighbours):
        leaf, there = np.array(leaf), np.array(there)
        assert np.array_equal(there, expected[:, face] >= 0)
        assert np.array_equal(leaf[there], expected[there, face])
    assert 0.1 < (expected >= 0).mean() < 0.9


@pytest.mark.parametrize("l_max", [0, 1, 2])
def test_smoothing_regularises_leaves_towards_their_neighbours(mi, l_max):
    """A leaf that has none stays as it is."""
    asset = random_asset(12, tree_depth=3, l_max=l_max)
    index = neighbours(asset)
    there = index >= 0
    field = leaf_field(asset)
    before = field.coefficient_array()
    field.smooth(0.3)
    mean = np.where(there[..., None, None], before[index], 0).sum(axis=1)
    mean /= np.maximum(there.sum(axis=1), 1)[:, None, None]
    alone = ~there.any(axis=1)
    expected = np.where(alone[:, None, None], before, 0.7 * before + 0.3 * mean)
    assert field.coefficient_array() == pytest.approx(expected, abs=1e-5)
    assert np.abs(field.coefficient_array() - before).max() > 0.1
