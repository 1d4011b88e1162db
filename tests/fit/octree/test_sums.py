"""Sums on the device are exact: independent of order, and as precise as single precision."""

import numpy as np
import pytest

from lumitree.core.device import on_device
from lumitree.errors import LumitreeError

COUNT, SUMS = 1 << 16, 5


def contributions(seed):
    """Values of many magnitudes, and the sums that they are added to."""
    random = np.random.default_rng(seed)
    values = random.normal(size=COUNT) * 10.0 ** random.uniform(-8, 3, COUNT)
    return values.astype(np.float32), random.integers(0, SUMS, COUNT)


def summed(mi, values, index, bound=None):
    from lumitree.fit.octree.sums import ExactSum, total_of

    values, index = on_device(mi.Float, values), on_device(mi.UInt32, index)
    total = ExactSum(SUMS, total_of(COUNT, values) if bound is None else bound)
    total.add(values, index)
    return np.array(total.values())


@pytest.mark.parametrize("scale", [1e-30, 1e-12, 1.0, 1e12, 1e30])
def test_sums_are_those_of_double_precision(mi, scale):
    values, index = contributions(0)
    values *= np.float32(scale)
    expected = np.bincount(index, values.astype(np.float64))
    assert summed(mi, values, index) == pytest.approx(expected, rel=1e-6)


def test_order_does_not_matter(mi):
    values, index = contributions(1)
    first = summed(mi, values, index)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(COUNT)
        assert np.array_equal(summed(mi, values[order], index[order]), first)


def test_small_values_beside_a_large_one_are_kept(mi):
    values = np.full(COUNT, 1e-9, np.float32)
    values[0] = 1e6
    index = np.ones(COUNT, np.uint32)
    index[0] = 0
    found = summed(mi, values, index)
    assert found[:2] == pytest.approx([1e6, COUNT * 1e-9], rel=1e-4)


def test_masked_values_are_left_out(mi):
    from lumitree.fit.octree.sums import ExactSum

    total = ExactSum(2, 10.0)
    total.add(mi.Float([1, 2, 3]), mi.UInt32([0, 0, 1]), mi.Bool([True, False, True]))
    total.add(mi.Float([0.5]), mi.UInt32([1]))
    assert np.array(total.values()).tolist() == [1, 3.5]


def test_four_neighbours_at_once(mi):
    from lumitree.fit.octree.sums import ExactSum

    total = ExactSum(8, 100.0)
    total.add(mi.Vector4f([1, 5], [2, 6], [3, 7], [4, 8]), mi.UInt32([0, 0]))
    total.add(mi.Vector4f(1, 1, 1, 1), mi.UInt32([1]))
    assert np.array(total.values()).tolist() == [6, 8, 10, 12, 1, 1, 1, 1]


def test_nothing_sums_to_nothing(mi):
    assert (summed(mi, np.zeros(COUNT), np.zeros(COUNT, int)) == 0).all()


@pytest.mark.parametrize("bound", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(mi, bound):
    with pytest.raises(LumitreeError, match="NaN or infinity"):
        summed(mi, np.ones(COUNT), np.zeros(COUNT, int), bound)


def test_the_bound_counts_a_value_that_all_rays_share(mi):
    from lumitree.fit.octree.sums import total_of

    assert total_of(4, mi.Float([1, -2, 3, 4])) == 10
    assert total_of(4, mi.Float(-2)) == 8
    assert total_of(4, mi.Color3f(1, -2, 3), mi.Float([1, 0, 0, -1])) == 26
