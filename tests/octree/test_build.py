"""Node tables from lists of leaves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lumitree.errors import LumitreeError
from lumitree.octree.build import build_children, child_cells, morton
from support.fields import make_asset, random_asset
from support.reference_field import integrate_ray, leaf_boxes


@given(st.lists(st.tuples(*[st.integers(0, 1023)] * 3), min_size=1, max_size=50))
def test_morton_interleaves_bits(cells):
    def spell(cell):
        return sum(
            (cell[axis] >> bit & 1) << (3 * bit + axis) for bit in range(10) for axis in range(3)
        )

    assert morton(cells).tolist() == [spell(cell) for cell in cells]


def test_child_cells_are_in_octant_order():
    children = child_cells(np.array([[1, 2, 3], [0, 0, 0]]))
    assert children.shape == (2, 8, 3)
    assert (children[0] >> 1 == [1, 2, 3]).all()
    assert children[0, :3].tolist() == [[2, 4, 6], [3, 4, 6], [2, 5, 6]]
    assert (children[1] @ [1, 2, 4] == np.arange(8)).all()


@given(seed=st.integers(0, 1000))
def test_leaves_are_where_they_were_put(seed):
    random = np.random.default_rng(seed)
    depth = random.integers(1, 6)
    cells = np.unique(random.integers(0, 2**depth, (20, 3)), axis=0)
    random.shuffle(cells)
    asset = make_asset(
        cells,
        np.full(len(cells), depth),
        np.ones(len(cells)),
        np.zeros((len(cells), 3, 1)),
        tree_depth=int(depth),
    )
    lower, upper = leaf_boxes(asset)
    side = 2 / 2**depth
    assert lower == pytest.approx(cells * side - 1)
    assert upper == pytest.approx((cells + 1) * side - 1)


def test_no_leaves_is_an_empty_root():
    assert build_children(np.zeros((0, 3)), np.zeros(0)).tolist() == [[0] * 8]


def test_overlaps_are_refused():
    with pytest.raises(LumitreeError, match="overlap at level 2"):
        build_children([[1, 1, 1], [1, 1, 1]], [2, 2])
    with pytest.raises(LumitreeError, match="overlap at level 1"):
        build_children([[0, 0, 0], [0, 0, 0]], [1, 2])


@pytest.mark.parametrize(
    ("law", "density", "expected"),
    [("linear", 0.25, 0.5), ("linear", 3.0, 0.0), ("exponential", 0.25, np.exp(-0.5))],
)
def test_reference_against_closed_form(law, density, expected):
    """A cube of constant density and emission: T(2 sigma), and (1 - T) Phi."""
    from support.fields import uniform_asset

    asset = uniform_asset(density, [4.0, 2.0, 1.0], law=law)
    radiance, through = integrate_ray(asset, np.array([0.3, 0.2, -5]), np.array([0, 0, 1.0]))
    assert through == pytest.approx(expected)
    assert radiance == pytest.approx((1 - expected) * np.array([4.0, 2.0, 1.0]), rel=2e-3)


def test_random_assets_are_valid_and_varied():
    levels = set()
    for seed in range(5):
        lower, upper = leaf_boxes(random_asset(seed))
        levels |= set(np.round(np.log2(2 / (upper - lower)[:, 0])).astype(int))
    assert levels == {1, 2, 3, 4}
