"""Straight light, which is traced on a lamp's own emitters: closed forms, and explicit lamps."""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest

import lumitree
from lumitree.core.frames import rotation, similarity
from lumitree.lamp.stored_geometry import stored_geometry
from lumitree.rendering.scene import place_shapes
from support.explicit_lamps import BLACK, assert_alike, baked, blocks, camera
from support.lamps import GLASS, cube, lamp_of, sphere
from support.slow import slow


def glows(*radiance, flip=False):
    """Description of a black surface that emits."""
    r, g, b = radiance
    flipped = '<boolean name="flip_normals" value="true"/>' if flip else ""
    light = f'<emitter type="area"><rgb name="radiance" value="{r},{g},{b}"/></emitter>'
    return BLACK + light + flipped


def placed_shape(kind, name, inside, scale=(1, 1, 1), turn=(0, 1, 0, 0), at=(0, 0, 0)):
    """A shape scaled, turned and moved."""
    numbers = (*scale, *turn, *at)
    return (
        f'<shape type="{kind}" id="{name}"><transform name="to_world">'
        '<scale x="{}" y="{}" z="{}"/><rotate x="{}" y="{}" z="{}" angle="{}"/>'
        '<translate x="{}" y="{}" z="{}"/></transform>'.format(*numbers)
        + f"{inside}</shape>"
    )


def straight(lamp, field=None, gain=(1.0, 1.0, 1.0)):
    """The emitters of a lamp."""
    from lumitree.rendering.geometry import Surfaces
    from lumitree.rendering.straight_light import StraightLight

    surfaces = Surfaces(stored_geometry(lamp)).emitting(lamp.frame)
    return StraightLight(surfaces, field, lamp.frame.half_extents, gain)


def irradiance(mi, light, points, normals, inside=False, count=1 << 15):
    """Irradiance [N, 3] of local points by emitter sampling alone, and its standard error."""
    import drjit as dr

    from lumitree.rendering.sampling import STRAIGHT, Target

    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    x, n = (np.repeat(np.asarray(each, np.float32), count, axis=0).T for each in (points, normals))
    x, n = mi.Point3f(np.ascontiguousarray(x)), mi.Vector3f(np.ascontiguousarray(n))
    random = mi.load_dict({"type": "independent"})
    random.seed(0, len(points) * count)
    sample, active = random.next_2d(), dr.full(mi.Bool, True, len(points) * count)
    target = Target.at(dr.zeros(mi.Float, len(points) * count))
    light.choose(x, n, sample, target, active, mi.Bool(inside))
    active &= target.place == STRAIGHT
    direction = light.sample(x, target, sample, active)
    found = dr.select(active, target.light * dr.maximum(dr.dot(direction, n), 0), 0)
    found = np.array(found, np.float64).T.reshape(len(points), count, 3)
    return found.mean(axis=1), found.std(axis=1) / count**0.5


def of_polygon(corners, x, n):
    """Irradiance of a polygon of radiance 1 that nothing hides, over its part above the horizon."""
    kept = []
    relative = corners - x
    for a, b in zip(relative, np.roll(relative, -1, axis=0), strict=True):
        if a @ n > 0:
            kept.append(a)
        if (a @ n > 0) != (b @ n > 0):
            kept.append(a + (b - a) * (a @ n) / (a @ n - b @ n))
    if len(kept) < 3:
        return 0.0
    total = 0.0
    for a, b in zip(kept, kept[1:] + kept[:1], strict=True):
        across = np.cross(a, b)
        angle = math.atan2(np.linalg.norm(across), a @ b)
        total += angle * (across @ n) / max(np.linalg.norm(across), 1e-300)
    return abs(total) / 2


def of_sphere(centre, radius, x, n):
    """Irradiance of a sphere of radiance 1 that is above the horizon."""
    offset = centre - x
    return math.pi * radius**2 * (offset @ n) / np.linalg.norm(offset) ** 3


# Rectangles by half sides, rotation and centre; of one side, radiance [3].
PANELS = (
    ((0.5, 0.3, 1), (1, 0, 0, 90), (0, 0.8, 0), (1, 2, 3)),
    ((0.02, 0.02, 1), (0, 1, 0, 0), (0.6, 0, 0.2), (900, 100, 10)),
    ((0.3, 0.3, 1), (0.6, 0, 0.8, 130), (-0.5, -0.2, 0), (0, 4, 0)),
)
BALLS = (
    ((-0.4, 0.5, 0.5), 0.02, (500, 400, 0)),
    ((0.7, -0.6, -0.5), 0.2, (3, 0, 5)),
    ((0.9, -0.9, 0.9), 0.05, (0, 0, 0)),
)
CORNERS = (cube("left", 0.03, (-1, -1, -1), BLACK), cube("right", 0.03, (1, 1, 1), BLACK))


