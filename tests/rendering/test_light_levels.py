"""Levels of a light field: they have its light, and receivers see no border between them."""

import itertools

import numpy as np
import pytest

from lumitree.asset.light_field import make_light_field, unpack
from lumitree.core.device import on_device
from lumitree.core.octahedral import solid_angles
from lumitree.core.photometry import luminance
from lumitree.octree.build import grid_boxes_inside
from support.receivers import HALF, uniform_samples

DEPTH, RESOLUTION = 5, 8


def some_light():
    """Cells along a bent line through the box, each bright in some of its bins."""
    random = np.random.default_rng(4)
    place = np.linspace(-0.9, 0.9, 400)
    points = np.stack([place, 0.6 * np.sin(4 * place), 0.4 * np.cos(3 * place)], axis=1)
    points += random.normal(0, 0.03, points.shape)
    cells = np.unique(np.floor((np.clip(points, -HALF, HALF * 0.99) + 1) * 16), axis=0)
    intensity = random.exponential(1, (len(cells), RESOLUTION**2, 3))
    intensity *= random.random((len(cells), RESOLUTION**2, 1)) < 0.4
    return make_light_field(cells.astype(np.uint8), intensity, DEPTH)


@pytest.fixture(scope="module")
def light(mi):
    from lumitree.rendering.device_light import DeviceLight

    return DeviceLight(some_light(), HALF, levels=True)


def test_sums_have_the_light_of_their_cells(mi):
    from lumitree.rendering.light_levels import light_sums

    field = some_light()
    whole = unpack(field.dense(field.intensity))
    flux = luminance(whole) @ solid_angles(RESOLUTION)
    levels = light_sums(field, HALF, flux)
    assert [level.depth for level in levels] == [4, 3, 2]
    lower, upper = grid_boxes_inside(HALF, field.cells, DEPTH)
    middle = (lower + upper) / 2
    for level in levels:
        shift = DEPTH - level.depth
        cells, inverse = np.unique(field.cells >> shift, axis=0, return_inverse=True)
        order = np.lexsort(level.cells.T[::-1])
        assert np.array_equal(level.cells[order], cells)
        # By cell, bin and channel.
        sums = np.zeros((len(cells), *whole.shape[1:]))
        np.add.at(sums, inverse.ravel(), whole)
        assert level.intensity[order] == pytest.approx(sums, rel=1e-5)
        # Where the light starts, by its flux, and how far from there.
        lower, upper = grid_boxes_inside(HALF, level.cells, level.depth)
        assert (level.lower >= lower - 1e-6).all()
        assert (level.upper <= upper + 1e-6).all()
        mean = np.zeros((len(cells), 3))
        np.add.at(mean, inverse.ravel(), flux[:, None] * middle)
        assert level.flux[order] == pytest.approx(luminance(sums) @ solid_angles(RESOLUTION))
        mean /= level.flux[order, None]
        assert ((level.lower + level.upper) / 2)[order] == pytest.approx(mean, abs=1e-6)


def test_a_sum_of_equal_cells_is_the_larger_cell(mi):
    from lumitree.rendering.light_levels import light_sums

    cells = np.argwhere(np.ones((2, 2, 2))) + np.array([2, 4, 4])
    field = make_light_field(cells, np.full((8, RESOLUTION**2, 3), 2.0), 3)
    (level,) = light_sums(field, HALF, np.ones(8))
    assert level.lower[0] == pytest.approx([-0.5, 0, 0])
    assert level.upper[0] == pytest.approx([0, 0.5, 0.5])


def test_levels_follow_the_distance_without_a_border(mi):
    from lumitree.rendering.light_table import LevelChoice

    choice = LevelChoice(HALF, np.array([3.0, 6.0]))
    sample = uniform_samples(mi, 1 << 14).next_1d()
    mean = []
    for distance in (0.0, 1.99, 2.5, 3.01, 3.99, 5.0, 6.01, 1e6):
        x = mi.Point3f(float(HALF[0]) + distance, 0.2, 0.1)
        mean.append(np.array(choice.sample(x, sample), np.float64).mean())
    assert mean == pytest.approx([0, 0, 0.6, 1, 1, 1.6, 2, 2], abs=0.01)


