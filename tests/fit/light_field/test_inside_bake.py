"""The bake of light inside the box: an emissive ball with an opaque disc beside it."""

import dataclasses

import numpy as np
import pytest

from lumitree.asset.light_field import by_coarse_bin, parts_of_ending, unpack
from lumitree.core.device import on_device
from lumitree.core.octahedral import bin_of, coarse_bin, coarse_solid_angles, solid_angles
from lumitree.core.photometry import luminance
from lumitree.fit.light_field.bake import bake_light_field
from lumitree.trace.light_field_config import LightFieldConfig
from lumitree.trace.light_paths import LampRays
from lumitree.trace.segments import EndingConfig
from support.lamps import AREA, cube, lamp_of, sphere
from support.light_fields import assert_equal_fields
from support.slow import slow

CONFIG = LightFieldConfig(paths=1 << 20, batch=1 << 18, depth=5, resolution=32)
RADIANCE = np.array([3.0, 2.0, 1.0])
RADIUS = 0.25
BLACK = '<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
NULL = '<bsdf type="null"/>'


def disc_lamp(folder, *shapes):
    """A ball at the origin, a black disc at x = 1, and specks in the corners of a larger box."""
    disc = (
        '<shape type="disk" id="disc"><transform name="to_world"><scale value="1.2"/>'
        '<rotate y="1" angle="90"/><translate x="1"/></transform>'
        f'<bsdf type="twosided">{BLACK}</bsdf></shape>'
    )
    specks = [cube(f"speck{x}", 0.005, (x, x / 2, x / 2), BLACK) for x in (-2, 2)]
    return lamp_of(folder, sphere("ball", RADIUS, inside=AREA), disc, *specks, *shapes)


@pytest.fixture(scope="module")
def lamp(mi, tmp_path_factory):
    return disc_lamp(tmp_path_factory.mktemp("disc"))


@pytest.fixture(scope="module")
def field(lamp, tmp_path_factory):
    return bake_light_field(lamp, CONFIG, tmp_path_factory.mktemp("state"))


