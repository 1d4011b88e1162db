"""Illuminance: closed forms, and against images and other estimators."""

import dataclasses
import functools
import json

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import make_light_field
from lumitree.core.frames import LocalFrame
from lumitree.core.photometry import LUMENS_PER_WATT, luminance
from support.lamps import AREA, GLASS, lamp_of, sphere
from support.light_fields import random_light_field

BOX = np.array([1.0, 0.6, 0.8])
BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0}}
WHITE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1}}
# So small an error that the stop does not depend on it: a number of passes is made.
EVERYTHING = 1.0


@functools.cache
def lamp():
    """An asset whose light is different in all directions."""
    frame = LocalFrame(BOX, np.eye(4))
    return light_field_asset(random_light_field(3, resolution=8, count=20), frame, "lamp")


def room(mi, **things):
    """A scene without a camera; something black and far away makes it one."""
    speck = {"type": "sphere", "radius": 0.01, "center": [0, -50, 0], "bsdf": BLACK}
    return {"type": "scene", "speck": speck, **things}


def at(*points, normal=(0, 1, 0)):
    return {"points": np.array(points, float), "normals": normal}


def rgb(kind, name, value):
    return {"type": kind, name: {"type": "rgb", "value": value}}


def point_light(position, intensity):
    return {**rgb("point", "intensity", intensity), "position": position}


def test_a_point_light_follows_the_inverse_square_and_the_cosine(mi):
    intensity = np.array([3.0, 2.0, 1.0])
    light = point_light([0, 2, 0], intensity)
    points = np.array([[0, 0, 0], [1, 0, 0.5], [-2, 0.5, 0]])
    result = lumitree.illuminance(room(mi, light=light), **at(*points))
    offset = [0, 2, 0] - points
    distance = np.linalg.norm(offset, axis=1)
    expected = luminance(intensity) * offset[:, 1] / distance**3
    assert result.direct == pytest.approx(expected, rel=1e-4)
    assert result.total == pytest.approx(expected, rel=1e-4)
    assert (result.total_error < 1e-3 * expected).all()


def furnace(mi, reflectance, radiance=2.0):
    """A closed sphere that emits and reflects."""
    wall = {"type": "sphere", "radius": 3, "flip_normals": True}
    wall["bsdf"] = rgb("diffuse", "reflectance", reflectance)
    wall["emitter"] = rgb("area", "radiance", radiance)
    return {"type": "scene", "wall": wall}


def test_reflections_of_a_closed_sphere_are_a_geometric_series(mi):
    result = lumitree.illuminance(
        furnace(mi, 0.6), error=0.005, **at([0, 0, 0], [1, 0.3, -2], normal=(0.2, 1, 0))
    )
    direct = np.pi * 2 * LUMENS_PER_WATT
    for found, error, expected in (
        (result.direct, result.direct_error, direct),
        (result.total, result.total_error, direct / 0.4),
    ):
        assert (np.abs(found - expected) < 4 * error + 1e-4 * expected).all()
    assert (result.total_error <= 0.0051 * result.total).all()


def placed(**options):
    return lumitree.Placement(lamp(), at=(0, 2, 0), size=0.3, rotate=(0, 0, 1, 30), **options)


def received(mi, things, placements, points, normals, samples=1 << 15):
    """Illuminance by next-event estimation and rays of a BSDF, and its standard error."""
    from benchmarks.inside_box.received import received_irradiance
    from lumitree.rendering.scene import load_without_camera, open_placements, place_luminaires

    scene = place_luminaires(
        load_without_camera(room(mi, **things))[0], open_placements(placements)
    )
    normals = np.broadcast_to(normals, np.shape(points))
    found = [
        luminance(received_irradiance(scene, points, normals, samples, seed)) for seed in range(8)
    ]
    return np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(len(found))


POINTS = np.array([[0, 0, 0], [1.2, 0.3, 0.4], [-0.8, 1.5, 0.6], [0.3, 1.75, 0.1]])