@pytest.fixture(scope="module")
def bare(mi, tmp_path_factory):
    """A lamp of panels and balls; they hide each other, which emitter sampling leaves aside."""
    panels = [
        placed_shape("rectangle", f"panel{i}", glows(*radiance), scale, turn, at)
        for i, (scale, turn, at, radiance) in enumerate(PANELS)
    ]
    balls = [sphere(f"ball{i}", r, at, glows(*c)) for i, (at, r, c) in enumerate(BALLS)]
    return lamp_of(tmp_path_factory.mktemp("bare"), *panels, *balls, *CORNERS)


def expected_irradiance(points, normals):
    total = np.zeros((len(points), 3))
    for i, (x, n) in enumerate(zip(points, normals, strict=True)):
        n = n / np.linalg.norm(n)
        for scale, turn, at, radiance in PANELS:
            axes = rotation(turn[:3], turn[3])
            square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * scale
            if axes[:, 2] @ (x - at) > 0:
                total[i] += of_polygon(square @ axes.T + at, x, n) * np.array(radiance)
        for at, radius, radiance in BALLS:
            # Small or far from the horizon of all receivers.
            total[i] += max(of_sphere(np.array(at), radius, x, n), 0) * np.array(radiance)
    return total


OUTSIDE = np.array(
    [[3, -1, 0.5], [0.1, -1.5, 0], [-0.9, 1.04, 0.3], [-40, 12, 9], [1.05, 0.2, 0.1]]
)
INSIDE = np.array([[0.1, -0.1, 0.1], [0, -0.9, 0], [-0.4, 0.45, 0.5], [0.6, 0, 0.21], [1.03, 0, 0]])


@pytest.mark.parametrize("gain", [(1.0, 1.0, 1.0), (0.0, 2.0, 0.5)], ids=["plain", "gain"])
@pytest.mark.parametrize("inside", [False, True], ids=["outside", "inside"])
def test_irradiance_of_open_emitters(mi, bare, inside, gain):
    """As the sum of closed forms over panels and balls, on the faces and near emitters too."""
    points = INSIDE if inside else OUTSIDE
    scale, centre = bare.frame.scale, bare.frame.world_from_local[:3, 3]
    axes = bare.frame.world_from_local[:3, :3] / scale
    assert axes == pytest.approx(np.eye(3))
    normals = np.array([-0.1, 0.2, 0.1]) - points
    expected = expected_irradiance(points, normals) * gain
    light = straight(bare, gain=gain)
    found, error = irradiance(mi, light, (points - centre) / scale, normals, inside)
    assert np.isfinite(found).all()
    # Beside the small panel, samples of it are rare and bright.
    assert (error[expected > 0] < 0.2 * expected[expected > 0]).all()
    assert (np.abs(found - expected) <= 4.5 * error + 1e-4 * expected).all()


def write_image(mi, path, pixels):
    mi.Bitmap(np.asarray(pixels, np.float32)).write(str(path))


def bitmap(name, file):
    return (
        f'<texture type="bitmap" name="{name}"><string name="filename" value="{file}"/>'
        '<boolean name="raw" value="true"/><string name="filter_type" value="nearest"/></texture>'
    )