def irradiance(mi, light, x, n, level):
    """Irradiance [N] of receivers by sums over all cells of a level."""
    import drjit as dr

    random = mi.PCG32(dr.width(x), initstate=dr.opaque(mi.UInt64, level))
    found = light.irradiance(x, n, random, mi.Bool(True), level)
    return np.array(found, np.float64)[1]


def test_no_level_errs_by_more_than_is_allowed(mi, light):
    from lumitree.rendering import light_levels

    limits = light_levels.level_limits(light._level_errors(), DEPTH)
    assert len(limits) == 3
    assert (np.diff(limits) >= 0).all()
    points, normals = light_levels.points_around(HALF)
    shift = points / (HALF + light_levels.ERROR_DISTANCE)
    for level, limit in enumerate(limits, 1):
        x = on_device(mi.Point3f, shift * (HALF + limit))
        n = mi.Vector3f(on_device(mi.Point3f, normals))
        exact, found = (irradiance(mi, light, x, n, each) for each in (0, level))
        assert found.mean() == pytest.approx(exact.mean(), rel=2e-3)
        assert np.sqrt(np.square(found - exact).mean()) < 0.015 * exact.mean()


def test_sampled_irradiance_is_the_mean_over_levels(mi, light):
    """z-test, on both sides of the borders of all levels."""
    import drjit as dr

    count = 1 << 19
    for limit, part in itertools.product(light.choice._limits, (0.1, 0.55, 0.8, 1.1)):
        # Towards the lamp, and along a horizon that divides it.
        for n in (mi.Vector3f(-0.8, -0.6, 0), mi.Vector3f(-0.6, 0.8, 0)):
            x = on_device(mi.Point3f, [HALF * [1, 1, 0.2] + part * limit * np.array([0.8, 0.6, 0])])
            dr.make_opaque(x)
            samples = uniform_samples(mi, count)
            direction, target = light.sample_point(x, n, samples.next_2d())
            weight = light.contribution(target, mi.Float(0)) * dr.maximum(dr.dot(direction, n), 0)
            weight = np.array(weight, np.float64)[1]
            level = light.choice.sample(x, samples.next_1d())
            pmf = np.bincount(np.array(level), minlength=4) / count
            many = dr.gather(mi.Point3f, x, dr.zeros(mi.UInt32, 1024))
            sums = np.array([irradiance(mi, light, many, n, each) for each in range(4)])
            expected = (pmf @ sums).mean()
            noise = np.hypot(weight.std() / count**0.5, (pmf @ sums).std() / 32)
            facing = n.x[0] < -0.7
            assert noise < (5e-3 if facing else 1e-2) * expected
            assert abs(weight.mean() - expected) < 4 * noise + 1e-3 * expected
            # The error that is allowed is a root mean square over all directions.
            assert not facing or weight.mean() == pytest.approx(sums[0].mean(), rel=0.04)


def test_a_lamp_whose_light_is_all_straight_has_levels(mi):
    """Its bent light is one bin of next to nothing, so narrow here that it meets no receiver."""
    import drjit as dr

    from lumitree.rendering.device_light import DeviceLight

    cells, shape = some_light().cells[:1], (1, 256**2, 3)
    straight = make_light_field(cells, np.ones(shape), DEPTH, bent=np.zeros(shape))
    light = DeviceLight(straight.bent_light, HALF, levels=True)
    x = dr.full(mi.Point3f, 3.0, 1 << 10)
    direction, target = light.sample_point(
        x, -mi.Vector3f(x), uniform_samples(mi, 1 << 10).next_2d()
    )
    weight = np.array(light.contribution(target, mi.Float(0.1)))
    assert np.isfinite(np.array(direction)).all()
    assert (weight >= 0).all()
    assert weight.max() < 1e-6