def entries(inside, resolution):
    """Cell row and bin of each entry."""
    return np.nonzero(np.unpackbits(inside.lit, axis=1, count=(resolution // 2) ** 2))


def ending_flux(field):
    """Flux [3] of J, local units."""
    inside = field.inside
    _, bins = entries(inside, field.resolution)
    flux = (
        inside.scale * unpack(inside.intensity) * coarse_solid_angles(field.resolution)[bins, None]
    )
    return flux.sum(axis=0)


def irradiance(mi, lamp, field, point, normal, *, samples=256):
    """Irradiance [3] of a receiver, as `LightInside` states it; the reference implementation.

    Args:
        point, normal: [3] in the frame of the lamp's file.
    """
    inside, frame = field.inside, lamp.frame
    resolution, side = field.resolution, 1 << field.depth
    bins, coarse = resolution**2, (resolution // 2) ** 2
    number = np.full((len(inside.cells), coarse), -1)
    number[entries(inside, resolution)] = np.arange(len(inside.intensity))
    codes, own = (
        each.astype(np.int64) @ [1, side, side**2] for each in (inside.cells, field.cells)
    )
    exits = np.zeros((len(codes), bins, 3))
    row = {code: index for index, code in enumerate(codes.tolist())}
    exits[[row[code] for code in own.tolist()]] = np.stack(
        [field.dense(each) for each in field.scale * unpack(field.intensity).T], axis=-1
    )
    low = np.maximum(inside.cells * 2 / side - 1, -frame.half_extents)
    high = np.minimum((inside.cells + 1) * 2 / side - 1, frame.half_extents)
    random = np.random.default_rng(0)
    cell = np.repeat(np.arange(len(codes)), samples)
    start = low[cell] + (high - low)[cell] * random.random((len(cell), 3))
    local = frame.local_from_world
    receiver = local[:3, :3] @ point + local[:3, 3]
    way = receiver - start
    distance = np.linalg.norm(way, axis=1)
    way /= distance[:, None]
    found = bin_of(on_device(mi.Vector3f, way), resolution)
    fine, wide = np.array(found), np.array(coarse_bin(found, resolution))
    entry = number[cell, wide]
    s = np.zeros(len(cell))
    lit = np.flatnonzero(entry >= 0)
    at = np.clip(np.searchsorted(inside.distances, distance, "right") - 1, 0, 18)
    part = (distance - inside.distances[at]) / np.diff(inside.distances)[at]
    curves, curve, k = inside.reach_curves, inside.reach[entry[lit]], at[lit]
    s[lit] = curves[curve, k] + np.clip(part[lit], 0, 1) * (curves[curve, k + 1] - curves[curve, k])
    ending = np.zeros((len(codes), coarse, 3))
    ending[entries(inside, resolution)] = inside.scale * unpack(inside.intensity)
    members = by_coarse_bin(np.arange(bins)[None])[0]
    parts = np.zeros((len(codes), bins))
    parts[:, members] = parts_of_ending(
        luminance(exits)[:, members], luminance(ending), solid_angles(resolution)[members]
    )
    light = exits[cell, fine]
    light += parts[cell, fine, None] * ending[cell, wide] * s[:, None]
    cosine = np.maximum(-way @ (np.asarray(normal) @ frame.rotation), 0)
    return (light * (cosine / distance**2)[:, None]).sum(axis=0) / samples


def mean_ratio(mi, lamp, field, distance, angles, *, count=48):
    """Mean irradiance [3] of receivers around the ball that face it, over π L r² / D².

    The ball has four cells across, and each cell and bin spreads light: one receiver is off by up
    to 15 %, but the light through a sphere around the ball is kept.

    Args:
        distance: D.
        angles: lower and upper limit of their angle with the x axis, degrees.
    """
    cosines = np.cos(np.deg2rad(angles))
    z = cosines[0] + (cosines[1] - cosines[0]) * (np.arange(count) + 0.5) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    radius = np.sqrt(1 - z**2)
    directions = np.stack([z, radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    found = [irradiance(mi, lamp, field, distance * each, -each, samples=32) for each in directions]
    return np.mean(found, axis=0) / (np.pi * RADIANCE * RADIUS**2 / distance**2)


@pytest.mark.parametrize(
    ("distance", "angles", "tolerance"),
    [
        slow(0.5, (0, 180), 0.02),
        (0.6, (0, 40), 0.04),
        slow(0.6, (65, 180), 0.04),
        (1.2, (75, 180), 0.03),
    ],
)
def test_irradiance_in_front_of_the_disc_and_around(mi, lamp, field, distance, angles, tolerance):
    """Between ball and disc all of the light ends on the disc, elsewhere all of it leaves."""
    found = mean_ratio(mi, lamp, field, distance, angles)
    assert found == pytest.approx(1, abs=tolerance)


def test_it_is_dark_behind_the_disc(mi, lamp, field):
    """The reach ends within 0.1 local units, in which its curves are linear."""
    assert (mean_ratio(mi, lamp, field, 1.4, (0, 10)) < 0.01).all()


def test_flux_that_ends_on_the_disc(lamp, field):
    """Form factor from a ball to a disc on an axis: (1 - cos of its half angle) / 2."""
    share = (1 - 1 / np.sqrt(1 + 1.2**2)) / 2
    emitted = 4 * np.pi**2 * (RADIUS / lamp.frame.scale) ** 2 * RADIANCE
    assert ending_flux(field) == pytest.approx(share * emitted, rel=0.02)


def test_the_light_field_light_is_as_without_it(mi, lamp, field, tmp_path, monkeypatch):
    from lumitree.fit.light_field import bake as module

    class Alone(LampRays):
        def draw(self, count, seed, *, ending=None, flux_limit=None):
            few = LampRays(lamp, 4).draw(4, 0, ending=EndingConfig(5, 0))
            paths = super().draw(count, seed, flux_limit=flux_limit)
            return dataclasses.replace(paths, ending=few.ending)

    monkeypatch.setattr(module, "LampRays", Alone)
    plain = bake_light_field(lamp, CONFIG, tmp_path)
    for name in ("cells", "lit", "intensity", "bent"):
        assert np.array_equal(getattr(plain, name), getattr(field, name))
    assert (plain.scale, plain.traced) == (field.scale, field.traced)


def test_no_light_ends_on_a_bare_ball(mi, tmp_path):
    """J has no entry, and one curve."""
    lamp = lamp_of(tmp_path, sphere("ball", 1, inside=AREA))
    config = LightFieldConfig(paths=1 << 18, batch=1 << 17, depth=2, resolution=8)
    inside = bake_light_field(lamp, config, tmp_path).inside
    assert not len(inside.intensity)
    assert len(inside.reach_curves) == 1


@pytest.mark.slow
def test_null_surfaces_do_not_block(mi, lamp, field, tmp_path):
    """A null sphere around the ball, which light passes as if it were not there."""
    other = disc_lamp(tmp_path, sphere("null", 0.9, inside=NULL))
    found = bake_light_field(other, dataclasses.replace(CONFIG, paths=1 << 19), tmp_path)
    for distance, angles in ((0.6, (0, 180)), (1.2, (75, 180))):
        light = mean_ratio(mi, other, found, distance, angles)
        assert light == pytest.approx(1, abs=0.05)


def test_an_equal_bake_gives_equal_light_inside(lamp, field, tmp_path):
    assert_equal_fields(bake_light_field(lamp, CONFIG, tmp_path), field)
