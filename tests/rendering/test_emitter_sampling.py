"""Directions and lines drawn from what a field emits: densities, means, bounds."""

import numpy as np
import pytest

import lumitree
from lumitree.core.frames import rotation, similarity
from lumitree.errors import LumitreeError
from support.fields import make_asset, random_asset, uniform_asset
from support.receivers import HALF, POINTS, device_point, uniform_samples


def lamp(**fields):
    """Small bright cells, each brighter on one side, in a few large and dim ones."""
    random = np.random.default_rng(3)
    bright = [(20, 9, 18), (21, 9, 18), (9, 20, 12), (3, 4, 20), (3, 5, 20)]
    dim = [(2, 2, 3), (4, 5, 4), (6, 3, 4)]
    coefficients = np.zeros((8, 3, 4))
    coefficients[:5, :, 0], coefficients[:5, :, 1:] = 2.0, random.normal(0, 3, (5, 1, 3))
    coefficients[5:, :, 0], coefficients[5:, :, 1:] = -24.0, random.normal(0, 2, (3, 1, 3))
    return make_asset(
        np.array(bright + dim),
        np.array([5] * 5 + [3] * 3),
        np.array([100.0] * 5 + [1.0] * 3),
        coefficients,
        tree_depth=5,
        half_extents=HALF,
        **fields,
    )


@pytest.fixture(scope="module")
def samplers(mi):
    """Field, sampler by emission and uniform one."""
    from lumitree.octree.field import Field
    from lumitree.rendering.lamp_sampler import EmitterSampler
    from lumitree.rendering.light_leaves import light_leaves
    from lumitree.rendering.sampling import BoxProxy

    field = Field(lamp())
    both = (light_leaves(field), None)
    return field, *(Drawn(EmitterSampler, BoxProxy(HALF), field, each) for each in both)


class Drawn:
    """A sampler asked from points outside the proxy, as the emitter does."""

    def __init__(self, kind, proxy, field, leaves):
        self.proxy, self.sampler = proxy, kind(proxy, field, leaves)

    def sample(self, origin, sample):
        """Direction, density and radiance."""
        direction, reach = self.sampler.sample(origin, sample)
        distance, _, enters = self.proxy.enter(origin, direction)
        entry = origin + distance * direction
        radiance, _, pdf = self.sampler.eval(origin, entry, direction, distance, enters, reach)
        return direction, pdf, radiance

    def pdf(self, origin, direction):
        distance, _, enters = self.proxy.enter(origin, direction)
        entry = origin + distance * direction
        return self.sampler.pdf(origin, entry, direction, distance, enters)


def estimates(mi, sampler, name, count=1 << 17):
    """Mean radiance over density [count] of the directions that `sampler` draws from a point."""
    import drjit as dr

    _, pdf, radiance = sampler.sample(device_point(mi, name), uniform_samples(mi, count).next_2d())
    return np.array(dr.mean(radiance) * dr.select(pdf > 0, dr.rcp(pdf), 0), np.float64)


@pytest.mark.parametrize("name", POINTS)
def test_density_is_that_of_the_samples(mi, samplers, name):
    """χ² over the directions towards the bounding sphere, or all directions from within it."""
    import drjit as dr
    from mitsuba.chi2 import ChiSquareTest, PlanarDomain

    sampler = samplers[1]
    origin = device_point(mi, name)
    distance = np.linalg.norm(POINTS[name])
    frame = mi.Frame3f(mi.Vector3f((-np.array(POINTS[name]) / distance).tolist()))
    radius = np.linalg.norm(HALF)
    cap = 1 - np.sqrt(1 - (radius / distance) ** 2) if distance > radius else 2.0

    # Coordinates of equal solid angle: 1 - cosine over the cap's, and azimuth.
    def sample(uniform):
        direction, pdf, _ = sampler.sample(origin, uniform)
        local = frame.to_local(direction)
        one_minus_cos = dr.squared_norm(local - mi.Vector3f(0, 0, 1)) / 2
        azimuth = dr.atan2(local.y, local.x) / dr.two_pi + 0.5
        return mi.Point2f(one_minus_cos / cap, azimuth), dr.select(pdf > 0, mi.Float(1), 0)

    def density(uv):
        one_minus_cos = uv.x * cap
        sine = dr.safe_sqrt(one_minus_cos * (2 - one_minus_cos))
        s, c = dr.sincos((uv.y - 0.5) * dr.two_pi)
        direction = frame.to_world(mi.Vector3f(sine * c, sine * s, 1 - one_minus_cos))
        return sampler.pdf(origin, direction) * (cap * 2 * np.pi)

    test = ChiSquareTest(
        domain=PlanarDomain(mi.ScalarBoundingBox2f([0, 0], [1, 1])),
        sample_func=sample,
        pdf_func=density,
        sample_dim=2,
        # The density jumps at the edges of boxes: integrate it finely there.
        res=20,
        ires=128,
        sample_count=2_000_000,
    )
    assert test.run(test_count=len(POINTS)), test.messages


