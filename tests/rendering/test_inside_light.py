"""Light for receivers inside a lamp's box: closed forms, and against the explicit lamp."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import lumitree
from lumitree.asset.light_field import (
    LightInside,
    by_coarse_bin,
    make_light_field,
    pack,
    parts_of_ending,
)
from lumitree.core.frames import rotation, similarity
from lumitree.octree.build import morton
from lumitree.rendering.scene import place_shapes
from support.explicit_lamps import BLACK, assert_alike, baked, blocks, camera
from support.lamps import GLASS, cube, sphere
from support.receivers import HALF, uniform_samples

GREY = '<bsdf type="diffuse"><rgb name="reflectance" value="0.5,0.5,0.5"/></bsdf>'
RADIANCE = np.array([6.0, 5.0, 3.0])
GLOWS = f'{BLACK}<emitter type="area"><rgb name="radiance" value="6,5,3"/></emitter>'
BULB, DISC = 0.2, 0.4
# Two small cubes make the box large; else it has a small light and a plate below it.
CORNERS = (
    cube("left", 0.03, (-0.97, -0.97, -0.97), BLACK),
    cube("right", 0.03, (0.97, 0.97, 0.97), BLACK),
)
LAMP = (sphere("bulb", BULB, inside=GLOWS), cube("plate", (DISC, 0.02, DISC), (0, -0.5, 0), BLACK))
PLACE = similarity(rotation([0, 1, 1], 20), 0.4, [0, 1, 0])


@pytest.fixture(scope="module")
def plate(mi, tmp_path_factory):
    return baked(tmp_path_factory.mktemp("plate"), *LAMP, *CORNERS)


def placed(mi, asset, place, appearance: Any = "geometry", **things):
    """A scene with an asset, and with something in its box that is not near the receivers."""
    speck = {"type": "sphere", "radius": 0.01 * np.linalg.norm(place[:3, 0])}
    speck["center"] = (place @ [0.9, -0.9, 0.9, 1])[:3].tolist()
    lamp = lumitree.shape(asset, place, appearance=appearance)
    return mi.load_dict({"type": "scene", "lamp": lamp, "speck": speck, **things})


def received(scene, place, points, normals, samples=1 << 15):
    from benchmarks.inside_box.received import received_irradiance

    points = np.asarray(points) @ place[:3, :3].T + place[:3, 3]
    return received_irradiance(scene, points, np.asarray(normals) @ place[:3, :3].T, samples)


@pytest.mark.parametrize("appearance", ["geometry", "field"])
@pytest.mark.parametrize("place", [np.eye(4), PLACE], ids=["at home", "placed"])
def test_light_of_a_sphere_beside_a_plate(mi, plate, place, appearance):
    """E = π L a² cos θ / d² where the plate leaves the way free, else none."""
    points = np.array([[0.7, 0, 0], [0.3, 0.5, 0.4], [0, -0.35, 0], [0.9, -0.3, 0], [0, -0.8, 0]])
    normals = np.array([[-1, 0, 0], [0, -1, 0], [0, 1, 0], [-1, 1, 0], [0, 1, 0]])
    distance = np.linalg.norm(points, axis=1)
    unit = normals / np.linalg.norm(normals, axis=1)[:, None]
    cosine = -(points * unit).sum(axis=1) / distance
    expected = np.pi * BULB**2 * cosine / distance**2
    expected[4] = 0
    found = received(placed(mi, plate[1], place, appearance), place, points, normals)
    shadow = expected.max() * (0.002 if appearance == "geometry" else 0.02)
    near = found / RADIANCE / np.maximum(expected, shadow)[:, None]
    assert near[:4] == pytest.approx(1, rel=0.08)
    assert near[4].max() < 1


def test_flux_through_a_closed_box_about_the_light(mi, plate):
    """All light of the bulb passes it: what leaves the lamp, and what ends on it."""
    side = 0.35
    grid = (np.arange(6) + 0.5) / 3 - 1
    points, normals = [], []
    for axis in range(3):
        for sign in (-1, 1):
            u, v = (each.ravel() * side for each in np.meshgrid(grid, grid))
            points.append(np.insert(np.stack([u, v], axis=1), axis, sign * side, axis=1))
            normals.append(np.tile(np.insert([0, 0], axis, -sign), (len(u), 1)))
    place = np.eye(4)
    light = received(
        placed(mi, plate[1], place), place, np.concatenate(points), np.concatenate(normals), 1 << 12
    )
    flux = light.mean(axis=0) * 24 * side**2
    assert flux / RADIANCE == pytest.approx(4 * np.pi**2 * BULB**2, rel=0.02)


def test_receivers_anywhere_get_finite_light(mi, plate):
    """On faces and edges of the box, in the bulb's own cells, on its surface, at its centre."""
    half = plate[1].frame.half_extents
    random = np.random.default_rng(0)
    towards = random.normal(size=(50, 3))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    points = np.concatenate(
        [
            half * [1, 0.2, 0.1],
            half * [1, 1, 0.1],
            half,
            (BULB + 1e-4) * towards,
            (BULB + 0.03) * towards,
            np.zeros(3),
        ],
        axis=None,
    ).reshape(-1, 3)
    scene = placed(mi, plate[1], np.eye(4))
    light = received(scene, np.eye(4), points, -points + 1e-9, 1 << 10)
    assert np.isfinite(light).all()
    assert (light >= 0).all()
    # Nothing gets more than from a hemisphere of the light, but for the blur of a cell.
    assert (light[3:-1] / RADIANCE).max() < 2 * np.pi


