"""Proxies that the integrator tests itself: where rays enter them, and images with them."""

import gc
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lumitree
from lumitree.core.device import on_device
from lumitree.core.frames import rotation, similarity
from support.equal_means import assert_equal_means
from support.fields import random_asset

PLACES = (
    # centre, size, degrees
    # No two faces are in one plane: where they are, a traced ray misses one of them.
    ([0.0, 0.0, 0.0], 1.0, 0),
    ([1.0, 0.1, 0.05], 1.0, 5),
    ([0.3, 0.2, 0.1], 2.0, 40),
    ([-2.0, 0.5, 0.0], 0.8, 20),
)


@pytest.fixture
def lamps(mi, tmp_path):
    """Shape dictionaries of lamps at `PLACES`."""
    asset = random_asset(5, density_scale=3.0, half_extents=np.array([1.0, 0.7, 0.5]))
    path = tmp_path / "lamp.lumitree"
    lumitree.save(asset, path)
    return {
        f"lamp{i}": lumitree.shape(path, similarity(rotation([0, 1, 1], turn), size, at))
        for i, (at, size, turn) in enumerate(PLACES)
    }


def entries(proxies, ray, end):
    """Distances and emitters [K, N] of the proxies that rays enter, in order."""
    from lumitree.rendering.proxies import NONE

    found = []
    distance, lamp = proxies.first(ray, end, end > 0)
    for _ in range(len(PLACES) + 1):
        found.append((np.array(distance), np.array(lamp)))
        active = lamp != NONE
        distance, lamp = proxies.next(ray, distance, lamp, end, active)
    assert (found[-1][1] == NONE).all()
    return np.array([d for d, _ in found]), np.array([i for _, i in found])


def random_rays(mi, count=4000, seed=1):
    random = np.random.default_rng(seed)
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    origin = (
        random.uniform(-1.5, 1.5, (count, 3)) - random.choice([0, 4], count)[:, None] * direction
    )
    ray = mi.Ray3f(on_device(mi.Point3f, origin), on_device(mi.Vector3f, direction))
    return ray


def test_rays_enter_proxies_where_they_meet_their_shapes(mi, lamps):
    """Against rays that are traced to the shape of each proxy alone."""
    from lumitree.rendering.proxies import NONE, Proxies

    ray = random_rays(mi)
    end = np.random.default_rng(2).uniform(0.5, 8, 4000)
    scene = mi.load_dict({"type": "scene", **lamps})
    gc.collect()
    emitters = scene.emitters()
    distance, lamp = entries(Proxies(emitters), ray, on_device(mi.Float, end))
    expected = np.full((len(emitters), 4000), np.inf)
    for index, emitter in enumerate(emitters):
        alone = mi.load_dict({"type": "scene", "shape": emitter.get_shape()})
        si = alone.ray_intersect(ray)
        enters = np.array(si.is_valid()) & (np.array(si.wi.z) > 0) & (np.array(si.t) < end)
        expected[index, enters] = np.array(si.t)[enters]
    assert 0.1 < np.isfinite(expected).mean() < 0.9
    order = np.argsort(expected, axis=0, kind="stable")
    met = np.isfinite(np.take_along_axis(expected, order, axis=0))
    # Rounding decides rays that graze an edge, or that end where they enter.
    agree = ((lamp[:-1] == np.where(met, order, NONE)) | ~np.isfinite(expected).any(0)).all(0)
    assert agree.mean() > 0.998
    sorted_distance = np.take_along_axis(expected, order, axis=0)
    both = met & agree
    assert distance[:-1][both] == pytest.approx(sorted_distance[both], rel=1e-4, abs=1e-4)