def sharp(folder, mi, name):
    """Shapes of a lamp whose bent light is small and smooth, and its corners."""
    bulb = sphere("bulb", 0.15, (0, 0.1, 0), glows(6, 5, 3))
    if name == "shade":
        # Emitters of very different brightness, some of them small, one with a texture.
        write_image(mi, folder / "glow.exr", np.random.default_rng(3).uniform(0, 9, (4, 4, 3)))
        glow = BLACK + f'<emitter type="area">{bitmap("radiance", "glow.exr")}</emitter>'
        return (
            bulb,
            placed_shape("rectangle", "screen", glow, (0.3, 0.3, 1), (0, 1, 0, 70), (0.5, 0.1, 0)),
            placed_shape(
                "disk", "spot", glows(600, 200, 50), (0.03,) * 3, (1, 0, 0, 90), (0, -0.4, 0.5)
            ),
            sphere("dim", 0.2, (-0.6, 0.4, -0.5), glows(0.05, 0.1, 0.2)),
            sphere("black", 0.05, (0.8, 0.8, -0.8), glows(0, 0, 0)),
            cube("plate", (0.35, 0.02, 0.35), (0, -0.3, 0), BLACK),
            cube("rod", (0.05, 0.6, 0.05), (-0.3, 0, 0.3), BLACK),
            *CORNERS,
        )
    if name == "panes":
        write_image(mi, folder / "holes.exr", np.indices((8, 8)).sum(axis=0)[..., None] % 2)
        mask = f'<bsdf type="mask">{bitmap("opacity", "holes.exr")}{BLACK}</bsdf>'
        thin = (
            '<bsdf type="thindielectric"><float name="int_ior" value="1.5"/>'
            '<rgb name="specular_reflectance" value="0,0,0"/>'
            '<rgb name="specular_transmittance" value="{}"/></bsdf>'
        )
        panes = [
            placed_shape("rectangle", colour, thin.format(rgb), (0.5, 0.5, 1), (0, 1, 0, turn), at)
            for colour, rgb, turn, at in (
                ("red", "0.9,0.2,0.1", 90, (0.6, 0, 0)),
                ("blue", "0.1,0.3,0.9", 0, (0, 0, 0.6)),
            )
        ]
        holes = placed_shape("rectangle", "mask", mask, (0.6, 0.6, 1), (1, 0, 0, 90), (0, -0.5, 0))
        return (bulb, holes, *panes, *CORNERS)
    if name == "mixture":
        # Light that is straight, and light that a grey surface has reflected.
        grey = '<bsdf type="diffuse"><rgb name="reflectance" value="0.6,0.5,0.4"/></bsdf>'
        light = '<emitter type="area"><rgb name="radiance" value="2,3,4"/></emitter>'
        half = f'<bsdf type="mask"><float name="opacity" value="0.5"/>{BLACK}</bsdf>'
        return (
            bulb,
            cube("plate", (0.5, 0.02, 0.5), (0, -0.3, 0), grey),
            placed_shape("disk", "veil", half + light, (0.3,) * 3, (0, 1, 0, -50), (-0.6, 0.2, 0)),
            placed_shape(
                "sphere",
                "mirrored",
                glows(4, 1, 1, flip=True),
                (-0.15, 0.15, 0.15),
                at=(-0.4, 0.5, -0.6),
            ),
            *CORNERS,
        )
    smoke = (
        '<medium type="homogeneous" name="{}"><rgb name="sigma_t" value="0.2,0.4,0.8"/>'
        '<float name="scale" value="4"/><rgb name="albedo" value="0,0,0"/></medium>'
    )
    clear = f'<bsdf type="mask"><float name="opacity" value="0"/>{BLACK}</bsdf>'
    return (
        sphere("bulb", 0.15, (0, 0.1, 0), glows(6, 5, 3) + smoke.format("exterior")),
        sphere("other", 0.1, (0.1, -0.8, 0.1), glows(3, 5, 7)),
        cube("smoke", (0.5, 0.5, 0.5), (0.1, 0, 0), clear + smoke.format("interior")),
        *CORNERS,
    )


@pytest.fixture(scope="module")
def lamps(mi, tmp_path_factory):
    """Lamps by their names, baked on first use."""
    found = {}

    def lamp(name):
        if name not in found:
            folder = tmp_path_factory.mktemp(name)
            found[name] = baked(folder, *sharp(folder, mi, name), paths=1 << 19)
        return found[name]

    return lamp


def room(mi):
    """A floor, a glossy wall and a wall on a face of the box, a mirror and balls."""
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    gloss = {
        "type": "roughconductor",
        "alpha": 0.3,
        "specular_reflectance": {"type": "rgb", "value": 0.8},
    }
    to = mi.ScalarTransform4f
    turned = to().translate([-1.6, 0, 0]).rotate([0, 1, 0], 90).scale(2)
    return {
        "floor": {
            "type": "rectangle",
            "to_world": to().translate([0, -1.5, 0]).rotate([1, 0, 0], -90).scale(4),
            "bsdf": grey,
        },
        "wall": {"type": "rectangle", "to_world": turned, "bsdf": gloss},
        # The box ends at 1.03.
        "face": {
            "type": "rectangle",
            "to_world": to().translate([0, 0, -1.03]).scale([1.5, 1, 1]),
            "bsdf": grey,
        },
        "mirror": {
            "type": "sphere",
            "center": [1.7, -0.8, -0.6],
            "radius": 0.5,
            "bsdf": {"type": "conductor"},
        },
        "ball": {"type": "sphere", "center": [1.6, -1.1, 0.9], "radius": 0.4, "bsdf": grey},
        "inside": {"type": "sphere", "center": [0.7, -0.6, 0.6], "radius": 0.2, "bsdf": grey},
    }


