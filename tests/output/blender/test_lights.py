"""Point lights have the flux of the field, and nearly its irradiance."""

import numpy as np
import pytest

from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import make_light_field, unpack
from lumitree.core.frames import LocalFrame, rotation
from lumitree.core.octahedral import solid_angles
from support.light_fields import random_light_field

pytestmark = pytest.mark.usefixtures("mi")


def lights_of(field, count, half=(1, 1, 1), seed=0):
    from lumitree.output.blender.lights import cluster_lights

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


def test_equal_seeds_give_equal_lights():
    field = random_light_field(3, depth=5, count=300)
    first, second = (lights_of(field, 9, seed=4) for _ in range(2))
    assert np.array_equal(first.position, second.position)
    assert np.array_equal(first.intensity, second.intensity)


def test_weights_of_a_table_are_those_of_linear_interpolation():
    from lumitree.output.blender.lights import table_angles

    weight = table_angles(16)
    assert 32 * weight.sum() == pytest.approx(4 * np.pi)
    np.testing.assert_allclose(weight, weight[::-1])
    # A hat of a row of another grid integrated by the midpoint rule.
    latitude = (np.arange(200_000) + 0.5) / 200_000 * np.pi - np.pi / 2
    row = (latitude / np.pi + 0.5) * 16 - 0.5
    hat = np.maximum(0, 1 - np.abs(row - 5))
    assert weight[5] == pytest.approx(
        (hat * np.cos(latitude)).mean() * np.pi * (2 * np.pi / 32), rel=1e-4
    )


def test_light_is_linear_between_the_middles_of_bins(mi):
    """As the light field has it: the mean over offsets of up to half a bin."""
    from lumitree.core.octahedral import bin_of
    from lumitree.output.blender.lights import linear_bins

    random = np.random.default_rng(3)
    directions = random.normal(size=(200, 3))
    # On edges and corners of the map, too.
    directions[:3] = [[0, 0, -1], [1e-4, 0, -1], [0, 1, 0]]
    values = random.exponential(size=64)
    bins = linear_bins(directions, 8)
    np.testing.assert_allclose(sum(weight for _, weight in bins), 1, rtol=1e-12)
    found = sum(values[index] * weight for index, weight in bins)
    steps = (np.arange(40) + 0.5) / 40 - 0.5
    x, y, each = (axis.ravel() for axis in np.meshgrid(steps, steps, np.arange(200)))
    direction = mi.Vector3f(directions[each].T.astype(np.float32))
    index = np.array(bin_of(direction, 8, mi.Vector2f(np.stack([x, y]).astype(np.float32))))
    expected = np.bincount(each, values[index.astype(int)]) / 1600
    np.testing.assert_allclose(found, expected, atol=values.max() / 20)
    assert np.abs(found - expected).mean() < values.max() / 200


def test_tables_hold_the_intensity_of_their_directions_and_its_flux():
    from lumitree.output.blender.lights import PointLights, direction_tables, table_angles
    from lumitree.output.blender.lights import table_directions as directions

    turn = rotation([1, 2, 3], 40.0)
    coarse = 32
    mi = pytest.importorskip("mitsuba")
    from lumitree.core.octahedral import direction_in_bin

    bins = mi.UInt32(np.arange(coarse**2, dtype=np.uint32))
    centre = np.array(direction_in_bin(bins, mi.Point2f(0.5), coarse)[0], np.float64).T
    smooth = 2 + centre @ np.array([[1.0, 0, 0], [0, -1, 0.5], [0.3, 0, 1]])
    lights = PointLights(np.zeros((1, 3)), smooth[None])
    tables = direction_tables(lights, turn, 64)
    local = directions(64) @ turn.T
    expected = 2 + local @ np.array([[1.0, 0, 0], [0, -1, 0.5], [0.3, 0, 1]])
    assert np.abs(tables[0] - expected).max() < 0.12
    np.testing.assert_allclose(
        np.einsum("shwc,h->sc", tables, table_angles(64)), lights.flux, rtol=1e-12
    )


def two_groups():
    """Two groups of 8 cells to the left and right, one brighter, both brighter upwards."""
    random = np.random.default_rng(7)
    offsets = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), axis=-1).reshape(-1, 3)
    cells = np.concatenate([offsets + np.array(start) for start in ((2, 7, 7), (12, 7, 7))])
    intensity = random.uniform(0.5, 1.5, (16, 64, 3))
    intensity[:8] *= 3
    return make_light_field(cells, intensity, 4)


def test_irradiance_of_as_many_lights_as_groups_is_that_of_the_field():
    from benchmarks.cycles.table_rays import TableRays
    from lumitree.measure.irradiance import (
        asset_irradiance,
        irradiance_error,
        rays_irradiance,
    )

    field, half = two_groups(), np.ones(3)
    asset = light_field_asset(field, LocalFrame(half, np.eye(4)), "two")
    reference = asset_irradiance(asset, 1 << 20)
    errors = {}
    for count in (1, 2):
        rays = TableRays(lights_of(field, count))
        errors[count] = irradiance_error(rays_irradiance(rays, half, 1 << 20, draw=2), reference)
    assert errors[2].total_ratio == pytest.approx(1, abs=5 * errors[2].total_ratio_error + 1e-6)
    assert errors[2].mean_rms < 0.06
    assert errors[1].mean_rms > 2 * errors[2].mean_rms
