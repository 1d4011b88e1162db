"""Rays of a radiance field, and the light field that is made of them."""

import numpy as np
import pytest

from lumitree.core.device import on_device
from support.fields import random_asset, uniform_asset
from support.receivers import uniform_samples


@pytest.mark.parametrize("law", ["linear", "exponential"])
@pytest.mark.parametrize("half", [(1.0, 1.0, 1.0), (1.0, 0.4, 0.3)])
def test_they_carry_the_flux_of_every_direction(mi, law, half):
    """z-tests by octant, against rays that are uniform over directions and the box."""
    import drjit as dr

    from lumitree.octree.field import Field
    from lumitree.rendering.field_rays import FieldRays
    from lumitree.rendering.sampling import face_areas, point_on_box

    asset, count = (
        random_asset(5, law=law, half_extents=half, light_factors=(1.0, 2.0, 0.5)),
        1 << 19,
    )
    field, sampler = Field(asset), uniform_samples(mi, count)
    samples = sampler.next_1d(), sampler.next_2d(), sampler.next_2d()
    point, direction, flux = FieldRays(field, asset).sample_ray(*samples)
    assert (np.abs(np.array(point).T) <= np.array(half) + 1e-6).all()

    ways = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    box = on_device(mi.Vector3f, [half])
    areas = face_areas(box) * dr.abs(ways)
    exits = mi.Point3f(point_on_box(box, areas, ways, sampler.next_2d()))
    radiance, _ = field.emission(exits, -ways)
    plain = radiance * dr.sum(areas) * (4 * np.pi)

    found = []
    for way, value in ((direction, flux), (ways, plain)):
        octant = np.array([1, 2, 4]) @ (np.array(way) > 0)
        value = np.array(value, np.float64)
        for power in (1, 2):
            found.append([np.bincount(octant, each**power, 8) / count for each in value])
    (a, aa), (b, bb) = np.array(found).reshape(2, 2, 3, 8)
    error = np.sqrt((aa - a**2 + bb - b**2) / count)
    assert (error < 0.05 * b).all()
    assert (np.abs(a - b) < 4.5 * error).all()


@pytest.mark.slow
def test_a_field_gets_a_light_field_with_its_irradiance(mi):
    from lumitree.fit.finishing import with_field_light
    from lumitree.measure.irradiance import evaluate_irradiance
    from lumitree.rendering.asset_flux import asset_watts

    asset = random_asset(2, law="exponential", light_factors=(1.0, 2.0, 0.5))
    lit = with_field_light(asset)
    assert with_field_light(lit) is lit
    assert asset_watts(lit) == pytest.approx(asset_watts(asset), rel=0.01)
    error = evaluate_irradiance(lit.without_factors, asset.without_factors, 1 << 20).error
    assert error.total_ratio == pytest.approx(1, abs=0.01)
    assert error.rms.max() < 0.05


def test_a_field_without_light_gets_none(mi):
    from lumitree.fit.finishing import with_field_light

    dark = uniform_asset(0.0, [1.0, 1.0, 1.0])
    assert with_field_light(dark).light_field is None


def test_rays_of_an_asset_have_its_flux_and_follow_the_seed(mi):
    """An opaque cube of surface 24, π L per area."""
    from lumitree.rendering.asset_flux import AssetRays

    rays = AssetRays(uniform_asset(1e4, [3.0, 2.0, 1.0]))
    (origin, _, flux), (again, *_), (other, *_) = (
        rays.draw(1 << 16, seed).arrays() for seed in (1, 1, 2)
    )
    assert np.abs(origin).max() < 1 + 1e-5
    assert flux.sum(axis=0) == pytest.approx(24 * np.pi * np.array([3, 2, 1]), rel=0.02)
    assert np.array_equal(origin, again)
    assert not np.array_equal(origin, other)