@pytest.fixture(scope="module")
def seen(mi, samplers):
    """By point: directions uniform over the bounding sphere's cone, the cone's solid angle, and the
    mean radiance from each direction, 0 where the ray does not enter the box ahead."""
    import drjit as dr

    from lumitree.rendering.sampling import cone_pdf, sample_cone

    field = samplers[0]
    radius = float(np.linalg.norm(HALF))
    found = {}
    for name in POINTS:
        origin = device_point(mi, name)
        direction = sample_cone(origin, radius, uniform_samples(mi, 1 << 20, 1).next_2d())
        d = np.array(direction, np.float64).T
        first, second = (np.stack([-HALF, HALF])[:, None] - POINTS[name]) / d
        near = np.minimum(first, second).max(axis=1)
        enters = (near > 0) & (near < np.maximum(first, second).min(axis=1))
        radiance = np.array(dr.mean(field.emission(origin, direction)[0]), np.float64)
        solid_angle = 1 / np.array(cone_pdf(origin, radius))[0]
        found[name] = direction, solid_angle, np.where(enters, radiance, 0)
    return found


def test_means_are_right_and_variances_lower_than_of_uniform_sampling(mi, samplers, seen):
    _, by_emission, uniform = samplers
    for name in POINTS:
        drawn = estimates(mi, by_emission, name)
        _, solid_angle, radiance = seen[name]
        plain = radiance * solid_angle
        error = np.sqrt(drawn.var() / len(drawn) + plain.var() / len(plain))
        assert abs(drawn.mean() - plain.mean()) < 4 * error, name
        assert drawn.var() < estimates(mi, uniform, name).var() / 4, name


def test_density_adds_up_to_what_is_not_drawn_in_vain(mi, samplers, seen):
    sampler = samplers[1]
    for name in POINTS:
        direction, solid_angle, radiance = seen[name]
        pdf = np.array(sampler.pdf(device_point(mi, name), direction), np.float64)
        # Some samples miss the proxy, and some would come from leaves that others hide.
        drawn = sampler.sample(device_point(mi, name), uniform_samples(mi, 1 << 18).next_2d())[1]
        kept = np.mean(np.array(drawn) > 0)
        share = pdf * solid_angle
        error = np.sqrt(share.var() / len(share) + kept * (1 - kept) / (1 << 18))
        assert abs(share.mean() - kept) < 4 * error, name
        assert kept > 0.5, name
        assert (radiance > 0).sum() > 100
        assert pdf[radiance > 0].min() > 0, name


def test_no_sample_is_brighter_than_the_bound(mi, samplers):
    from lumitree.rendering.sampling import UNIFORM_FRACTION

    field, by_emission, _ = samplers
    bound = 4 * np.pi * field.asset.max_radiance / UNIFORM_FRACTION
    for name in POINTS:
        assert estimates(mi, by_emission, name, 1 << 19).max() <= bound


def test_density_of_a_sample_is_that_of_its_direction(mi, samplers):
    """Where rounding puts a direction past the edge of a leaf the two may differ."""
    sampler = samplers[1]
    for name in POINTS:
        origin = device_point(mi, name)
        direction, pdf, _ = sampler.sample(origin, uniform_samples(mi, 1 << 16).next_2d())
        again = np.array(sampler.pdf(origin, direction))
        pdf = np.array(pdf)
        assert (np.abs(again - pdf) > 1e-3 * pdf)[pdf > 0].mean() < 1e-3, name


def test_nothing_is_sampled_from_inside(mi, samplers):
    origin = mi.Point3f(0.2, 0.1, -0.3)
    for sampler in samplers[1:]:
        _, pdf, _ = sampler.sample(origin, uniform_samples(mi, 1024).next_2d())
        assert not np.array(pdf).any()


def test_instances_share_one_table(mi, tmp_path):
    from lumitree.rendering.light_leaves import light_leaves

    path = tmp_path / "lamp.lumitree"
    lumitree.save(lamp(), path)
    place = similarity(rotation([1, 0, 1], 70), 3.0, [5, 0, 0])
    near = mi.load_dict(lumitree.shape(path)).emitter()
    far = mi.load_dict(lumitree.shape(path, place)).emitter()
    assert light_leaves(near.placed.field) is light_leaves(far.placed.field)


