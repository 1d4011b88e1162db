"""Illuminance by lamp: against runs with one lamp each, and its errors against repetitions."""

import csv
import functools
import json

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.core.frames import LocalFrame
from support.explicit_lamps import baked
from support.ies_text import ies_text
from support.lamps import AREA, GLASS, lamp_of, sphere
from support.light_fields import random_light_field

NORMAL = (0, 1, 0)
POINTS = np.array([[0.2, -1, 0.4], [-0.9, -1, -0.5], [0.5, 0.1, 0.3]])
# So small an error that the stop does not depend on it: a number of passes is made.
EVERYTHING = 1.0
TERMS = ("direct", "reflected")
LUMENS, DARK = (900, 300, 500), 1e-8


@functools.cache
def asset(seed):
    """A lamp without surfaces, so that others neither shade nor reflect its light."""
    frame = LocalFrame(np.array([1.0, 0.6, 0.8]), np.eye(4))
    field = random_light_field(seed, resolution=8, count=20)
    return light_field_asset(field, frame, f"lamp {seed}")


def lamps(lumens=LUMENS):
    places = ((-0.8, 1.2, -0.6), (0.9, 1.3, 0.2), (0.1, 0.9, 0.9))
    return [
        lumitree.Placement(asset(seed), at=at, size=0.3, lumens=flux, label=f"lamp {seed}")
        for seed, (at, flux) in enumerate(zip(places, lumens, strict=True))
    ]


def room(mi, reflectance=0.5, **more):
    """A cube of side 4, a block in it that shadows some lamps, and a sensor that nothing needs."""
    transform = mi.ScalarTransform4f
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}}
    walls = {"type": "cube", "to_world": transform().scale(2), "flip_normals": True, "bsdf": grey}
    block = {
        "type": "cube",
        "to_world": transform().translate([0.3, 0, 0]).scale(0.2),
        "bsdf": grey,
    }
    return {"type": "scene", "walls": walls, "block": block, **more}


def window(mi, radiance=1.0):
    """An emitter of the scene."""
    turned = mi.ScalarTransform4f().translate([-1.99, 0, 0]).rotate([0, 1, 0], 90).scale(0.4)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    return {"window": {"type": "rectangle", "to_world": turned, "emitter": emitter}}


def by_lamp(scene, placements, error=0.02, points=POINTS, **options):
    return lumitree.illuminance(
        scene, placements, points=points, normals=NORMAL, error=error, by_lamp=True, **options
    )


def check_sums(result):
    parts = result.by_lamp
    assert parts.direct.sum(axis=0) == pytest.approx(result.direct, rel=1e-9)
    assert (parts.direct + parts.reflected).sum(axis=0) == pytest.approx(result.total, rel=1e-5)


def check_alone(parts, index, alone):
    """One lamp of a run against a run with it alone."""
    reflected = alone.total - alone.direct
    for term, expected, error in (
        ("direct", alone.direct, alone.direct_error),
        ("reflected", reflected, alone.total_error),
    ):
        found, own = getattr(parts, term)[index], getattr(parts, f"{term}_error")[index]
        assert (np.abs(found - expected) < 4.5 * np.hypot(own, error) + 1e-4).all()
    assert (parts.reflected_error[index] < 0.3 * reflected).all()
    assert (reflected > 0).all()


def spread(scene, placements):
    """Spread of 120 independent receivers at each place over the stated error [2, lamps, places].

    It is known to 6 %.
    """
    parts = by_lamp(scene, placements, 0.03, points=np.repeat(POINTS, 120, axis=0)).by_lamp
    ratios = []
    for term in TERMS:
        values = getattr(parts, term).reshape(len(parts.names), -1, 120)
        errors = getattr(parts, f"{term}_error").reshape(len(parts.names), -1, 120)
        stated = np.sqrt((errors**2).mean(axis=2))
        ratios.append(values.std(axis=2, ddof=1) / np.maximum(stated, 1e-12))
    return np.array(ratios)


def test_each_lamp_has_the_light_of_a_run_with_it_alone(mi):
    placements = lamps()
    whole = room(mi, **window(mi))
    result = by_lamp(whole, placements, error=0.01)
    check_sums(result)
    parts = result.by_lamp
    assert parts.names == ["room", "lamp_0", "lamp_1", "lamp_2"]
    where = {"points": POINTS, "normals": NORMAL, "error": 0.01, "seed": 1}
    # The others stay, nearly dark: the window reflects as the wall around it does not.
    for index in range(4):
        lit = [1 if each == index else DARK for each in range(4)]
        alone = room(mi, **window(mi, lit[0]))
        flux = [each * part for each, part in zip(LUMENS, lit[1:], strict=True)]
        check_alone(parts, index, lumitree.illuminance(alone, lamps(flux), **where))
    plain = lumitree.illuminance(whole, placements, **where)
    for name in ("direct", "total"):
        error = np.hypot(getattr(result, f"{name}_error"), getattr(plain, f"{name}_error"))
        assert (np.abs(getattr(result, name) - getattr(plain, name)) < 4.5 * error).all()