@pytest.mark.slow
def test_points_and_rays_share_the_light(mi):
    """By direction and distance, both parts add up to the sum over cells along each ray."""
    import drjit as dr

    from lumitree.core.octahedral import bin_of, solid_angles
    from lumitree.rendering.device_light import DeviceLight, InsideLight, smooth_bin

    random = np.random.default_rng(4)
    cells = np.argwhere(np.ones((8, 8, 8)))
    cells = cells[(np.abs((cells + 0.5) / 4 - 1) < HALF).all(axis=1)]
    cells = cells[random.choice(len(cells), 24, replace=False)]
    cells = cells[np.argsort(morton(cells))]
    intensity = np.repeat(random.exponential(1, (16, 64, 1)), 3, axis=2) * (
        random.random((16, 64, 1)) < 0.4
    )
    field = make_light_field(cells[:16], intensity, 3)
    ending = random.random((24, 16)) * 0.8 + 0.1
    inside = LightInside(
        cells=cells.astype(np.uint8),
        lit=np.full((24, 2), 255, np.uint8),
        intensity=pack(np.repeat(ending.reshape(-1, 1), 3, axis=1)),
        reach=np.zeros(24 * 16, np.uint8),
        bent=pack(np.repeat(ending.reshape(-1, 1), 3, axis=1)),
        bent_reach=np.zeros(24 * 16, np.uint8),
        distances=np.array([0, 3.0, 4.0], np.float32),
        reach_curves=np.array([[1, 1, 0]], np.float32),
        scale=2.0,
    )
    field = dataclasses.replace(field, inside=inside)
    gain = (1.0, 1.0, 1.0)
    light = InsideLight(field, HALF, DeviceLight(field, HALF), gain)
    count, coarse, b = 1 << 20, 4, 0.3
    x = mi.Point3f(*(dr.opaque(mi.Float, each) for each in (0.31, -0.22, 0.13)))
    sample = uniform_samples(mi, count).next_2d()
    every, end = mi.Bool(True), mi.Float(dr.inf)
    direction, target = light.sample_point(x, mi.Vector3f(0), sample, every)
    weight = light.contribution(target, mi.Float(b), every)
    plain = mi.warp.square_to_uniform_sphere(uniform_samples(mi, count, 1).next_2d())
    rest = light.received(x, x, plain, mi.Float(1 / b), end, every)
    whole = light.received(x, x, plain, mi.Float(0), end, every)
    missing = np.array(whole - rest, np.float64)[1] * 4 * np.pi
    found = np.array(weight, np.float64)[1]
    parts = [
        np.bincount(np.array(bin_of(d, coarse)), v**k, coarse**2) / count
        for d, v in ((direction, found), (plain, missing))
        for k in (1, 2)
    ]
    error = np.sqrt((parts[1] + parts[3]) / count)
    assert error.max() < 0.05 * parts[2].max()
    assert (np.abs(parts[0] - parts[2]) < 4.5 * error).all()
    # The whole radiance of some rays, as a sum over all cells.
    lower = np.maximum(cells / 4 - 1, -HALF)
    upper = np.minimum(cells / 4 - 0.75, HALF)
    rays = np.array(plain).T[:64]
    fine = np.array(smooth_bin(-plain, 8, x))[:64]
    leaving = np.zeros((24, 64))
    from lumitree.asset.light_field import unpack

    rows = np.searchsorted(morton(cells), morton(field.cells))
    leaving[rows] = field.scale * field.dense(unpack(field.intensity)[:, 1])
    members = by_coarse_bin(np.arange(64)[None])[0]
    of_entries = inside.scale * unpack(inside.intensity)[:, 1].reshape(24, 16)
    parts = parts_of_ending(by_coarse_bin(leaving), of_entries, solid_angles(8)[members])
    sent = leaving.copy()
    sent[:, members] += parts * of_entries[..., None]
    for i, ray in enumerate(rays):
        with np.errstate(divide="ignore"):
            planes = np.sort([(lower - np.array(x).T) / ray, (upper - np.array(x).T) / ray], axis=0)
        length = planes[1].min(axis=1) - np.maximum(planes[0].max(axis=1), 0)
        expected = (sent[:, fine[i]] * np.maximum(length, 0) / (upper - lower).prod(axis=1)).sum()
        assert np.array(whole)[1, i] == pytest.approx(expected, rel=0.01, abs=1e-4)