def test_a_lamp_is_summed_as_paths_receive_it(mi):
    result = lumitree.illuminance(room(mi), [placed()], direct=True, **at(*POINTS))
    expected, error = received(mi, {}, [placed()], POINTS, [0, 1, 0])
    assert (np.abs(result.direct - expected) < 4 * np.hypot(error, result.direct_error)).all()
    assert (result.direct_error < 0.01 * result.direct).all()
    assert np.array_equal(result.direct, result.total)


def test_shadows_of_a_lamp_are_sampled(mi):
    """Points in full light, in half shadow and in full shadow of a plate."""
    plate = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0.55, 1.0, 0]).rotate([1, 0, 0], 90)
        @ mi.ScalarTransform4f().scale([0.5, 2, 1]),
        "bsdf": {"type": "twosided", "bsdf": BLACK},
    }
    points = np.array([[-1.5, 0, 0], [0.08, 0, 0], [1.0, 0.2, 0], [1.0, 0.99, 0]])
    result = lumitree.illuminance(room(mi, plate=plate), [placed()], error=0.01, **at(*points))
    expected, error = received(mi, {"plate": plate}, [placed()], points, [0, 1, 0])
    allowed = 4 * np.hypot(error, result.direct_error) + 1e-9
    assert (np.abs(result.direct - expected) < allowed).all()
    free = lumitree.illuminance(room(mi), [placed()], direct=True, **at(*points)).direct
    assert 0.1 * free[1] < result.direct[1] < 0.9 * free[1]
    assert result.direct[2] == result.direct[3] == 0


@functools.cache
def even_asset():
    field = make_light_field(np.zeros((1, 3), int), np.ones((1, 64, 3)), 2)
    return light_field_asset(field, LocalFrame(np.ones(3), np.eye(4)), "even")


def even(lumens, at):
    """A lamp of one cell, even in all directions."""
    return lumitree.Placement(even_asset(), at=at, size=0.2, lumens=lumens)


def test_a_full_shadow_is_black_where_all_samples_are_equal(mi):
    plate = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 20, 0]).scale(9)}
    plate["to_world"] = plate["to_world"] @ mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    result = lumitree.illuminance(
        room(mi, plate=plate), [even(100, (0, 40, 0))], direct=True,
        **at([0, 0, 0], [0, 25, 0]),
    )  # fmt: skip
    assert result.direct[0] == 0
    assert result.direct[1] > 0


def test_errors_are_those_of_repetitions(mi):
    """z-test: the spread over independent receivers of one place is what the errors say."""
    things = dict(furnace(mi, 0.5))
    del things["type"]
    box = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0.4, 1, 0]).scale(0.25)}
    scene = room(mi, **things, box=box)
    same = np.repeat(POINTS[:3], 300, axis=0)
    result = lumitree.illuminance(scene, [placed()], error=EVERYTHING, **at(*same))
    for name in ("direct", "total"):
        values = getattr(result, name).reshape(3, 300)
        errors = getattr(result, f"{name}_error").reshape(3, 300)
        spread = values.std(axis=1, ddof=1) / np.sqrt((errors**2).mean(axis=1))
        # The spread of 300 values is known to 4 %.
        assert spread == pytest.approx(1, abs=0.2)


def test_a_floor_has_the_illuminance_that_its_image_shows(mi):
    """A grey floor's radiance is ρ E / π, reflections of the other walls included."""
    grey = rgb("diffuse", "reflectance", 0.5)
    walls = {"type": "cube", "to_world": mi.ScalarTransform4f().scale(3), "bsdf": grey}
    walls["flip_normals"] = True
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    camera = {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at([0.9, -2, 0.5], [0.9, -3, 0.5], [1, 0, 0]),
        "fov": 0.5,
        "film": film,
    }
    integrator = {"type": "path", "max_depth": -1}
    scene = room(mi, walls=walls, camera=camera, integrator=integrator)
    image = lumitree.render(scene, [placed()], spp=1 << 14)
    shown = luminance(image.pixels[0, 0]) * np.pi / 0.5
    result = lumitree.illuminance(scene, [placed()], error=0.004, **at([0.9, -3, 0.5]))
    # 2¹⁴ samples of a relative variance of about one.
    assert result.total[0] == pytest.approx(shown, rel=0.03)


