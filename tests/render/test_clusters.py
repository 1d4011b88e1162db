"""Boxes around what shines on a grid."""

import numpy as np
import pytest

from lumitree.render.clusters import cluster_cells

CELL = np.array([0.1, 0.2, 0.1])


def boxes(clusters):
    return {(*cells.min(axis=0), *(cells.max(axis=0) + 1)) for cells in clusters}


def test_a_bright_part_gets_a_box_apart_from_the_glow_around_it():
    power = np.zeros((16, 16, 16))
    power[2:14, 2:14, 2:14] = 0.01
    power[5:7, 5:7, 5:7] = 10
    assert (5, 5, 5, 7, 7, 7) in boxes(cluster_cells(power, CELL, 8))


def test_lights_far_apart_get_a_box_each():
    power = np.zeros((32, 32, 32))
    corners = [(1, 1, 1), (28, 2, 3), (5, 29, 28)]
    for x, y, z in corners:
        power[x : x + 2, y : y + 2, z : z + 2] = 1
    expected = {(x, y, z, x + 2, y + 2, z + 2) for x, y, z in corners}
    assert boxes(cluster_cells(power, CELL, 32)) == expected


@pytest.mark.parametrize("count", [1, 3, 20])
def test_clusters_are_few_and_disjoint_and_hold_nearly_all_light(count):
    power = np.random.default_rng(0).exponential(1, (12, 12, 12)) ** 4
    clusters = cluster_cells(power, CELL, count)
    assert 1 <= len(clusters) <= count
    cells = np.concatenate(clusters)
    assert len(np.unique(cells, axis=0)) == len(cells)
    held = power[tuple(cells.T)].sum()
    assert 0.995 * power.sum() <= held


def test_dark_grid_is_one_box():
    assert boxes(cluster_cells(np.zeros((4, 5, 6)), CELL, 8)) == {(0, 0, 0, 4, 5, 6)}
