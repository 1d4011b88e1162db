"""Rays that a baked luminaire emits, and refusals of its emitter."""

import numpy as np
import pytest

import lumitree
from lumitree.core.frames import rotation, similarity
from lumitree.errors import LumitreeError
from support.fields import random_asset, uniform_asset
from support.receivers import uniform_samples


def emitted(mi, shape, count=1 << 19):
    """Rays that an emitter sends, and their weights [count, 3]."""
    samples = uniform_samples(mi, count)
    ray, weight = shape.emitter().sample_ray(
        0, samples.next_1d(), samples.next_2d(), samples.next_2d()
    )
    return ray, np.array(weight, np.float64).T


def test_rays_carry_the_flux_of_an_area_light_away_from_the_proxy(mi):
    """An opaque cube of one radiance sends out π times its area times that."""
    import drjit as dr

    place = similarity(rotation([0, 1, 1], 25), 0.3, [0, 1.0, 0])
    shape = mi.load_dict(lumitree.shape(uniform_asset(1e4, [4.0, 2.0, 1.0]), place))
    ray, weight = emitted(mi, shape)
    scene = mi.load_dict({"type": "scene", "lamp": shape})
    assert not dr.any(scene.ray_test(ray))
    back = scene.ray_intersect(mi.Ray3f(ray.o + 5 * ray.d, -ray.d))
    # Rays that graze the proxy start further along it.
    assert np.quantile(np.abs(np.array(back.t) - 5), 0.99) < 2e-3
    expected = np.pi * 24 * 0.3**2 * np.array([4.0, 2.0, 1.0])
    error = weight.std(axis=0) / np.sqrt(len(weight))
    assert (np.abs(weight.mean(axis=0) - expected) < 4 * error + 2e-3 * expected).all()


def test_connecting_the_lamp_to_a_camera_is_refused(mi):
    emitter = mi.load_dict(lumitree.shape(random_asset(6))).emitter()
    with pytest.raises(LumitreeError, match="set hide_emitters"):
        emitter.sample_position(0, mi.Point2f(0.5))


@pytest.mark.slow
def test_particle_tracing_gives_the_image_of_path_tracing(mi):
    place = similarity(rotation([1, 2, 3], 40), 0.4, [0.1, 0.9, -0.2])
    floor = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(2)
    look = mi.ScalarTransform4f().look_at([1.8, 0.35, 0], [1.2, 0, 0], [0, 1, 0])
    scene = mi.load_dict(
        {
            "type": "scene",
            "lamp": lumitree.shape(random_asset(6), place),
            "floor": {"type": "rectangle", "to_world": floor, "bsdf": {"type": "diffuse"}},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": look,
                "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
            },
        }
    )
    means, variances = [], []
    for kind, spp in (("ptracer", 1 << 14), ("volpath", 1 << 11)):
        integrator = mi.load_dict({"type": kind, "max_depth": 2, "hide_emitters": True})
        images = [
            np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed))[..., :3]
            for seed in range(16)
        ]
        means.append(np.mean(images, axis=0))
        variances.append(np.var(images, axis=0, ddof=1) / 16)
    z = (means[0] - means[1]) / np.sqrt(variances[0] + variances[1])
    assert np.abs(z).max() < 5
    assert means[0].mean() == pytest.approx(means[1].mean(), rel=0.02)