def test_a_ray_finds_the_proxies_of_a_hall(mi, tmp_path):
    """Against all boxes one after the other."""
    from lumitree.rendering.proxies import NONE, Proxies

    asset = random_asset(5, half_extents=np.array([1.0, 0.7, 0.5]))
    random = np.random.default_rng(3)
    places = [
        similarity(rotation(random.normal(size=3), 60), random.uniform(0.05, 0.4), at)
        for at in random.uniform([-5, -1, -5], [5, 1, 5], (80, 3))
    ]
    scene = mi.load_dict(
        {"type": "scene", **{f"lamp{i}": lumitree.shape(asset, m) for i, m in enumerate(places)}}
    )
    gc.collect()
    emitters, count = scene.emitters(), 2000
    origin = random.uniform([-6, -1.5, -6], [6, 1.5, 6], (count, 3))
    direction = random.normal(size=(count, 3)) * [1, 0.2, 1]
    direction[:100] = np.eye(3)[random.integers(3, size=100)]
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    end = random.uniform(1, 12, count)
    entry = np.full((count, len(emitters)), np.inf)
    for index, emitter in enumerate(emitters):
        matrix, centre = emitter.lamp.unit_proxy()
        with np.errstate(divide="ignore", invalid="ignore"):
            o, d = (origin - centre) @ matrix.T, direction @ matrix.T
            near, far = ((side * np.sign(d) - o) / d for side in (-1, 1))
        first = near.max(axis=1)
        meets = (first <= far.min(axis=1)) & (first > 0) & (first < end)
        entry[meets, index] = first[meets]
    expected = np.where(np.isfinite(entry), np.argsort(np.argsort(entry, axis=1), axis=1), -1)
    ray = mi.Ray3f(on_device(mi.Point3f, origin), on_device(mi.Vector3f, direction))
    end = on_device(mi.Float, end)
    proxies, found = Proxies(emitters), np.full((count, len(emitters)), -1)
    distance, lamp = proxies.first(ray, end, end > 0)
    step = 0
    while (met := np.array(lamp) != NONE).any():
        rows = np.flatnonzero(met)
        assert (found[rows, np.array(lamp)[rows]] == -1).all()
        found[rows, np.array(lamp)[rows]] = step
        distance, lamp = proxies.next(ray, distance, lamp, end, lamp != NONE)
        step += 1
    assert step > 3
    # Rounding decides rays that graze an edge.
    assert (found == expected).all(axis=1).mean() > 0.998


def test_proxies_that_are_entered_at_one_distance_are_all_entered(mi, tmp_path):
    """Each once, in the order of their emitters."""
    from lumitree.rendering.proxies import NONE, Proxies

    path = tmp_path / "cube.lumitree"
    lumitree.save(random_asset(5), path)
    place = similarity(np.eye(3), 0.5, [0, 0, 0])
    # Mitsuba makes one emitter of equal ones.
    shapes = {f"lamp{i}": lumitree.shape(path, place, gain=1 + i) for i in range(3)}
    scene = mi.load_dict({"type": "scene", **shapes})
    gc.collect()
    ray = mi.Ray3f(mi.Point3f(0.1, 0.2, 5), mi.Vector3f(0, 0, -1))
    proxies = Proxies(scene.emitters())
    distance, lamp = proxies.first(ray, mi.Float(np.inf), mi.Bool(True))
    found = []
    while lamp[0] != NONE:
        found.append((int(lamp[0]), float(distance[0])))
        distance, lamp = proxies.next(ray, distance, lamp, mi.Float(np.inf), mi.Bool(True))
    assert found == [(i, pytest.approx(4.5)) for i in range(3)]


def room(mi, **objects):
    look = mi.ScalarTransform4f().look_at([0, 2, 6], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    wall = mi.ScalarTransform4f().translate([0, 0, -3]).scale(6)
    light = mi.ScalarTransform4f().translate([0, 4, 0]).rotate([1, 0, 0], 90)
    from lumitree.rendering.objects import load_ordered

    scene = {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 40, "to_world": look, "film": film},
        "wall": {"type": "rectangle", "to_world": wall, "bsdf": {"type": "roughplastic"}},
        "light": {
            "type": "rectangle",
            "to_world": light,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [5, 4, 3]}},
        },
        "ball": {"type": "sphere", "center": [0.2, 0, 0.9], "radius": 0.3},
    }
    return load_ordered(scene | objects)


def image(mi, scene, integrator, seed=0, spp=32):
    return np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed))


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [False, True])
def test_a_divided_scene_looks_the_same(mi, lamps, hidden):
    """As under `volpath`, which traces the proxies: a ball before four lamps before a wall.

    Two of the lamps overlap. In a lamp's box it would not look the same: `volpath` does not know
    where rays end there.
    """
    ball = {"type": "sphere", "center": [0.4, 0.3, 3.0], "radius": 0.3}
    scene = room(mi, **lamps, ball=ball)
    kinds = [
        mi.load_dict({"type": kind, "max_depth": 4, "hide_emitters": hidden})
        for kind in ("lumitree_path", "volpath")
    ]
    batches = np.array([[image(mi, scene, k, seed) for seed in range(12)] for k in kinds])
    assert_equal_means(*batches)
    means = batches.mean(axis=(2, 3))
    assert means.min() > 0
    assert_equal_means(*means, p=3e-4)


@pytest.mark.slow
def test_a_divided_scene_follows_its_shapes(mi, lamps):
    """A mesh and a sphere are moved: the image equals one of a scene that was loaded so."""
    lamp = {"lamp0": lamps["lamp0"]}
    cube = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([-1, 0, 0]).scale(0.3)}
    scene = room(mi, cube=cube, **lamp)
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": 3})
    before = image(mi, scene, integrator)
    parameters = mi.traverse(scene)
    vertices = np.array(parameters["cube.vertex_positions"]).reshape(-1, 3)
    vertices[:, 0] += 2
    parameters["cube.vertex_positions"] = on_device(mi.Float, vertices)
    parameters["ball.to_world"] = mi.Transform4f().translate([0, 1.2, 0]).scale(0.3)
    parameters.update()
    after = image(mi, scene, integrator)
    moved = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([1, 0, 0]).scale(0.3)}
    ball = {"type": "sphere", "to_world": mi.ScalarTransform4f().translate([0, 1.2, 0]).scale(0.3)}
    other = mi.load_dict({"type": "lumitree_path", "max_depth": 3})
    expected = image(mi, room(mi, cube=moved, **lamp, ball=ball), other)
    assert np.abs(after - before).max() > 0.1
    # Equal seeds; rounding may send a few paths elsewhere.
    assert np.median(np.abs(after - expected)) < 1e-4
    assert after.mean() == pytest.approx(expected.mean(), rel=0.01)