def still_life(mi):
    """A ball between the lamp's bulb and a floor, and a mirror, all in the box."""
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    to = mi.ScalarTransform4f
    upright = to().translate([-0.7, -0.2, 0]).rotate([0, 1, 0], 90).scale(0.5)
    return {
        "ball": {"type": "sphere", "center": [0.4, -0.55, 0.3], "radius": 0.18, "bsdf": grey},
        "floor": {
            "type": "rectangle",
            "to_world": to().translate([0, -0.8, 0]).rotate([1, 0, 0], -90).scale(3),
            "bsdf": grey,
        },
        "mirror": {"type": "rectangle", "to_world": upright, "bsdf": {"type": "conductor"}},
    }


@pytest.mark.slow
@pytest.mark.parametrize("view", ["all", "ball", "mirror", "outside"])
def test_a_ball_in_the_box_looks_as_under_the_explicit_lamp(mi, plate, view):
    """Lit, its shadow on a floor in the box and beyond it, and its image in a mirror."""
    lamp, asset = plate
    sensor = {
        "all": camera(mi, [2.5, 2.0, 3.0], [0, -0.5, 0], 40),
        "ball": camera(mi, [1.5, 0.4, 1.5], [0.5, -0.7, 0.4], 25),
        "mirror": camera(mi, [2.0, 0.2, 0.0], [-0.7, -0.2, 0.1], 25),
        "outside": camera(mi, [2.2, 1.5, 2.2], [1.3, -0.8, 1.0], 25),
    }[view]
    things = still_life(mi)
    explicit = blocks(mi, things | place_shapes(lamp, np.eye(4)), sensor, spp=512)
    found = blocks(
        mi, things | {"lamp": lumitree.shape(asset, appearance="geometry")}, sensor, spp=256
    )
    # Near things see the blur of cells.
    assert_alike(found, explicit, 0.1 if view == "ball" else 0.05)


@pytest.mark.slow
def test_lamps_whose_boxes_overlap(mi, plate):
    """Each lights and shades what is in the other's box, its surfaces too."""
    lamp, asset = plate
    other = similarity(rotation([0, 1, 0], 30), 0.7, [0.5, 0.35, -0.6])
    floor = {"floor": still_life(mi)["floor"]}
    sensor = camera(mi, [2.5, 2.0, 3.0], [0.2, -0.4, -0.3], 40)
    explicit = floor | {
        f"lamp{i}_{name}": each
        for i, place in enumerate((np.eye(4), other))
        for name, each in place_shapes(lamp, place).items()
    }
    lamps = {
        f"lamp{i}": lumitree.shape(asset, place, appearance="geometry")
        for i, place in enumerate((np.eye(4), other))
    }
    assert_alike(
        blocks(mi, floor | lamps, sensor, spp=256), blocks(mi, explicit, sensor, spp=512), 0.05
    )


