"""A lamp looks and lights the same wherever it stands, and at whatever scale."""

import numpy as np
import pytest

import lumitree
from lumitree.core.device import on_device
from lumitree.core.frames import rotation, similarity
from support.fields import random_asset

PASSES = 16
CAMERAS = {
    "floor": ([2.8, 0.6, 0.1], [0.7, 0, 0.1], 15.0),
    "lamp": ([0, 3, 4], [0, 1.2, 0], 22.0),
}


def mean_radiance(mi, lamp, seen, centre, scale, integrator="lumitree_path", **options):
    """Mean [3] over an image of a lamp above a floor, or of that floor alone; standard error."""
    place = similarity(np.eye(3), scale, centre)
    origin, target, fov = CAMERAS[seen]
    camera = place @ np.array(mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0]).matrix)
    camera[:3, :3] /= scale
    floor = place @ similarity(rotation([1, 0, 0], -90), 3)
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": {
                "type": "perspective",
                "fov": fov,
                "near_clip": 0.01 * scale,
                "to_world": mi.ScalarTransform4f(camera),
                "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
            },
            "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f(floor)},
            "lamp": lamp(place @ similarity(rotation([0, 1, 1], 30), 0.5, [0, 1.2, 0])),
        }
    )
    method = mi.load_dict({"type": integrator, "max_depth": 2, **options})
    means = [
        np.array(mi.render(scene, integrator=method, spp=256, seed=i))[..., :3].mean((0, 1))
        for i in range(PASSES)
    ]
    return np.mean(means, 0), np.std(means, 0, ddof=1) / np.sqrt(PASSES)


@pytest.fixture(scope="module")
def lamp(mi):
    from lumitree.fit.finishing import with_field_light

    asset = with_field_light(random_asset(11, density_scale=3.0))
    return lambda place: lumitree.shape(asset, place)


# At a coordinate of 100,000 numbers are 0.008 apart: the lamp's box itself is off by 1 %.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("coordinate", "scale", "tolerance"),
    [
        (0, 1e-3, 0),
        (0, 1e3, 0),
        (1e3, 1, 0),
        (3e3, 1, 0),
        (1e4, 1, 0.003),
        (1e5, 1, 0.02),
    ],
)
@pytest.mark.parametrize("seen", CAMERAS)
def test_light_depends_on_neither_place_nor_scale(mi, lamp, seen, coordinate, scale, tolerance):
    near, near_error = mean_radiance(mi, lamp, seen, [0, 0, 0], 1)
    far, far_error = mean_radiance(mi, lamp, seen, [coordinate] * 3, scale)
    error = np.hypot(near_error, far_error)
    assert (error < 0.003 * near).all()
    assert (np.abs(far - near) < 4 * error + tolerance * near).all()


@pytest.mark.parametrize("coordinate", [5e4, 1e5])
def test_a_hidden_lamp_far_from_the_origin_renders_to_the_end(mi, lamp, coordinate):
    """Null crossings do not advance there by less than the lamp's size."""
    mean, _ = mean_radiance(mi, lamp, "lamp", [coordinate] * 3, 1, hide_emitters=True)
    assert np.isfinite(mean).all()


def test_paths_end_after_so_many_null_surfaces(mi, monkeypatch):
    """Five clear slabs before a sky, or between a sun and a floor: ten faces to cross."""
    at = mi.ScalarTransform4f().translate
    slabs = {
        f"slab_{i}": {"type": "cube", "to_world": at([0, 3 * i, 0]), "bsdf": {"type": "null"}}
        for i in range(5)
    }
    floor = mi.ScalarTransform4f().translate([0, -3, 0]).rotate([1, 0, 0], -90).scale(9)
    sun = {"type": "directional", "direction": [0, -1, 0], "irradiance": 6 * np.pi}
    sky = {"type": "constant", "radiance": 2.0}
    sampler = mi.load_dict({"type": "independent"})

    def seen(scene, origin, direction):
        sampler.seed(0, 4096)
        start = on_device(mi.Point3f, np.tile(origin, (4096, 1)))
        ray = mi.Ray3f(start, mi.Vector3f(*(direction / np.linalg.norm(direction)).tolist()))
        method = mi.load_dict({"type": "lumitree_path", "max_depth": 2})
        return np.array(
            method.sample(mi.load_dict(scene), sampler, mi.RayDifferential3f(ray))[0]
        ).mean()

    for bound, expected in ((11, 1.0), (4, 0.0)):
        monkeypatch.setattr("lumitree.rendering.integrator.MAX_CROSSINGS", bound)
        through = seen({"type": "scene", **slabs, "sky": sky}, [0.1, -2, 0.2], [0, 1, 0])
        assert through == pytest.approx(2 * expected, abs=1e-3)
        lit = {
            "type": "scene",
            **slabs,
            "sun": sun,
            "floor": {"type": "rectangle", "to_world": floor},
        }
        # The sun is one of six emitters; reflectance 0.5.
        assert seen(lit, [4, -2, 0], [-4, -1, 0]) == pytest.approx(3 * expected, rel=0.15, abs=1e-3)