@pytest.mark.slow
def test_receivers_inside_the_box_get_its_light(mi):
    points = placed().at + np.array([[0.02, -0.01, 0.03], [0.05, 0.02, -0.03]])
    result = lumitree.illuminance(room(mi), [placed()], direct=True, error=0.01, **at(*points))
    assert (result.direct > 0).any()
    # With something in the box, which shadows nothing.
    speck = {"type": "sphere", "radius": 1e-3, "center": [0.05, 2, 0.05]}
    expected, error = received(mi, {"inside": speck}, [placed()], points, [0, 1, 0])
    assert (np.abs(result.direct - expected) < 4 * np.hypot(error, result.direct_error)).all()


@pytest.mark.parametrize(("unit", "factor", "lumens"), [("cm", 100, 800), ("mm", 1000, 1e5)])
def test_lumens_of_a_lamp_in_a_scene_in_another_unit(mi, unit, factor, lumens):
    """The same image with all lengths so many times as large."""
    one = lumitree.illuminance(room(mi), [placed(lumens=lumens)], direct=True, **at(*POINTS))
    large = dataclasses.replace(placed(lumens=lumens), at=(0, 2 * factor, 0), size=0.3 * factor)
    other = lumitree.illuminance(
        room(mi), [large], direct=True, unit=unit, **at(*(factor * POINTS))
    )
    allowed = 4 * np.hypot(one.direct_error, other.direct_error)
    assert (np.abs(other.direct - one.direct) < allowed).all()
    assert (allowed < 0.1 * one.direct.max()).all()


def test_normals_may_have_any_length(mi):
    one, *others = (
        lumitree.illuminance(room(mi), [placed()], direct=True, **at(*POINTS, normal=normal))
        for normal in ((0, 1, 0), (0, 1e-30, 0), (0, 1e30, 0))
    )
    assert one.direct.max() > 0
    for other in others:
        np.testing.assert_array_equal(other.normal, one.normal)
        assert other.direct == pytest.approx(one.direct)


def test_equal_seeds_give_equal_results_and_others_do_not(mi):
    results = [
        lumitree.illuminance(furnace(mi, 0.5), error=EVERYTHING, seed=seed, **at([0, 1, 0]))
        for seed in (1, 1, 2)
    ]
    assert results[0].total[0] == results[1].total[0] != results[2].total[0]


