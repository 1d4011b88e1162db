"""The gain of an asset: a factor on the light of all its parts, wherever it is evaluated."""

import dataclasses

import numpy as np
import pytest
from test_gain import ASSETS, GAIN, lamps, render, scene_with

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import unpack
from lumitree.core.photometry import colour_temperature, luminance
from lumitree.lamp.stored_geometry import stored_geometry
from lumitree.measure.far_field import asset_source, measure
from lumitree.measure.irradiance import asset_irradiance
from lumitree.rendering.asset_flux import asset_watts, with_light
from lumitree.rendering.asset_images import baked_image
from lumitree.viewer.packing import pack_asset
from support.fields import random_asset
from support.lamps import AREA, lamp_of, sphere
from support.light_fields import random_light_field
from support.packed_assets import unpack_asset
from support.reference_field import integrate_ray
from support.slow import slow_but_sets


@pytest.fixture(params=ASSETS)
def asset(request):
    return lamps()[request.param]


def brighter(asset):
    return dataclasses.replace(asset, light_factors=GAIN)


def test_every_use_of_an_asset_has_it(mi, asset):
    from lumitree.core.frames import pose_towards

    pose = pose_towards((0.3, 0.4, 0.5), (0, 1, 0), 4.0)
    image, opacity = baked_image(asset, pose, 1.5, 24)
    gained, same = baked_image(brighter(asset), pose, 1.5, 24)
    assert image.mean() > 0.01
    np.testing.assert_allclose(gained, image * GAIN, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(same, opacity)
    # Random choices depend on luminance, and so on the gain.
    np.testing.assert_allclose(asset_watts(brighter(asset)), asset_watts(asset) * GAIN, rtol=0.01)
    received = [
        asset_irradiance(each, 1 << 18).mean[:6].sum(axis=(0, 1, 2))
        for each in (asset, brighter(asset))
    ]
    np.testing.assert_allclose(received[1], received[0] * GAIN, rtol=0.02)


def test_rays_agree_with_the_reference_implementation(mi):
    asset = brighter(random_asset(3))
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(20, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = rng.uniform(-0.5, 0.5, (20, 3))
    radiance, _ = asset.eval(origin, direction)
    expected = [integrate_ray(asset, *ray)[0] for ray in zip(origin, direction, strict=True)]
    np.testing.assert_allclose(radiance, expected, rtol=2e-4, atol=1e-4)
    assert radiance[:, 2].max() > 0


@pytest.mark.parametrize(
    ("asset", "kind"),
    slow_but_sets(
        [("light", "lumitree_path"), ("both", "path")], ASSETS, ("lumitree_path", "path")
    ),
    indirect=["asset"],
)
def test_it_multiplies_the_gain_of_a_placed_lamp(mi, asset, kind):
    lumitree.register()
    scenes = (
        scene_with(mi, asset, gain=np.multiply(GAIN, 2)),
        scene_with(mi, brighter(asset), gain=2),
    )
    # With 16 samples the mean of an image has a standard deviation of 6 %.
    there, here = (np.array(render(mi, scene, kind, seed=5, spp=4096)) for scene in scenes)
    assert there.mean() > 0.01
    assert here.mean(axis=(0, 1)) == pytest.approx(there.mean(axis=(0, 1)), rel=0.02)


def test_it_applies_to_the_geometry(mi, tmp_path):
    lumitree.register()
    lamp = lamp_of(tmp_path, sphere("ball", 1, inside=AREA))
    asset = light_field_asset(random_light_field(2), lamp.frame, "test")
    asset = dataclasses.replace(asset, geometry=stored_geometry(lamp))
    # Emission that the camera sees, which takes no random choice of a light.
    seen = mi.load_dict({"type": "lumitree_path", "max_depth": 1})
    images = [
        np.array(
            mi.render(
                scene_with(mi, each, appearance="geometry", gain=gain),
                integrator=seen,
                spp=4,
                seed=1,
            )
        )
        for each, gain in ((asset, GAIN), (brighter(asset), 1))
    ]
    assert images[0].max() > 1
    np.testing.assert_allclose(images[1], images[0], rtol=1e-4, atol=1e-5)


def test_photometry_and_the_viewer_have_it(mi):
    asset = dataclasses.replace(random_asset(1), light_field=random_light_field(2))
    both = [
        measure(asset_source(each), 1 << 14, step=30, seed=1) for each in (asset, brighter(asset))
    ]
    plain, gained = (each.watts.sum(axis=0) for each in both)
    np.testing.assert_allclose(gained, plain * GAIN, rtol=0.05)
    packed = pack_asset(brighter(asset))
    assert asset.light_field is not None
    field = packed.description["field"]
    colour = np.array(field["colour"]) * field["max_radiance"]
    np.testing.assert_allclose(colour, np.multiply(GAIN, asset.max_radiance))
    arrays = unpack_asset(packed)
    counts = np.bitwise_count(asset.light_field.lit).sum(axis=1, dtype=np.int64)
    found = arrays["intensity"].astype(np.float64) * np.repeat(arrays["cell_scale"], counts)
    expected = luminance(
        unpack(asset.light_field.intensity) * asset.light_field.scale * np.array(GAIN)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-6)


def test_flux_and_temperature_that_are_asked_for(mi, asset):
    warm = with_light(asset, 800.0, 2700.0)
    watts = asset_watts(warm)
    # The flux of a field is an estimate.
    exact = 1e-6 if asset.light_field is not None else 0.01
    assert luminance(watts) == pytest.approx(800, rel=exact)
    assert colour_temperature(watts)[0] == pytest.approx(2700, rel=0.001 + exact)
    dim = with_light(warm, 8.0, None)
    np.testing.assert_allclose(
        np.array(dim.light_factors), np.array(warm.light_factors) / 100, rtol=exact
    )
    assert with_light(asset, None, None) is asset