@pytest.mark.slow
@pytest.mark.parametrize("shown", ["geometry", "explicit"])
def test_a_lamp_in_the_box_of_another_throws_its_shadow(mi, plate, tmp_path, shown):
    """A disc that hardly shines hangs over the bulb, in its box; above the disc it is dark."""
    dim = f'{BLACK}<emitter type="area"><rgb name="radiance" value="0.001,0.001,0.001"/></emitter>'
    parts = cube("disc", (0.35, 0.02, 0.35), inside=BLACK), sphere("dim", 0.02, (0, -0.1, 0), dim)
    disc, asset = baked(tmp_path / "disc", *parts, paths=1 << 16)
    place = similarity(np.eye(3), 1.0, [0, 0.5, 0])
    other = {"disc": lumitree.shape(asset, place, appearance="geometry")}
    if shown == "explicit":
        other = place_shapes(disc, place)
    # Within the box, near it and far away; the last two beside the shadow.
    points = np.array([[0, 0.9, 0], [0, 1.3, 0], [0.3, 4, 0], [2.5, 1.5, 0], [4, 0.5, 0]])
    normals = -points / np.linalg.norm(points, axis=1)[:, None]
    light = received(placed(mi, plate[1], np.eye(4), **other), np.eye(4), points, normals, 1 << 13)
    clear = np.pi * BULB**2 / (points**2).sum(axis=1)[:, None] * RADIANCE
    assert (light[:3] < 0.02 * clear[:3]).all()
    assert light[3:] / clear[3:] == pytest.approx(1, rel=0.1)


@pytest.mark.slow
def test_glass_about_the_light(mi, tmp_path):
    """Light that leaves a bulb of glass reaches the objects beside it."""
    bulb = (
        sphere("filament", 0.08, inside=GLOWS),
        sphere("glass", 0.25, inside=GLASS),
        sphere("hollow", 0.22, inside=GLASS, flip=True),
        cube("plate", (DISC, 0.02, DISC), (0, -0.5, 0), GREY),
    )
    asset = baked(tmp_path / "bulb", *bulb, *CORNERS, paths=1 << 22)[1]
    random = np.random.default_rng(1)
    # Above the plate, two cells from it; beside the bulb; and below the plate.
    x, z = random.uniform(-0.2, 0.2, (2, 30))
    above = np.stack([x, np.full(30, -0.355), z], axis=1)
    beside = random.normal(size=(30, 3)) * [1, 0.3, 1]
    beside *= 0.7 / np.linalg.norm(beside, axis=1)[:, None]
    below = [[0, -0.6, 0]]
    points = np.concatenate([above, beside, below])
    normals = np.concatenate([np.tile([0, 1, 0], (30, 1)), -beside, [[0, 1, 0]]])
    light = received(placed(mi, asset, np.eye(4)), np.eye(4), points, normals, 1 << 12) / RADIANCE
    distance = np.linalg.norm(points, axis=1)
    plain = np.pi * 0.08**2 / distance**2
    plain[:30] *= 0.355 / distance[:30]
    # The glass reflects 8 % of the filament's light, most of which leaves it in the end.
    for part in (slice(0, 30), slice(30, 60)):
        assert light[part].mean() / plain[part].mean() == pytest.approx(0.97, abs=0.08)
    assert light[60].max() < 0.01 * light[:30].mean()


@pytest.mark.slow
def test_a_scene_with_instances_lights_what_is_in_the_box(mi, plate):
    """As one without."""
    repeated = {
        "group": {"type": "shapegroup", "ball": {"type": "sphere", "radius": 0.1}},
        "repeated": {
            "type": "instance",
            "shapegroup": {"type": "ref", "id": "group"},
            "to_world": mi.ScalarTransform4f().translate([9, 9, 9]),
        },
    }
    things = still_life(mi) | {"lamp": lumitree.shape(plate[1])}
    sensor = camera(mi, [2.5, 2.0, 3.0], [0, -0.5, 0], 40)
    plain = blocks(mi, things, sensor, spp=256)
    assert_alike(blocks(mi, repeated | things, sensor, spp=256), plain, 0.03)