def test_files_have_what_was_found(mi, tmp_path):
    plane = lumitree.Plane((0, 0, 0), extent=(1, 0.5), spacing=0.25, name="desk")
    result = lumitree.illuminance(furnace(mi, 0), planes=[plane], error=EVERYTHING, **at([0, 1, 0]))
    assert [area.name for area in result.areas] == ["desk", "points"]
    assert [area.count for area in result.areas] == [8, 1]
    desk = result.areas[0]
    lux = result.total[:8]
    assert desk.mean == pytest.approx(lux.mean())
    assert desk.uniformity == pytest.approx(lux.min() / lux.mean())
    assert desk.diversity == pytest.approx(lux.min() / lux.max())
    for suffix in ("csv", "json", "png", "pdf"):
        result.save(tmp_path / f"desk.{suffix}")
    lines = (tmp_path / "desk.csv").read_text().splitlines()
    assert len(lines) == 10
    assert lines[0].startswith("area,x,y,z,nx,ny,nz,direct_lx")
    first = lines[1].split(",")
    assert first[0] == "desk"
    assert float(first[9]) == pytest.approx(result.total[0], rel=1e-5)
    report = json.loads((tmp_path / "desk.json").read_text())
    assert report["receivers"][0]["total_lx"] == result.total[0]
    assert (tmp_path / "desk.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "desk.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(lumitree.LumitreeError, match=r"does not end in one of \.csv"):
        result.save(tmp_path / "desk.txt")


def test_surfaces_of_a_scene_are_covered_evenly(mi):
    scene = furnace(mi, 0)
    scene["desk"] = {
        "type": "rectangle",
        "id": "desk",
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale([0.8, 0.4, 1]),
        "bsdf": BLACK,
    }
    result = lumitree.illuminance(
        scene, surfaces=[lumitree.Surface("desk", 0.08)], error=EVERYTHING, direct=True
    )
    assert result.areas[0].count == 200
    assert result.normal == pytest.approx(np.tile([0, 1, 0], (200, 1)), abs=1e-6)
    x, z = result.position[:, 0], result.position[:, 2]
    assert np.abs(x).max() <= 0.8 + 1e-5
    assert np.abs(z).max() <= 0.4 + 1e-5
    counts = np.histogram2d(x, z, bins=(4, 2))[0]
    # At random they would spread by 5.
    assert counts == pytest.approx(25, abs=6)
    assert counts.std() < 4.5


ROOM = """<scene version="3.0.0"><bsdf type="diffuse" id="wood"/>
<shape type="rectangle"><ref id="wood"/></shape>
<shape type="disk"><ref id="wood"/>
<transform name="to_world"><translate z="2"/></transform></shape>
<shape type="sphere" id="lamp"><point name="center" value="0,0,5"/><emitter type="area"/></shape>
<shape type="shapegroup" id="group"><shape type="rectangle"/></shape>
<shape type="instance"><ref id="group"/></shape></scene>"""


@pytest.mark.parametrize(
    ("pattern", "heights", "count"),
    [("#0", {0}, 100), ("#1", {2}, 79), ("wood", {0, 2}, 179), ("w?*d", {0, 2}, 179)],
)
def test_surfaces_of_shapes_without_ids(mi, tmp_path, pattern, heights, count):
    """By number and by the id of the BSDF, as --keep of other commands."""
    path = tmp_path / "room.xml"
    path.write_text(ROOM)
    surface = lumitree.Surface(pattern, 0.2)
    result = lumitree.illuminance(path, surfaces=[surface], error=EVERYTHING, direct=True)
    assert [area.count for area in result.areas] == [count]
    assert set(result.position[:, 2].round(5)) == heights


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "no plane, surface or points"),
        ({"points": [[0, 0, 0]]}, "points but no normals"),
        ({"normals": [0, 1, 0]}, "normals but no points"),
        ({"points": [[0, 0, np.nan]], "normals": [0, 1, 0]}, "not finite"),
        ({"points": [[0, 0, 0]], "normals": [0, 0, 0]}, "not finite or 0"),
        ({"points": [[0, 0, 0]], "normals": [[0, 1, 0]] * 2}, r"\[N, 3\] both"),
        ({"planes": lumitree.Plane((0, 0, 0))}, r"planes has Plane.*a list of lumitree\.Plane"),
        ({"planes": [(0, 0, 0)]}, r"planes has \(0, 0, 0\); expected a list of lumitree\.Plane"),
        ({**at([0, 0, 0]), "error": 0}, "error is 0"),
        ({**at([0, 0, 0]), "unit": "furlong"}, "unit is 'furlong'"),
    ],
)
def test_wrong_arguments_are_refused(mi, arguments, message):
    with pytest.raises(lumitree.LumitreeError, match=message):
        lumitree.illuminance(furnace(mi, 0), **arguments)


UNSAMPLED = {"type": "sphere", "emitter": {"type": "area", "sampling_weight": 0.0}}


@pytest.mark.parametrize(
    ("things", "arguments", "message"),
    [
        ({}, at([0, 0, 0]), "has no light"),
        ({"ball": UNSAMPLED, "sky": {"type": "constant"}}, at([0, -2, 0]), "sampling_weight 0"),
        ({}, {"surfaces": [lumitree.Surface("chair")]}, "'chair' matches no shape"),
    ],
)
def test_scenes_without_light_or_surfaces_are_refused(mi, things, arguments, message):
    with pytest.raises(lumitree.LumitreeError, match=message):
        lumitree.illuminance(room(mi, **things), **arguments)


def test_no_points_are_spread_over_an_instance(mi, tmp_path):
    (tmp_path / "room.xml").write_text(ROOM)
    with pytest.raises(lumitree.LumitreeError, match=r"#3 .* is an instance"):
        lumitree.illuminance(tmp_path / "room.xml", surfaces=[lumitree.Surface("#3")])