def views(mi):
    return {
        "all": camera(mi, [4, 1.5, 4.5], [0, -0.4, 0], 45),
        "inside": camera(mi, [2.0, 0.0, 2.0], [0.7, -0.6, 0.6], 20),
        "face": camera(mi, [1.0, 1.9, 1.6], [0.0, 0.2, -1.03], 40),
    }


@pytest.mark.slow
@pytest.mark.parametrize("view", ["all", "inside", "face"])
@pytest.mark.parametrize("name", ["shade", "panes", "smoke", "mixture"])
def test_images_of_open_emitters(mi, lamps, name, view):
    """As the explicit lamp by Mitsuba's integrators."""
    lamp, asset = lamps(name)
    things, sensor = room(mi), views(mi)[view]
    found = blocks(
        mi, things | {"lamp": lumitree.shape(asset, appearance="geometry")}, sensor, spp=128
    )
    explicit = things | place_shapes(lamp, np.eye(4))
    integrator = "path" if name == "shade" else "volpath"
    assert_alike(found, blocks(mi, explicit, sensor, spp=512, integrator=integrator), 0.03)


SPECK = {"type": "sphere", "radius": 0.01, "center": [0.9, -0.9, 0.9]}


def received(mi, asset, points, normals, samples=1 << 12, appearance: Any = "geometry"):
    """Irradiance of points around a lamp and in it, by emitter sampling and rays of a BSDF."""
    from benchmarks.inside_box.received import received_irradiance

    lamp = lumitree.shape(asset, appearance=appearance)
    scene = mi.load_dict({"type": "scene", "lamp": lamp, "speck": SPECK})
    return received_irradiance(scene, points, normals, samples)


@pytest.fixture(scope="module")
def panel(mi, tmp_path_factory):
    """A panel in the plane z = 0, and a black emitter far from it."""
    shape = placed_shape("rectangle", "panel", glows(3, 2, 1), (0.5, 0.5, 1))
    black = sphere("black", 0.05, (0.9, -0.9, 0.9), glows(0, 0, 0))
    return baked(tmp_path_factory.mktemp("panel"), shape, black, *CORNERS, paths=1 << 16)[1]


def test_emitters_whose_plane_has_the_origin_of_the_scene(mi, panel):
    """The camera sees them: emitter sampling could not have found what it sees."""
    ball = {"type": "sphere", "radius": 0.1, "center": [900, 0, 0], "emitter": {"type": "area"}}
    things = {"lamp": lumitree.shape(panel, appearance="geometry"), "ball": ball}
    seen, _ = blocks(mi, things, camera(mi, [0.3, 0.2, 4], [0, 0, 0], 10), spp=1, passes=2)
    assert seen == pytest.approx(2, rel=1e-5)
    far, _ = blocks(mi, things, camera(mi, [900, 0, 1], [900, 0, 0], 3), spp=1, passes=2)
    assert far == pytest.approx(1, rel=1e-5)


def test_receivers_near_an_emitter(mi, panel):
    """They get what a hemisphere of its radiance gives, without rare bright samples."""
    heights = np.array([1e-2, 1e-3, 1e-4])
    points = np.stack([0 * heights + 0.1, 0 * heights + 0.1, heights], axis=1)
    square = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    expected = [of_polygon(square, x, np.array([0, 0, -1])) for x in points]
    light = received(mi, panel, points, np.tile([0, 0, -1], (3, 1))) / [3, 2, 1]
    assert light == pytest.approx(np.repeat(np.reshape(expected, (3, 1)), 3, axis=1), rel=0.02)


def test_a_plate_just_before_an_emitter_hides_it(mi, tmp_path):
    """Shadow rays from afar end less than the gap of 2 mm before their goal."""
    emits = placed_shape("rectangle", "panel", glows(3, 2, 1), (0.5, 0.5, 1))
    plate = cube("plate", (0.6, 0.6, 5e-4), (0, 0, 2e-3), BLACK)
    below = sphere("below", 0.1, (0, 0, -0.3), glows(1, 1, 1))
    asset = baked(tmp_path, emits, plate, below, *CORNERS, paths=1 << 16)[1]
    light = received(mi, asset, np.array([[0.1, 0, 20], [0.3, 0, 8]]), np.tile([0, 0, -1], (2, 1)))
    assert not light.any()


