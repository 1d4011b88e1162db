"""Light that baked lamps bring to surfaces, against area lights of the shape and known answers."""

import numpy as np
import pytest

import lumitree
from lumitree.core.frames import rotation, similarity
from support.fields import uniform_asset
from support.slow import slow_but
from support.walls import agree, irradiance

RADIANCE = np.array([4.0, 2.0, 1.0])
TURNED = similarity(rotation([0, 1, 1], 25), 0.3, [0, 1.0, 0])
# Points and normals of surfaces; the turned lamp reaches up to 0.47 from (0, 1, 0).
PLACES = {
    "far below": ([0.3, -9.0, 0.2], [0, 1, 0]),
    "below": ([0.1, 0.0, 0.1], [0, 1, 0]),
    "beside": ([1.4, 1.1, 0.2], [-1, 0, 0]),
    "obliquely": ([1.0, 0.2, -0.8], [-0.6, 0.5, 0.6]),
    "near": ([0.0, 0.5, 0.0], [0, 1, 0]),
}


@pytest.fixture
def cube(mi, tmp_path):
    """An opaque cube of one radiance, baked and as an area light."""
    path = tmp_path / "cube.lumitree"
    lumitree.save(uniform_asset(1e4, RADIANCE), path)

    def plain(place):
        return {
            "type": "cube",
            "to_world": mi.ScalarTransform4f(place),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0}},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": RADIANCE.tolist()}},
        }

    return lambda place: lumitree.shape(path, place), plain


@pytest.mark.parametrize("name", slow_but(["near"], PLACES))
def test_near_and_far_a_wall_gets_what_an_area_light_sends(mi, cube, name):
    baked, plain = (make(TURNED) for make in cube)
    place = PLACES[name]
    agree(irradiance(mi, {"a": baked}, *place), irradiance(mi, {"a": plain}, *place, seed=50))


@pytest.mark.slow
def test_several_turned_and_scaled_instances_add_up_and_hide_each_other(mi, cube):
    places = [
        similarity(rotation([1, 2, 3], 40), 0.3, [-0.8, 1.2, 0.1]),
        similarity(rotation([3, 1, 0], 70), 0.15, [0.5, 0.8, 0.0]),
        similarity(rotation([0, 1, 0], 20), 0.4, [1.4, 1.7, 0.0]),
    ]
    baked, plain = ({f"lamp_{i}": make(place) for i, place in enumerate(places)} for make in cube)
    place = [0.1, 0.0, 0.1], [0, 1, 0]
    agree(irradiance(mi, baked, *place), irradiance(mi, plain, *place, seed=50))


@pytest.mark.slow
def test_two_lamps_are_seen_through_one_another(mi, tmp_path):
    """Half-transparent cubes one behind the other: L = L1 + T1 L2, from camera and shadow rays."""
    path, radiance = tmp_path / "mist.lumitree", np.array([2.0, 1.0, 0.5])
    lumitree.save(uniform_asset(0.25, radiance), path)  # linear law: T = 1 - 0.25 · 2 along an axis
    places = [similarity(np.eye(3), 0.2, [0, y, 0]) for y in (1.0, 1.6)]
    lamps = {f"lamp_{i}": lumitree.shape(path, place) for i, place in enumerate(places)}
    scene = mi.load_dict({"type": "scene", **lamps})
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": 2})
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 1)
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.03, 5, 0.02), mi.Vector3f(0, -1, 0)))
    seen, _, _ = integrator.sample(scene, sampler, ray)
    assert np.array(seen).ravel() == pytest.approx(0.75 * radiance, rel=2e-3)
    # Irradiance of the wall, by a sum over the directions of the hemisphere.
    point = np.array([0.1, 0.0, 0.05])
    found, error = irradiance(mi, lamps, point.tolist(), [0, 1, 0])
    random = np.random.default_rng(0)
    slope = random.uniform(-0.9, 0.9, (1 << 22, 2))
    direction = np.insert(slope, 1, 1.0, axis=1)
    length = np.linalg.norm(direction, axis=1)
    expected = np.zeros(len(slope))
    through = np.ones(len(slope))
    for place in places:
        centre = place[:3, 3]
        first, second = ((centre + end - point) / direction for end in (-0.2, 0.2))
        enter, leave = np.minimum(first, second).max(1), np.maximum(first, second).min(1)
        inside = np.clip(leave - enter, 0, None) * length / 0.2
        opacity = np.clip(0.25 * inside, 0, 1)
        expected += through * opacity
        through *= 1 - opacity
    # dω cos = dx dz / length⁴ on the plane at height 1.
    share = expected * 1.8**2 / length**4
    agree((found, error), (radiance * share.mean(), radiance * share.std() / np.sqrt(len(share))))
