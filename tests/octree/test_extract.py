"""Extraction from fields that are known in closed form."""

import numpy as np
import pytest

from lumitree.core.frames import LocalFrame
from lumitree.errors import LumitreeError
from lumitree.octree.build import leaf_cells
from lumitree.octree.extract import extract
from support.reference_field import leaf_boxes
from support.slow import slow


def ball(radius=0.6, density=5.0, num_coefficients=4):
    def query(positions):
        inside = np.linalg.norm(positions, axis=1) < radius
        coefficients = np.zeros((len(positions), 3, num_coefficients), np.float32)
        coefficients[:, 0, 0] = positions[:, 0]
        coefficients[:, 2, -1] = 2.0
        return (density * inside).astype(np.float32), coefficients

    return query


def as_asset(children, density, coefficients, tree_depth):
    from lumitree.asset.asset import Asset

    return Asset(
        children=children,
        density=density,
        coefficients=coefficients,
        tree_depth=tree_depth,
        l_max=int(np.sqrt(coefficients.shape[-1])) - 1,
        law="linear",
        max_radiance=1.0,
        frame=LocalFrame(np.ones(3), np.eye(4)),
        luminaire="ball",
    )


@pytest.mark.parametrize("tree_depth", [2, 3, 5, slow(6), slow(7)])
def test_ball(tree_depth):
    children, density, coefficients = extract(ball(), np.ones(3), tree_depth, samples_per_leaf=64)
    asset = as_asset(children, density, coefficients, tree_depth)
    lower, upper = leaf_boxes(asset)
    side = 2 / 2**tree_depth
    assert upper - lower == pytest.approx(side)
    centre = (lower + upper) / 2
    distance = np.linalg.norm(centre, axis=1)
    assert distance.max() < 0.6
    # Every cell whose centre is inside is there.
    count = 2**tree_depth
    grid = (np.arange(count) + 0.5) * side - 1
    cells = np.stack(np.meshgrid(grid, grid, grid), -1)
    assert len(density) == (np.linalg.norm(cells, axis=-1) < 0.6).sum()
    deep = distance < 0.6 - side
    assert (density[deep] == 5).all()
    assert (density[~deep] <= 5).all()
    assert coefficients[:, 0, 0].astype(float) == pytest.approx(
        centre[:, 0], abs=side * 0.05 + 1e-3
    )
    assert (coefficients[:, 2, -1] == 2).all()


def test_mass_is_kept():
    _, density, _ = extract(ball(), np.ones(3), 6)
    mass = density.sum() * (2 / 64) ** 3
    # Cells whose centre is outside are pruned, as the paper prunes: a little mass is lost.
    assert mass == pytest.approx(5 * 4 / 3 * np.pi * 0.6**3, rel=0.03)


def test_nothing_outside_the_box():
    children, density, coefficients = extract(ball(), np.array([1.0, 0.2, 1.0]), 5)
    lower, upper = leaf_boxes(as_asset(children, density, coefficients, 5))
    assert (np.minimum(np.abs(lower), np.abs(upper))[:, 1] < 0.2).all()


@pytest.mark.parametrize("depth", [6, 8])
def test_what_touches_a_face_of_a_flat_box_is_found(depth):
    """In cells of which less than a quarter is inside, and with the density that it has there."""
    half = np.array([1.0, 1.0, 0.1])

    def skin(positions):
        density = np.where(positions[:, 2] > 0.1 - 1 / 128, 1000, 0).astype(np.float32)
        return density, np.zeros((len(positions), 3, 1), np.float32)

    children, density, _ = extract(skin, half, depth)
    cells, _ = leaf_cells(children, len(density))
    top = cells[:, 2] == int(1.1 * (1 << depth) / 2)
    assert top.sum() == (1 << depth) ** 2
    assert (density[top] == 1000).all()


def test_chunks_do_not_change_the_result(monkeypatch):
    whole = extract(ball(), np.ones(3), 5, samples_per_leaf=32)
    monkeypatch.setattr("lumitree.octree.extract._CHUNK", 1000)
    for a, b in zip(whole, extract(ball(), np.ones(3), 5, samples_per_leaf=32), strict=True):
        assert np.array_equal(a, b)


def test_queries_are_bounded(monkeypatch):
    sizes = []

    def query(positions):
        sizes.append(len(positions))
        return ball()(positions)

    monkeypatch.setattr("lumitree.octree.extract._CHUNK", 5000)
    extract(query, np.ones(3), 6, samples_per_leaf=256)
    assert max(sizes) <= 5000


@pytest.mark.parametrize("tree_depth", [0, 11])
def test_bad_depths_are_refused(tree_depth):
    with pytest.raises(LumitreeError, match="expected 1 to 10"):
        extract(ball(), np.ones(3), tree_depth)


def test_empty_fields_are_refused():
    with pytest.raises(LumitreeError, match="the field is empty"):
        extract(ball(density=0.005), np.ones(3), 4)