def test_emitters_with_smooth_normals_emit_in_front_alone(mi, tmp_path):
    """A cube's smooth normals face a far receiver on 0.35 of a side that is turned away."""
    corners = itertools.product((-1, 1), repeat=3)
    lines = [f"v {x} {y} {z}\nvn {x} {y} {z}" for x, y, z in corners]
    faces = "1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"
    lines += ["f " + " ".join(f"{i}//{i}" for i in face.split()) for face in faces]
    (tmp_path / "cube.obj").write_text("\n".join(lines))
    inside = '<string name="filename" value="cube.obj"/>' + glows(1, 1, 1)
    lamp = lamp_of(tmp_path, placed_shape("obj", "cube", inside), *CORNERS)
    x = 1000 * np.array([[1, 0, 0.3]]) / math.hypot(1, 0.3)
    light, _ = irradiance(mi, straight(lamp), x, -x)
    area = lamp.frame.scale**-2 * 4 * (1 + 0.65 * 0.3) / math.hypot(1, 0.3)
    assert light == pytest.approx(np.full((1, 3), area / 1000**2), rel=0.02)


SMALL = (
    sphere("bulb", 0.15, (0, 0.1, 0), glows(6, 5, 3)),
    cube("plate", (0.3, 0.02, 0.3), (0, -0.3, 0), BLACK),
)


@pytest.fixture(scope="module")
def small(mi, tmp_path_factory):
    """A bulb above a black plate: all of its light is straight."""
    return baked(tmp_path_factory.mktemp("small"), *SMALL, *CORNERS)


def without_emitters(asset):
    """An asset whose geometry is black, and which has the light field still."""
    shapes = tuple(
        each if each.radiance is None else dataclasses.replace(each, radiance=(0.0, 0.0, 0.0))
        for each in asset.geometry.shapes
    )
    return dataclasses.replace(asset, geometry=dataclasses.replace(asset.geometry, shapes=shapes))


# Outside, on a face, inside, and in the shadow of the plate outside and inside.
AROUND = np.array([[3, 1, 0.5], [1.03, 0.4, 0.1], [0.4, 0.5, 0.3], [0, -2, 0.1], [0.05, -0.5, 0]])
TO_BULB = [0, 0.1, 0] - AROUND
FREE = np.pi * 0.15**2 / (TO_BULB**2).sum(axis=1) * [1, 1, 1, 0, 0]
RADIANCE = np.array([6.0, 5.0, 3.0])


def test_straight_light_comes_from_emitters_alone(mi, small):
    """The light field adds nothing to it; without the emitters it is dark."""
    _, asset = small
    assert not asset.light_field.bent.any()
    for dark in (False, True):
        shown, expected = (without_emitters(asset), 0 * FREE) if dark else (asset, FREE)
        light = received(mi, shown, AROUND, TO_BULB)
        assert light / RADIANCE == pytest.approx(
            np.repeat(expected[:, None], 3, axis=1), rel=0.03, abs=1e-6
        )


@pytest.mark.slow
def test_light_of_glass_comes_from_the_light_field_alone(mi, tmp_path):
    """Nothing is straight behind glass: without the emitters it is as bright."""
    bulb = sphere("bulb", 0.15, (0, 0.1, 0), glows(6, 5, 3))
    asset = baked(
        tmp_path, bulb, sphere("glass", 0.3, (0, 0.1, 0), GLASS), *CORNERS, paths=1 << 18
    )[1]
    assert asset.light_field is not None
    assert not asset.light_field.has_straight_light
    shown = asset, without_emitters(asset)
    found = [received(mi, each, AROUND[:3], TO_BULB[:3]) for each in shown]
    assert found[0] == pytest.approx(found[1], rel=0.05)
    assert found[0] / RADIANCE == pytest.approx(np.repeat(FREE[:3, None], 3, axis=1), rel=0.25)


