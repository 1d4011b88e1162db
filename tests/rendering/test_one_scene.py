"""Images where a kernel may trace one scene only, as under OptiX, equal other images."""

import dataclasses

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.core.frames import rotation, similarity
from lumitree.lamp.stored_geometry import stored_geometry
from lumitree.rendering import proxies
from support.fields import random_asset
from support.lamps import GLASS, cube, lamp_of, sphere
from support.light_fields import random_light_field, with_inside
from support.slow import slow_but

BLACK = '<bsdf type="diffuse"><rgb name="reflectance" value="0,0,0"/></bsdf>'
GLOWS = f'{BLACK}<emitter type="area"><rgb name="radiance" value="6,5,3"/></emitter>'
MILK = (
    '<medium type="homogeneous" name="interior"><rgb name="sigma_t" value="0.6,0.8,1"/>'
    '<float name="scale" value="5"/><rgb name="albedo" value="0.95,0.9,0.8"/></medium>'
)
LAMP = (
    sphere("bulb", 0.2, inside=GLOWS),
    sphere("shell", 0.3, inside=GLASS + MILK),
    cube("plate", (0.4, 0.02, 0.4), (0, -0.5, 0), BLACK),
    cube("left", 0.03, (-0.97, -0.97, -0.97), BLACK),
    cube("right", 0.03, (0.97, 0.97, 0.97), BLACK),
)
LIGHT = with_inside(1, random_light_field(1, resolution=8, count=20))
FOG = {"type": "homogeneous", "sigma_t": 0.2, "albedo": 0.8}
CASES = {
    # name: lamps, other things of the scene, options of the integrator
    "in the box": (["geometry"], {}, {}),
    "overlap": (["geometry", "geometry"], {}, {}),
    "field": (["field"], {}, {}),
    "light field": (["light"], {}, {}),
    "media": (["geometry"], {"fog": FOG}, {"max_depth": 3, "hide_emitters": True}),
}
SEEDS = 12


@pytest.fixture(scope="module")
def assets(mi, tmp_path_factory):
    if proxies._one_scene_only():
        pytest.skip("there is no other way")
    lamp = lamp_of(tmp_path_factory.mktemp("lamp"), *LAMP)
    light = light_field_asset(LIGHT, lamp.frame, lamp.name)
    return {
        "geometry": dataclasses.replace(light, geometry=stored_geometry(lamp)),
        "light": light,
        "field": random_asset(5, density_scale=3.0, half_extents=np.ones(3)),
    }


def room(mi, lamps, fog=None):
    """A ball and a floor in the box of the first lamp, a light above; perhaps in fog."""
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    to = mi.ScalarTransform4f
    look = to().look_at([2.5, 2.0, 3.0], [0, -0.5, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": 40, "to_world": look, "film": film}
    floor = to().translate([0, -0.8, 0]).rotate([1, 0, 0], -90).scale(3)
    above = to().translate([0, 3, 0]).rotate([1, 0, 0], 90).scale(0.5)
    things = {
        "ball": {"type": "sphere", "center": [0.4, -0.55, 0.3], "radius": 0.18, "bsdf": grey},
        "floor": {"type": "rectangle", "to_world": floor, "bsdf": grey},
        "light": {
            "type": "rectangle",
            "to_world": above,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [0.5, 0.4, 0.3]}},
        },
    }
    if fog is not None:
        medium = mi.load_dict(fog)
        cloud = {"type": "sphere", "center": [0, 0, 0], "radius": 9, "bsdf": {"type": "null"}}
        things["cloud"] = cloud | {"interior": medium}
        sensor["medium"] = medium
    places = [np.eye(4), similarity(rotation([0, 1, 0], 30), 0.7, [0.5, 0.35, -0.6])]
    things |= {f"lamp{i}": lumitree.shape(asset, places[i]) for i, asset in enumerate(lamps)}
    return mi.load_dict({"type": "scene", "sensor": sensor, **things})


def traced_scenes(mi, monkeypatch):
    """A list to which every scene is added that Python traces rays against."""
    traced = []

    def recording(original):
        def trace(scene, *args, **options):
            if not any(scene is each for each in traced):
                traced.append(scene)
            return original(scene, *args, **options)

        return trace

    for name in ("ray_intersect", "ray_intersect_preliminary", "ray_test"):
        monkeypatch.setattr(mi.Scene, name, recording(getattr(mi.Scene, name)))
    return traced


@pytest.mark.parametrize("case", slow_but(["media"], CASES))
def test_images_are_the_same(mi, assets, monkeypatch, case):
    lamps, things, options = CASES[case]
    scene = room(mi, [assets[name] for name in lamps], **things)
    traced = traced_scenes(mi, monkeypatch)
    images = []
    for only in (False, True):
        monkeypatch.setattr(proxies, "_one_scene_only", lambda only=only: only)
        integrator = mi.load_dict({"type": "lumitree_path", "max_depth": 6} | options)
        traced.clear()
        images.append(
            [
                np.array(mi.render(scene, integrator=integrator, spp=64, seed=seed))[..., :3]
                for seed in range(SEEDS)
            ]
        )
        second = not only and case in ("in the box", "media")
        assert len(traced) == 1 + second
        assert scene not in traced
    # Equal seeds; rounding may send a few paths elsewhere.
    first, other = np.mean(images, axis=-1)
    assert (np.abs(first - other) > 1e-3 * first.mean()).mean() < 0.02
    # Other seeds.
    half = SEEDS // 2
    means = np.array([first[:half], other[half:]]).reshape(2, half, 4, 4, 4, 4).mean(axis=(3, 5))
    error = np.hypot(*(means.std(axis=1, ddof=1) / half**0.5))
    difference, lit = (means[0] - means[1]).mean(axis=0), means.mean(axis=(0, 1)) > 0
    assert lit.sum() > 8
    assert error.mean() < 0.1 * first.mean()
    # 16 values of Student's t with 10 degrees of freedom, at 0.2 %.
    assert (np.abs(difference[lit]) < 6 * error[lit]).all()


@pytest.mark.slow
def test_illuminance_is_the_same(mi, assets, monkeypatch):
    """In the box of a lamp, below its plate and beside it, and outside of it."""
    speck = {"type": "scene", "speck": {"type": "sphere", "radius": 0.01, "center": [0, -50, 0]}}
    points = np.array([[0.1, -0.7, 0.1], [0.8, -0.7, 0.1], [0.3, -2, 0.1]])
    traced = traced_scenes(mi, monkeypatch)
    found = []
    for only in (False, True):
        monkeypatch.setattr(proxies, "_one_scene_only", lambda only=only: only)
        traced.clear()
        lamp = lumitree.Placement(assets["geometry"])
        found.append(
            lumitree.illuminance(
                speck, [lamp], points=points, normals=[0, 1, 0], error=0.2, seed=1
            ).total
        )
        assert len(traced) == (1 if only else 2)
    assert found[0] == pytest.approx(found[1], rel=0.01)
    assert found[0].all()