def test_a_ray_keeps_the_lamps_it_has_met(mi):
    """As many as there are; and each of those whose boxes overlap, so that it may come back."""
    from lumitree.rendering.proxies import NONE, Owners

    nothing = SimpleNamespace(shape_numbers=[], medium_numbers=[])
    lamps: Any = dict.fromkeys(range(0, 300, 3), nothing)
    cases = (
        ([], [273]),
        ([(3, 0), (3, 273)], [273, 3]),
        ([(0, 3), (3, 273), (273, 0)], [0, 3, 273]),
    )
    for overlaps, kept in cases:
        owners = Owners(lamps, overlaps)
        met = owners.no_lamps()
        for index in (0, 3, NONE, 273):
            owners.add(met, mi.UInt32(index), mi.Bool(True))
        owners.add(met, mi.UInt32(9), mi.Bool(False))
        assert [np.array(each)[0] for each in met] == kept
        index = mi.UInt32([3, 4, 999, NONE])
        assert np.array(owners.is_lamp(index, mi.Bool(True))).tolist() == [1, 0, 0, 0]


def test_surfaces_are_built_again_only_when_shapes_change(mi, lamps):
    from lumitree.rendering.proxies import DividedScene

    scene = room(mi, lamp0=lamps["lamp0"])
    divided = DividedScene()
    first, proxies, *_ = divided.of(scene)
    assert proxies.exist
    assert len(first.shapes()) == len(scene.shapes()) - 1
    parameters = mi.traverse(scene)
    (gain,) = (name for name in parameters.properties if name.endswith("gain"))
    parameters[gain] = mi.Color3f(2, 1, 1)
    parameters.update()
    assert divided.of(scene)[0] is first
    parameters["ball.to_world"] = mi.Transform4f().scale(0.5)
    parameters.update()
    assert divided.of(scene)[0] is not first


def test_a_scene_without_lamps_is_not_divided(mi):
    from lumitree.rendering.proxies import DividedScene

    plain = room(mi)
    surfaces, proxies, *_ = DividedScene().of(plain)
    assert surfaces is plain
    assert not proxies.exist


def test_a_scene_with_instances_is_divided(mi, lamps):
    from lumitree.rendering.proxies import NONE, DividedScene

    group = {"type": "shapegroup", "ball": {"type": "sphere", "radius": 0.2}}
    repeated = {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}}
    scene = room(mi, group=group, repeated=repeated, lamp0=lamps["lamp0"])
    surfaces, proxies, *_ = DividedScene().of(scene)
    assert surfaces is not scene
    assert len(surfaces.shapes()) == len(scene.shapes()) - 1
    ray = mi.Ray3f(mi.Point3f(9, 0.05, 0.05), mi.Vector3f(-1, 0, 0))
    distance, lamp = proxies.first(ray, mi.Float(20), mi.Bool(True), mi.Bool(False))
    assert np.array(lamp)[0] != NONE
    # The instance is behind the proxy.
    assert np.array(surfaces.ray_intersect(ray).t)[0] > np.array(distance)[0]


def test_lamps_of_another_scene_with_the_same_surfaces_light_what_is_in_their_boxes(mi, tmp_path):
    """As if a scene is loaded again with a lamp elsewhere, and the integrator is kept."""
    from lumitree.asset.asset import light_field_asset
    from lumitree.core.frames import LocalFrame
    from lumitree.rendering.proxies import DividedScene
    from support.light_fields import random_light_field

    frame = LocalFrame(np.array([1.0, 0.7, 0.5]), np.eye(4))
    asset = light_field_asset(random_light_field(1), frame, "lamp")
    surfaces = {f"room{i}": shape for i, shape in enumerate(room(mi).shapes())}
    divided = DividedScene()
    for x, holds in ((20.0, False), (0.2, True)):
        place = similarity(rotation([0, 1, 1], 0), 1.0, [x, 0, 0.9])
        scene = mi.load_dict({"type": "scene", "lamp": lumitree.shape(asset, place), **surfaces})
        divided.of(scene)
        found = [e.lamp.lights_inside for e in scene.emitters() if hasattr(e, "lamp")]
        assert found == [holds]