def test_points_inside_solids_do_not_count(mi, tmp_path):
    """A row of points, of which two are inside a cube that stands on a plate."""
    scene = furnace(mi, 0)
    plate = mi.ScalarTransform4f().translate([0, -0.5, 0]).rotate([1, 0, 0], -90)
    scene["plate"] = {"type": "rectangle", "to_world": plate, "bsdf": BLACK}
    scene["box"] = {"type": "cube", "to_world": mi.ScalarTransform4f().scale([0.5, 0.5, 0.2])}
    plane = lumitree.Plane((0, 0, 0), extent=(1.6, 0.4), spacing=0.4)
    result = lumitree.illuminance(scene, planes=[plane], error=EVERYTHING)
    assert np.isnan(result.total).tolist() == [False, True, True, False]
    area = result.areas[0]
    assert (area.count, area.enclosed) == (4, 2)
    assert area.mean == pytest.approx(result.total[[0, 3]].mean())
    result.save(tmp_path / "lux.json")
    receivers = json.loads((tmp_path / "lux.json").read_text())["receivers"]
    assert [each["total_lx"] is None for each in receivers] == [False, True, True, False]
    within = lumitree.Plane((0, 0, 0), extent=(0.2, 0.2), spacing=0.1, name="within")
    with pytest.warns(lumitree.LumitreeWarning, match="all points of within are inside solids"):
        lumitree.illuminance(scene, planes=[within], error=EVERYTHING)


@pytest.mark.parametrize("direct_only", [False, True])
def test_dark_points_of_a_room_whose_walls_face_outwards_count(mi, direct_only):
    """A beam lights a patch of the floor; one of four points is there, one in a solid."""
    transform = mi.ScalarTransform4f
    grey = {"type": "twosided", "bsdf": {"type": "diffuse"}}
    spot = {
        "type": "spot",
        "to_world": transform().look_at([0.6, 0.9, 0], [0.6, 0, 0], [0, 0, 1]),
        "cutoff_angle": 10,
    }
    scene = {
        "type": "scene",
        "walls": {"type": "cube", "to_world": transform().scale([0.8, 1, 0.8]), "bsdf": grey},
        "box": {
            "type": "cube",
            "to_world": transform().translate([-0.2, 0, 0]).scale([0.1, 0.1, 0.1]),
            "bsdf": grey,
        },
        "spot": spot,
    }
    plane = lumitree.Plane((0, 0, 0), extent=(1.6, 0.4), spacing=0.4)
    result = lumitree.illuminance(scene, planes=[plane], error=EVERYTHING, direct=direct_only)
    assert np.isnan(result.total).tolist() == [False, True, False, False]
    assert np.flatnonzero(result.direct > 0).tolist() == [3]


RADIUS, DISTANCE, RADIANCE = 0.1, 2.0, 5.0
THROUGH_GLASS = np.pi * LUMENS_PER_WATT * RADIANCE * (RADIUS / DISTANCE) ** 2


def glow_in_glass(count):
    """A white ball that glows in a ball of glass: one path in 200 finds it. No light is lost."""
    ball = {"type": "sphere", "radius": RADIUS, "bsdf": WHITE}
    ball["emitter"] = rgb("area", "radiance", RADIANCE)
    glass = {"type": "sphere", "radius": 0.5, "bsdf": {"type": "dielectric", "int_ior": 1.5}}
    turns = np.linspace(0, 2 * np.pi, count, endpoint=False)
    points = DISTANCE * np.stack([np.cos(turns), 0 * turns, np.sin(turns)], axis=1)
    return {"ball": ball, "glass": glass}, {"points": points, "normals": -points}


def test_light_by_rare_paths_is_not_taken_for_darkness(mi):
    things, where = glow_in_glass(24)
    result = lumitree.illuminance(room(mi, **things), error=0.1, **where)
    assert (result.total > 0).all()
    assert (np.abs(result.total - THROUGH_GLASS) < 4.5 * result.total_error).all()
    assert result.total.mean() == pytest.approx(THROUGH_GLASS, rel=0.1)
    assert (result.total_error < 0.2 * THROUGH_GLASS).all()