def test_parts_are_known_where_another_lamp_is_brighter(mi):
    """A point close below a lamp has few samples, as only its total counts."""
    near = np.array([[-0.8, 0.9, -0.6], *POINTS])
    result = by_lamp(room(mi), lamps(), points=near)
    plain = lumitree.illuminance(room(mi), lamps(), points=near, normals=NORMAL)
    assert result.total[0] > 5 * result.total[1:].max()
    assert result.samples[0] > 4 * plain.samples[0]
    assert (result.total_error <= 0.021 * result.total).all()
    parts, most = result.by_lamp, np.minimum(result.total, result.total.mean())
    assert (np.hypot(parts.direct_error, parts.reflected_error) <= 0.021 * most).all()


def perforated(mi):
    """A screen above all points with holes at random, in half of its area."""
    holes = mi.TensorXf(np.random.default_rng(4).integers(0, 2, (64, 64, 1)).astype(np.float32))
    opacity = {"type": "bitmap", "data": holes, "raw": True, "filter_type": "nearest"}
    turned = mi.ScalarTransform4f().translate([0, 0.5, 0]).rotate([1, 0, 0], 90).scale(1.9)
    bsdf = {"type": "mask", "opacity": opacity, "bsdf": {"type": "diffuse"}}
    return {"type": "rectangle", "to_world": turned, "bsdf": bsdf}


def test_stated_errors_are_the_spread_of_repetitions(mi):
    scene = room(mi, **window(mi), screen=perforated(mi))
    assert spread(scene, lamps()) == pytest.approx(1, abs=0.3)


