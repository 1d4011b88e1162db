"""A coarse field transmits what the deep one does on average."""

import numpy as np
import pytest

from lumitree.core.frames import LocalFrame
from lumitree.octree.build import child_cells, leaf_cells
from lumitree.octree.field import COARSE_DEPTH, coarsened
from support.fields import make_asset, random_asset

SIDE = 2.0 / (1 << COARSE_DEPTH)


def density_of(cells, levels, density, **fields):
    """Density of the coarse field of an asset with these leaves."""
    asset = make_asset(
        cells, levels, density, np.zeros((len(cells), 3, 1)), tree_depth=10, **fields
    )
    return coarsened(asset)


def below(cell, steps):
    """All cells that are `steps` levels below a cell, one level a step."""
    cells = np.array([cell])
    for _ in range(steps):
        cells = child_cells(cells).reshape(-1, 3)
    return cells


@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_larger_leaves_stay(law):
    found = density_of([[1, 2, 3], [0, 0, 0]], [3, COARSE_DEPTH], [0.5, 2.0], law=law)
    cells, levels = leaf_cells(found.children, found.num_leaves)
    assert cells.tolist() == [[1, 2, 3], [0, 0, 0]]
    assert levels.tolist() == [3, COARSE_DEPTH]
    sides = np.array([0.25, SIDE])
    passed = 1 - np.array([0.5, 2.0]) * sides if law == "linear" else None
    expected = [0.5, 2.0] if passed is None else -np.log(passed) / sides
    assert found.density == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("steps", [1, 2, 3, 4, 5])
def test_a_cell_that_is_filled_evenly_keeps_its_density(steps):
    cells = below([9, 17, 30], steps)
    levels = np.full(len(cells), COARSE_DEPTH + steps)
    found = density_of(cells, levels, np.full(len(cells), 3.0), law="exponential")
    cell, level = leaf_cells(found.children, found.num_leaves)
    assert (cell.tolist(), level.tolist()) == ([[9, 17, 30]], [COARSE_DEPTH])
    assert found.density == pytest.approx([3.0], rel=1e-5)


def test_a_black_half_of_a_cell_hides_the_lines_that_cross_it():
    """None of the lines along x, half of those along y and z pass: a third of all."""
    cells = below([4, 5, 6], 1)
    cells = cells[cells[:, 0] % 2 == 0]
    found = density_of(cells, np.full(4, COARSE_DEPTH + 1), np.full(4, 1e6), law="exponential")
    assert np.exp(-found.density * SIDE) == pytest.approx([1 / 3], rel=1e-5)


@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_cells_at_the_faces_of_a_flat_box_are_opaque(law):
    """Rays cross them within the box only, where the leaves fill them."""
    frame = LocalFrame(np.array([1.0, 1.0, 0.033]), np.eye(4))
    cells = np.stack(np.meshgrid(*[np.arange(8)] * 2, np.arange(123, 133), indexing="ij"), -1)
    cells = cells.reshape(-1, 3)
    found = density_of(
        cells, np.full(len(cells), 8), np.full(len(cells), 400.0), law=law, frame=frame
    )
    assert len(found.density) == 2
    # Half of the box is in each of both layers.
    assert (np.exp(-found.density * 0.033) < 1e-3).all()


def test_leaves_below_the_smallest_density_are_empty():
    cells = below([4, 5, 6], 1)
    density = np.where(cells[:, 0] % 2 == 0, 0.0, 4.0)
    levels = np.full(8, COARSE_DEPTH + 1)
    fields = {"law": "exponential", "tree_depth": 10}
    asset = make_asset(cells, levels, density, np.zeros((8, 3, 1)), **fields)
    through = np.exp(-2.0 * SIDE), (1 + np.exp(-4.0 * SIDE)) / 2
    expected = -np.log((through[0] + 2 * through[1]) / 3) / SIDE
    assert coarsened(asset).density == pytest.approx([expected], rel=1e-5)


def test_opaque_cells_have_a_finite_density():
    found = density_of(below([0, 0, 0], 1), np.full(8, COARSE_DEPTH + 1), np.full(8, 1e9))
    assert np.isfinite(found.density).all()
    assert np.exp(-found.density * SIDE) < 1e-3


def test_mean_transmittance_of_random_lines(mi):
    """Within 0.03 of the deep field's, though a single line may differ by far more."""
    from lumitree.core.device import on_device
    from lumitree.octree.field import Field

    asset = random_asset(3, tree_depth=7, density_scale=12.0, law="exponential")
    small = coarsened(asset)
    assert small.num_leaves < asset.num_leaves / 4
    random = np.random.default_rng(4)
    direction = random.normal(size=(20000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    origin = random.uniform(-1, 1, (20000, 3)) - 4 * direction
    line = on_device(mi.Point3f, origin), on_device(mi.Vector3f, direction)
    deep, coarse = (np.array(each.transmittance(*line)) for each in map(Field, (asset, small)))
    assert 0.1 < deep.mean() < 0.9
    assert coarse.mean() == pytest.approx(deep.mean(), abs=0.03)


def test_a_shallow_field_is_its_own_coarse_field(mi):
    from lumitree.rendering.device import DeviceAsset

    device = DeviceAsset(random_asset(3))
    assert device.coarse_field is device.field