def test_light_by_rare_paths_is_found_beside_a_lamp(mi):
    """Whose light is the same in all samples, so that only the rare ones differ."""
    things, where = glow_in_glass(100)
    lamps = [even(4000, (0, 4, 0))]
    steady = lumitree.illuminance(room(mi), lamps, direct=True, **where).direct
    result = lumitree.illuminance(room(mi, **things), lamps, error=0.1, **where)
    found = result.total - steady
    assert found.mean() == pytest.approx(THROUGH_GLASS, rel=0.05)
    assert (np.abs(found - THROUGH_GLASS) < 6 * result.total_error).all()
    assert (result.total_error < 0.11 * result.total).all()


@pytest.mark.parametrize("count", [5, pytest.param(9, marks=pytest.mark.slow)])
def test_the_shadow_of_one_lamp_among_many_is_found(mi, count):
    """At each point, as nearly all samples are of the others."""
    grid = 2.0 * (np.arange(count) - (count - 1) / 2)
    lamps = [even(500, (float(x), 3, float(z))) for x in grid for z in grid]
    plate = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 1.5, 0]).rotate([1, 0, 0], 90).scale(0.15),
        "bsdf": {"type": "twosided", "bsdf": BLACK},
    }
    x, z = np.random.default_rng(1).uniform(-0.04, 0.04, (2, 60))
    where = at(*np.stack([x, 0 * x, z], axis=1))
    free = lumitree.illuminance(room(mi), lamps, direct=True, **where).direct
    (middle,) = (lamp for lamp in lamps if lamp.at == (0, 3, 0))
    shadowed = free - lumitree.illuminance(room(mi), [middle], direct=True, **where).direct
    result = lumitree.illuminance(room(mi, plate=plate), lamps, direct=True, **where)
    assert (np.abs(result.direct - shadowed) < 5 * result.direct_error).all()
    assert (result.direct_error < 0.021 * result.direct).all()
    assert result.direct.mean() == pytest.approx(shadowed.mean(), rel=0.008)


def test_errors_of_sums_over_lamps_are_not_small_by_chance(mi):
    """At each of many points: sums stop where their error is small enough."""
    lamps = [
        lumitree.Placement(lamp(), at=(2.0 * x, 2.5, 2.0 * z), size=1.0)
        for x in (-0.5, 0.5)
        for z in (-0.5, 0.5)
    ]
    x, z = np.random.default_rng(2).uniform(-3, 3, (2, 150))
    where = at(*np.stack([x, 0 * x, z], axis=1))

    def found(error, seed):
        return lumitree.illuminance(room(mi), lamps, error=error, direct=True, seed=seed, **where)

    # Nothing shadows the lamps, so that the sums are all that varies.
    exact = found(0.003, 5)
    scores = []
    for seed in range(3):
        result = found(0.01, seed)
        error = np.hypot(result.direct_error, exact.direct_error)
        scores.append((result.direct - exact.direct) / error)
    assert np.std(scores) < 1.25
    assert (np.abs(scores) > 3).mean() < 0.015


def test_errors_of_points_by_a_lamp_are_not_those_of_points_in_its_box(mi):
    """There its light is sampled; elsewhere it is summed, and nothing else can come."""
    half = 0.5 * BOX[1] / BOX.max()
    x = np.linspace(-0.3, 0.3, 10)
    inside = np.stack([x, np.full(10, 1 - 0.9 * half), 0 * x], axis=1)
    below = np.stack([x, np.full(10, -1.0), 0 * x], axis=1)
    lamps = [lumitree.Placement(lamp(), at=(0, 1, 0), size=1.0)]
    result = lumitree.illuminance(room(mi), lamps, direct=True, **at(*inside, *below), error=0.2)
    assert (result.direct_error[10:] < 0.07 * result.direct[10:]).all()
    assert (result.direct_error[:10] > 0).all()


def test_light_beyond_all_numbers_ends(mi):
    light = point_light([0, 1, 0], 3e38)
    # Its radiance is infinite.
    wall = {"type": "sphere", "center": [0, 1.4, 0], "radius": 0.3, "bsdf": WHITE}
    with np.errstate(invalid="ignore"):
        result = lumitree.illuminance(room(mi, light=light, wall=wall), **at([0, 0, 0], [2, 0, 0]))
    assert not np.isfinite(result.total_error[0])