@pytest.mark.slow
def test_bent_light_is_the_same_beside_straight_light(mi, tmp_path):
    """Receivers in the box see a grey plate and no emitter; bins of the field are sparse."""
    grey = BLACK.replace("0,0,0", "0.5,0.5,0.5")
    asset = baked(tmp_path, SMALL[0], SMALL[1].replace(BLACK, grey), *CORNERS, paths=1 << 15)[1]
    points = np.array([[0.2, -0.1, 0.2], [0.6, 0.3, 0], [-0.4, 0, 0.5]])
    normals = np.array([[0, -1, 0], [1, -1, 0], [-0.2, -1, 0.2]])
    assert asset.light_field is not None
    alone = dataclasses.replace(asset, geometry=None, light_field=asset.light_field.bent_light)
    shown = (asset, "geometry"), (alone, "field")
    found = [received(mi, each, points, normals, 1 << 20, kind) for each, kind in shown]
    assert found[0] == pytest.approx(found[1], rel=0.02)


@pytest.mark.parametrize(
    ("integrator", "appearance", "sampling"),
    [
        ("lumitree_path", "field", "emission"),
        slow("lumitree_path", "geometry", "uniform"),
        slow("lumitree_path", "field", "uniform"),
        slow("volpath", "geometry", "emission"),
        slow("volpath", "field", "emission"),
    ],
)
def test_where_no_light_is_traced_the_light_field_has_all(
    mi, small, integrator, appearance, sampling
):
    """A floor beside the plate's shadow is as bright as under the explicit lamp."""
    lamp, asset = small
    floor, sensor = {"floor": room(mi)["floor"]}, camera(mi, [0, 0.5, 6], [0, -1.5, 3.6], 16)
    shown = {"lamp": lumitree.shape(asset, appearance=appearance, sampling=sampling)}
    spp = 2048 if sampling == "uniform" else 64
    found = blocks(mi, floor | shown, sensor, spp=spp, integrator=integrator, passes=8)
    explicit = floor | place_shapes(lamp, np.eye(4))
    expected = blocks(mi, explicit, sensor, spp=64, integrator="path", passes=8)
    assert_alike(found, expected, 0.06)
    assert found[0].mean() == pytest.approx(expected[0].mean(), rel=0.015)


@pytest.mark.slow
def test_three_lamps_and_an_environment(mi, lamps, small):
    """Two of one kind stand in the light and the box of another, and all in the light of a sky."""
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [0.02, 0.03, 0.05]}}
    things = room(mi) | {"sky": sky}
    explicit, found = dict(things), dict(things)
    # Bulbs shine through the first lamp's panes, and are behind its mask.
    bulbs = (
        similarity(rotation([0, 0, 1], 30), 0.7, [1.1, -0.5, 0.2]),
        similarity(rotation([1, 0, 0], 50), 0.3, [-0.9, -0.8, 0.8]),
    )
    placed = [(lamps("panes"), np.eye(4)), *((small, place) for place in bulbs)]
    for i, ((lamp, asset), place) in enumerate(placed):
        found[f"lamp{i}"] = lumitree.shape(asset, place, appearance="geometry")
        shapes = place_shapes(lamp, place).items()
        explicit |= {f"lamp{i}_{name}": each for name, each in shapes}
    del explicit["inside"], found["inside"]
    for name in ("all", "inside"):
        sensor = views(mi)[name]
        assert_alike(
            blocks(mi, found, sensor, spp=128),
            blocks(mi, explicit, sensor, spp=512, integrator="volpath"),
            0.03,
        )


@pytest.mark.slow
def test_illuminance_of_straight_light(mi, small):
    """As the closed form, outside and inside the box; and with reflections as the explicit lamp."""
    lamp, asset = small
    from lumitree.core.photometry import luminance

    things = {"type": "scene", "floor": room(mi)["floor"], "face": room(mi)["face"]}
    points = np.array([[3, 1, 0.5], [0.4, 0.5, 0.3], [0, -1.45, 0.1], [2, -1.45, 1]])
    normals = [0, 0.1, 0] - points
    options = {"points": points, "normals": normals, "error": 0.01, "progress": None}
    shown = {"lamp": lumitree.shape(asset, appearance="geometry")}
    found = lumitree.illuminance(things | shown, **options)
    expected = np.pi * 0.15**2 / (normals**2).sum(axis=1) * luminance(RADIANCE) * [1, 1, 0, 1]
    assert found.direct == pytest.approx(expected, rel=0.04, abs=1e-3 * expected.max())
    explicit = lumitree.illuminance(things | place_shapes(lamp, np.eye(4)), **options)
    assert found.total == pytest.approx(explicit.total, rel=0.05)
    assert (found.total > 1.001 * found.direct).any()
