"""Leaves drawn by their light: how often, from which groups, and where in them."""

import numpy as np
import pytest

from lumitree.octree.build import leaf_cells
from lumitree.rendering.light_leaves import NUM_GROUPS, _group, _multiplicity, light_leaves
from support.fields import make_asset, random_asset

HALF = np.array([1.0, 0.7, 0.4])


@pytest.mark.parametrize("half", [np.ones(3), HALF])
def test_leaves_are_drawn_as_often_as_their_density_says(mi, half):
    """The list against the numbers that densities are made of, for leaves cut by the box too."""
    import drjit as dr

    from lumitree.octree.field import Field

    field = Field(random_asset(0, half_extents=half))
    leaves, count = light_leaves(field), 1 << 18
    x = mi.Point3f(*(dr.opaque(mi.Float, value) for value in (3.0, 2.0, 1.0)))
    random = mi.PCG32(count)
    point = leaves.sample(x, mi.Point2f(random.next_float32(), random.next_float32()), True)
    inside = np.abs(np.array(point).T) <= half + 1e-6
    assert inside.all()
    leaf, found = field._octree.find_leaf(point)
    drawn = np.bincount(np.array(leaf)[np.array(found)], minlength=field.asset.num_leaves) / count
    # The density of a stretch of length h at r, seen from far away, is p h r² / V.
    cells, levels = leaf_cells(field.asset.children, field.asset.num_leaves)
    side = 2.0 / (1 << levels)[:, None]
    lower, upper = np.maximum(cells * side - 1, -half), np.minimum((cells + 1) * side - 1, half)
    volume = np.maximum(upper - lower, 0).prod(axis=1)
    add, state = leaves.record(x, 1e3)
    index = dr.arange(mi.UInt32, field.asset.num_leaves)
    density, _ = add(state, index, mi.Float(0), mi.Float(1e-2), mi.Bool(True))
    expected = np.array(density) / 1e-2 / 1e6 * volume
    assert expected.sum() == pytest.approx(1, abs=1e-4)
    assert (np.abs(drawn - expected) < 5 * np.sqrt(expected / count) + 1e-4).all()


def test_a_leaf_that_is_hidden_or_dark_is_hardly_drawn(mi):
    from lumitree.octree.field import Field

    # From below: an opaque dark plate hides a bright cell; beside them a bright one stands free.
    plate = np.array([(x, 2, z) for x in range(2, 5) for z in range(2, 5)])
    cells = np.concatenate([[(3, 3, 3), (6, 3, 3)], plate])
    coefficients = np.full((len(cells), 3, 1), -40.0)
    coefficients[:2] = 10.0
    asset = make_asset(cells, np.full(len(cells), 3), np.full(len(cells), 1e3), coefficients)
    field = Field(asset)
    random = mi.PCG32(1 << 14)
    sample = mi.Point2f(random.next_float32(), random.next_float32())
    point = light_leaves(field).sample(mi.Point3f(0, -6, 0), sample, True)
    leaf, _ = field._octree.find_leaf(point)
    drawn = np.bincount(np.array(leaf), minlength=len(cells)) / (1 << 14)
    lowest = np.argsort(cells[:, 1], kind="stable")
    assert drawn[1] > 0.75
    assert drawn[0] < 0.2
    assert drawn[lowest[: len(plate)]].sum() < 0.1


def test_groups_are_few_and_lights_far_apart_are_in_different_ones():
    random = np.random.default_rng(1)
    cells = random.integers(0, 256, (5000, 3))
    levels = np.full(len(cells), 8)
    power = random.uniform(0, 1, len(cells)) ** 8
    group = _group(cells, levels, power)
    assert group.min() == 0
    assert group.max() == NUM_GROUPS - 1
    light = np.bincount(group, power)
    assert light.min() > 0
    assert light.max() < 4 * light.mean()
    two = np.array([[2, 2, 2], [200, 200, 200], [3, 2, 2]])
    first, second, third = _group(two, np.full(3, 8), np.ones(3))
    assert first == third != second


def test_multiplicity_are_as_many_as_they_must_and_follow_the_light():
    random = np.random.default_rng(2)
    group, power = random.integers(0, 5, 2000), random.uniform(0, 1, 2000)
    power[7] = 500.0
    places = _multiplicity(power, group)
    assert (places >= 0).all()
    assert places.sum() == pytest.approx(4 * len(power), abs=1)
    members = np.bincount(group)[group[7]]
    light = power[group == group[7]].sum()
    assert places[7] == pytest.approx(4 * (0.2 + 0.8 * members * 500 / light), abs=1.01)