def test_shadowed_lamps_are_dark_and_others_as_if_nothing_was_there(mi):
    """Each lamp has its own control variate: neither has noise because of the other."""
    screen = {"type": "rectangle", "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}}}
    turned = mi.ScalarTransform4f().rotate([0, 1, 0], 90)
    screen["to_world"] = turned.scale([9, 9, 1])
    placements = [lamps()[0], lamps()[1]]
    point = np.array([[0.7, -1, 0.4]])
    walls = room(mi)["walls"]
    result = by_lamp({"type": "scene", "walls": walls, "screen": screen}, placements, points=point)
    free = by_lamp({"type": "scene", "walls": walls}, placements, points=point)
    parts, error = result.by_lamp, free.by_lamp.direct_error
    assert parts.direct[1] == 0
    assert abs(parts.direct[2] - free.by_lamp.direct[2]) < 4 * np.hypot(error, error)[2] + 1e-3
    assert free.by_lamp.direct[1] > 50 * parts.direct_error[1]


def test_explicit_lamps_and_photometric_files(mi, tmp_path):
    (tmp_path / "spot.ies").write_text(ies_text(np.full((1, 19), 60.0), [0], range(0, 181, 10)))
    ball = sphere("glow", 0.1, inside=AREA)
    (tmp_path / "dark").mkdir()
    dark = lamp_of(tmp_path / "dark", ball.replace("3,2,1", "3e-9,2e-9,1e-9"))
    spot = lumitree.Placement(tmp_path / "spot.ies", at=(-0.7, 1.5, 0.3), lumens=800)
    bright = lumitree.Placement(lamp_of(tmp_path, ball), at=(0.8, 0.9, -0.4), label="ball")
    dark = lumitree.Placement(dark, at=(0.8, 0.9, -0.4))
    result = by_lamp(room(mi), [bright, spot], error=0.01)
    check_sums(result)
    assert result.by_lamp.names == ["room", "ball", "spot"]
    assert not result.by_lamp.direct[0].any()
    assert not result.by_lamp.reflected_error[0].any()
    where = {"points": POINTS, "normals": NORMAL, "error": 0.01, "seed": 1}
    check_alone(result.by_lamp, 1, lumitree.illuminance(room(mi), [bright], **where))
    check_alone(result.by_lamp, 2, lumitree.illuminance(room(mi), [dark, spot], **where))


@pytest.mark.slow
def test_lamps_with_geometry(mi, tmp_path):
    """Straight light of a bulb comes from its shape, and bent light of a globe from the field."""
    bulb = sphere("bulb", 0.2, (-0.5, 0, 0), AREA)
    globe = sphere("globe", 0.3, (0.5, 0, 0), GLASS), sphere("glow", 0.15, (0.5, 0, 0), AREA)
    _, asset = baked(tmp_path, bulb, *globe, paths=1 << 18)
    assert asset.light_field.has_straight_light

    def two(*lumens):
        places = zip([(-0.9, 1.2, 0.3), (0.9, 1.2, -0.2)], lumens, strict=True)
        return [lumitree.Placement(asset, at=at, size=0.4, lumens=flux) for at, flux in places]

    result = by_lamp(room(mi), two(700, 400), error=0.01)
    check_sums(result)
    where = {"points": POINTS, "normals": NORMAL, "error": 0.01, "seed": 1}
    for index, lumens in ((1, (700, 1e-6)), (2, (1e-6, 400))):
        check_alone(result.by_lamp, index, lumitree.illuminance(room(mi), two(*lumens), **where))
    direct, reflected = spread(room(mi), two(700, 400))[:, 1:]
    assert reflected == pytest.approx(1, abs=0.3)
    # Stated errors are larger where shadows may not be in the samples.
    assert 0.7 < direct.max() < 1.3


def test_a_scene_with_its_own_emitters_only(mi):
    result = by_lamp(room(mi, **window(mi)), ())
    check_sums(result)
    assert result.by_lamp.names == ["room"]
    assert result.by_lamp.direct_error[0] == pytest.approx(result.direct_error)


def test_direct_light_has_no_reflected_part(mi):
    result = by_lamp(room(mi), lamps(), direct=True)
    check_sums(result)
    assert not result.by_lamp.reflected.any()
    assert not result.by_lamp.reflected_error.any()


def test_each_lamp_of_an_array_has_a_part(mi):
    row = lumitree.Placement(
        asset(0), at=(0, 1.3, 0), size=0.2, lumens=100, label="row", grid=(2, 1), pitch=(1.6, 1)
    )
    result = by_lamp(room(mi), [row], points=[[-0.8, -1, 0.6], [0.8, -1, 0.6]], direct=True)
    assert result.by_lamp.names == ["room", "row", "row_2"]
    left, right = result.by_lamp.direct[1:]
    assert left[0] > right[0]
    assert right[1] > left[1]


def test_files_have_columns_for_each_lamp(mi, tmp_path):
    solid = [[0.3, 0, 0]]
    result = by_lamp(room(mi), lamps(), EVERYTHING, points=[*POINTS, *solid])
    parts = result.by_lamp
    assert np.isnan(parts.direct[:, 3]).all()
    assert np.isnan(parts.reflected_error[:, 3]).all()
    for suffix in ("csv", "json"):
        result.save(tmp_path / f"lux.{suffix}")
    with open(tmp_path / "lux.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    receivers = json.loads((tmp_path / "lux.json").read_text())["receivers"]
    for term in TERMS:
        for column, values in (
            (f"lamp_1_{term}_lx", getattr(parts, term)[2]),
            (f"lamp_1_{term}_error_lx", getattr(parts, f"{term}_error")[2]),
        ):
            found = [float(row[column]) for row in rows[:3]]
            assert found == pytest.approx(values[:3], rel=1e-5)
            assert [row[column] for row in receivers[:3]] == values[:3].tolist()
            assert rows[3][column] == ""
            assert receivers[3][column] is None


def test_a_plan_has_a_map_for_each_lamp_that_lights_it(mi, tmp_path):
    plane = lumitree.Plane((-0.6, -1, 0), extent=(1, 1), spacing=0.25)

    def drawn(by_lamp):
        result = lumitree.illuminance(
            room(mi), lamps(), planes=[plane], error=EVERYTHING, by_lamp=by_lamp
        )
        result.save(tmp_path / "plan.png")
        return result, mi.Bitmap(str(tmp_path / "plan.png")).size()[1]

    (result, height), (_, without) = drawn(True), drawn(False)
    # The room has no emitter.
    assert list(result.by_lamp.lit(result.areas[0])) == ["lamp_0", "lamp_1", "lamp_2"]
    assert height > without + 100


def test_equal_seeds_give_equal_parts(mi):
    first, second = (by_lamp(room(mi), lamps(), EVERYTHING).by_lamp for _ in range(2))
    assert np.array_equal(first.reflected, second.reflected)
    assert np.array_equal(first.direct_error, second.direct_error)


def test_many_lamps_are_estimated_in_smaller_parts(mi, monkeypatch):
    """Memory has sums of few paths at once: the result is the same within its errors."""
    from lumitree.measure import illuminance_estimate

    whole = by_lamp(room(mi), lamps(), EVERYTHING)
    monkeypatch.setattr(illuminance_estimate, "_MAX_BY_GROUP", 1 << 9)
    parts = by_lamp(room(mi), lamps(), EVERYTHING)
    check_sums(parts)
    error = np.hypot(whole.by_lamp.reflected_error, parts.by_lamp.reflected_error)
    assert (np.abs(whole.by_lamp.reflected - parts.by_lamp.reflected) < 4.5 * error + 1e-9).all()
    assert not np.array_equal(whole.by_lamp.reflected, parts.by_lamp.reflected)


def test_more_parts_than_memory_holds_are_refused(mi, monkeypatch):
    monkeypatch.setattr("lumitree.measure.illuminance._MAX_PARTS", 11)
    with pytest.raises(lumitree.LumitreeError, match="3 points for 3 lamps and the room"):
        by_lamp(room(mi), lamps())