def test_dark_field_is_sampled_uniformly(mi, tmp_path):
    import drjit as dr

    from lumitree.rendering.light_leaves import light_leaves

    dark = make_asset(np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros((0, 3, 4)))
    lumitree.save(dark, tmp_path / "dark.lumitree")
    emitter = mi.load_dict(lumitree.shape(tmp_path / "dark.lumitree")).emitter()
    assert light_leaves(emitter.placed.field) is None
    it = dr.zeros(mi.Interaction3f)
    it.p = mi.Point3f(2, 3, 1)
    ds, weight = emitter.sample_direction(it, uniform_samples(mi, 4096).next_2d())
    assert (np.array(ds.pdf) > 0).all()
    assert not np.array(weight).any()


def emitted(mi, shape, count=1 << 19):
    """Rays that an emitter sends, and their weights [count, 3]."""
    samples = uniform_samples(mi, count)
    ray, weight = shape.emitter().sample_ray(
        0, samples.next_1d(), samples.next_2d(), samples.next_2d()
    )
    return ray, np.array(weight, np.float64).T


def test_rays_carry_the_flux_of_an_area_light(mi, tmp_path):
    """An opaque cube of one radiance sends out π times its area times that."""
    lumitree.save(uniform_asset(1e4, [4.0, 2.0, 1.0]), tmp_path / "cube.lumitree")
    place = similarity(rotation([0, 1, 1], 25), 0.3, [0, 1.0, 0])
    shape = mi.load_dict(lumitree.shape(tmp_path / "cube.lumitree", place))
    _, weight = emitted(mi, shape)
    expected = np.pi * 24 * 0.3**2 * np.array([4.0, 2.0, 1.0])
    error = weight.std(axis=0) / np.sqrt(len(weight))
    assert (np.abs(weight.mean(axis=0) - expected) < 4 * error + 2e-3 * expected).all()


def test_rays_leave_the_proxy_with_the_same_flux_as_uniform_ones(mi, tmp_path):
    import drjit as dr

    path = tmp_path / "lamp.lumitree"
    lumitree.save(lamp(), path)
    place = similarity(rotation([1, 2, 3], 40), 0.4, [0.1, 0.9, -0.2])
    shapes = [
        mi.load_dict(lumitree.shape(path, place, sampling=sampling))
        for sampling in ("emission", "uniform")
    ]
    ray, drawn = emitted(mi, shapes[0])
    _, plain = emitted(mi, shapes[1])
    error = np.hypot(drawn.std(axis=0), plain.std(axis=0)) / np.sqrt(len(drawn))
    assert (np.abs(drawn.mean(axis=0) - plain.mean(axis=0)) < 4 * error).all()
    assert (drawn.var(axis=0) < plain.var(axis=0) / 4).all()
    scene = mi.load_dict({"type": "scene", "lamp": shapes[0]})
    assert not dr.any(scene.ray_test(ray))
    back = scene.ray_intersect(mi.Ray3f(ray.o + 5 * ray.d, -ray.d))
    # Rays that graze the proxy start further along it.
    assert np.quantile(np.abs(np.array(back.t) - 5), 0.99) < 2e-3


def test_connecting_the_lamp_to_a_camera_is_refused(mi, tmp_path):
    lumitree.save(lamp(), tmp_path / "lamp.lumitree")
    emitter = mi.load_dict(lumitree.shape(tmp_path / "lamp.lumitree")).emitter()
    with pytest.raises(LumitreeError, match="set hide_emitters"):
        emitter.sample_position(0, mi.Point2f(0.5))


def test_unknown_sampling_is_refused(tmp_path):
    lumitree.save(lamp(), tmp_path / "lamp.lumitree")
    with pytest.raises(LumitreeError, match="sampling is 'best'; expected emission"):
        lumitree.shape(tmp_path / "lamp.lumitree", sampling="best")


@pytest.mark.slow
def test_particle_tracing_gives_the_image_of_path_tracing(mi, tmp_path):
    path = tmp_path / "lamp.lumitree"
    lumitree.save(random_asset(6), path)
    place = similarity(rotation([1, 2, 3], 40), 0.4, [0.1, 0.9, -0.2])
    floor = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(2)
    look = mi.ScalarTransform4f().look_at([1.8, 0.35, 0], [1.2, 0, 0], [0, 1, 0])
    scene = mi.load_dict(
        {
            "type": "scene",
            "lamp": lumitree.shape(path, place),
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
