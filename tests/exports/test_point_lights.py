"""Point lights have the flux of the field, and nearly its irradiance."""

import dataclasses

import numpy as np
import pytest

from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import make_light_field, unpack
from lumitree.core.frames import LocalFrame
from lumitree.core.octahedral import solid_angles
from lumitree.errors import LumitreeError
from support.light_fields import random_light_field

pytestmark = pytest.mark.usefixtures("mi")


def lights_of(field, count, half=(1, 1, 1), seed=0):
    from lumitree.exports.point_lights import cluster_lights

    return cluster_lights(field, np.array(half, float), count, seed)


@pytest.mark.parametrize("count", [1, 3, 40])
def test_each_direction_keeps_its_intensity(count):
    field = random_light_field(1, depth=4, resolution=8, count=30)
    lights = lights_of(field, count)
    expected = field.scale * np.stack(
        [field.dense(channel).sum(axis=0) for channel in unpack(field.intensity).T], axis=-1
    )
    assert len(lights.position) == min(count, 30)
    np.testing.assert_allclose(lights.intensity.sum(axis=0), expected, rtol=1e-12)
    total = np.einsum("bc,b->c", expected, solid_angles(8))
    np.testing.assert_allclose(lights.flux.sum(axis=0), total, rtol=1e-12)


def test_as_many_lights_as_cells_stand_in_them():
    half = np.array([1, 0.3, 1])
    field = random_light_field(2, depth=2, count=20)
    lights = lights_of(field, 20, half)
    lower = np.clip(field.cells / 2 - 1, -half, half)
    upper = np.clip((field.cells + 1) / 2 - 1, -half, half)
    np.testing.assert_allclose(lights.position, (lower + upper) / 2, atol=1e-12)


def test_a_light_stands_at_the_centroid_of_flux():
    intensity = np.ones((2, 16, 3)) * np.array([3.0, 1.0])[:, None, None]
    cells = np.array([[0, 0, 0], [3, 0, 0]])
    lights = lights_of(make_light_field(cells, intensity, 2), 1)
    expected = [[0.75 * -0.75 + 0.25 * 0.75, -0.75, -0.75]]
    # Intensities are stored to 0.2 %.
    np.testing.assert_allclose(lights.position, expected, atol=2e-3)


def test_clusters_are_those_of_scipy():
    from scipy.cluster.vq import kmeans2

    from lumitree.exports.point_lights import cluster_points

    points = np.random.default_rng(1).normal(size=(3000, 3))
    for count in (1, 2, 30):
        expected, _ = kmeans2(points, count, 20, minit="++", rng=np.random.default_rng(5))
        found = cluster_points(points, count, np.random.default_rng(5))
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_there_are_no_more_clusters_than_different_points():
    from lumitree.exports.point_lights import cluster_points

    points = np.repeat(np.eye(3), 50, axis=0)
    found = cluster_points(points, 10, np.random.default_rng(2))
    assert sorted(found.tolist()) == np.eye(3)[::-1].tolist()


def test_lights_that_a_gain_makes_black_are_left_out():
    from lumitree.exports.point_lights import place_lights

    intensity = np.zeros((2, 16, 3))
    intensity[0, :, 0] = intensity[1, :, 2] = 1
    field = make_light_field(np.array([[0, 0, 0], [3, 0, 0]]), intensity, 2)
    asset = light_field_asset(field, LocalFrame(np.ones(3), np.eye(4)), "red and blue")
    red = place_lights(dataclasses.replace(asset, light_factors=(2.0, 1.0, 0.0)), np.eye(3), 2)
    np.testing.assert_allclose(red.position, [[-0.75, -0.75, -0.75]])
    np.testing.assert_allclose(red.watts, [[8 * np.pi, 0, 0]], rtol=1e-2)
    with pytest.raises(LumitreeError, match="sends no light"):
        place_lights(dataclasses.replace(asset, light_factors=(0.0, 1.0, 0.0)), np.eye(3), 2)