def test_explicit_lamps_of_glass_are_warned_of(mi, tmp_path):
    lamp = lamp_of(tmp_path, sphere("glass", 0.2, inside=GLASS), sphere("glow", 0.1, inside=AREA))
    hung = lumitree.Placement(lamp, at=(0, 2, 0))
    with pytest.warns(lumitree.LumitreeWarning, match="placed as explicit geometry with glass"):
        lumitree.illuminance(room(mi), [hung], error=EVERYTHING, time=1.0, **at([0, 0, 0]))


def test_receivers_in_a_medium_get_what_it_lets_through(mi):
    """Beer's law in a block of a medium that absorbs; a plate of clear glass is no border of it."""
    extinction = np.array([0.4, 0.6, 0.9])
    medium = {**rgb("homogeneous", "sigma_t", extinction), "albedo": 0.0}
    fog = {"type": "cube", "bsdf": {"type": "null"}, "interior": medium}
    fog["to_world"] = mi.ScalarTransform4f().scale(5)
    pane = {"type": "rectangle", "bsdf": {"type": "null"}}
    pane["to_world"] = mi.ScalarTransform4f().translate([0, 1, 0]).rotate([1, 0, 0], 90)
    intensity = np.array([3.0, 2.0, 1.0])
    light = point_light([0, 2, 0], intensity)
    things = {"fog": fog, "pane": pane, "light": light}
    result = lumitree.illuminance(room(mi, **things), **at([0, 0, 0], [0, 1.5, 0]))
    distance = np.array([2, 0.5])
    expected = luminance(intensity * np.exp(-extinction * distance[:, None])) / distance**2
    # Shadow rays end a little before the light.
    assert result.direct == pytest.approx(expected, rel=3e-3)
    assert result.total == pytest.approx(expected, rel=3e-3)


def test_light_of_surfaces_is_attenuated_by_the_medium_of_receivers(mi):
    """A wall that emits, seen through one unit of a medium from all directions."""
    medium = {"type": "homogeneous", "albedo": 0.0, "sigma_t": 0.7}
    walls = furnace(mi, 0.5)
    walls["fog"] = {"type": "sphere", "radius": 1, "bsdf": {"type": "null"}, "interior": medium}
    walls["speck"] = {"type": "sphere", "radius": 0.01, "center": [0, 2, 0], "bsdf": BLACK}
    result = lumitree.illuminance(walls, error=0.01, **at([0, 0, 0]))
    clear = lumitree.illuminance(furnace(mi, 0.5), error=0.01, **at([0, 0, 0]))
    # The wall gets a little less, too: by rays through the fog.
    bound = np.exp(-0.7) * clear.total
    assert result.direct == pytest.approx(np.exp(-0.7) * clear.direct, rel=0.03)
    assert 0.85 * bound < result.total < 1.03 * bound


@pytest.mark.slow
def test_a_lamp_with_points_in_its_box_does_not_change_another_one(mi):
    """Two lamps of one asset, or of equal ones; a table touches the box of the second."""
    half = 0.5 * BOX[1] / BOX.max()
    up = mi.ScalarTransform4f().translate([3, 0.9 - half * (1 - 1e-4), 0]).rotate([1, 0, 0], -90)
    table = {"type": "rectangle", "to_world": up.scale(0.3)}
    points = [[0.02, 0.9, 0.03], *([3 + x, 0.9 + half, 0.6] for x in (-0.3, 0, 0.3))]
    first, other = lamp(), lamp.__wrapped__()
    found = [
        lumitree.illuminance(
            room(mi, table=table),
            [
                lumitree.Placement(source, at=place, size=1.0)
                for source, place in ((first, (0, 0.9, 0)), (second, (3, 0.9, 0)))
            ],
            **at(*points, normal=(0, -1, 0)),
            error=EVERYTHING,
            seed=1,
        )
        for second in (first, other)
    ]
    assert (found[0].total > found[0].direct).any()
    assert found[0].total == pytest.approx(found[1].total, rel=1e-3)
