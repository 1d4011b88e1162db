"""Straight and bent light of small lamps whose parts are known, and of the light field's bins."""

import numpy as np
import pytest

from lumitree.asset.light_field import is_part, make_light_field, pack, pack_part, unpack
from lumitree.core.device import as_rows
from lumitree.core.octahedral import coarse_solid_angles, solid_angles
from lumitree.core.photometry import luminance
from lumitree.fit.light_field.bake import bake_light_field
from lumitree.trace.light_field_config import LightFieldConfig
from lumitree.trace.light_paths import LampRays
from lumitree.trace.segments import EndingConfig
from support.lamps import AREA, cube, lamp_of, sphere

DEPTH = 4
CONFIG = LightFieldConfig(paths=1 << 19, batch=1 << 18, depth=DEPTH, resolution=16)
RADIANCE = np.array([3.0, 2.0, 1.0])
TINT = np.array([0.9, 0.5, 0.2])
THIN = (
    '<bsdf type="thindielectric"><float name="int_ior" value="1.5"/><float name="ext_ior" '
    'value="1"/><rgb name="specular_transmittance" value="0.9,0.5,0.2"/></bsdf>'
)
GREY = (
    '<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></bsdf>'
)
BULB = 0.05
EMITTED = 4 * np.pi**2 * BULB**2 * RADIANCE


def plane(name, centre, angles, inside):
    """A square of half side 1; `angles` about the x and the y axis."""
    x, y, z = centre
    return (
        f'<shape type="rectangle" id="{name}"><transform name="to_world">'
        f'<rotate x="1" angle="{angles[0]}"/><rotate y="1" angle="{angles[1]}"/>'
        f'<translate x="{x}" y="{y}" z="{z}"/></transform>{inside}</shape>'
    )


def outside(field, lamp):
    """Flux [C, 3] of the light that leaves, and of its bent part, by cell, square scene units."""
    solid_angle = solid_angles(field.resolution)
    scale = field.scale * lamp.frame.scale**2
    return (
        np.stack([scale * field.dense(each) @ solid_angle for each in unpack(words).T], axis=1)
        for words in (field.intensity, field.bent)
    )


def ending(field, lamp):
    """Flux [E, 3] of the light that ends, and of its bent part, by entry, square scene units."""
    inside = field.inside
    _, bins = np.nonzero(np.unpackbits(inside.lit, axis=1, count=(field.resolution // 2) ** 2))
    factor = inside.scale * lamp.frame.scale**2 * coarse_solid_angles(field.resolution)[bins, None]
    return (factor * unpack(words) for words in (inside.intensity, inside.bent))


@pytest.fixture(scope="module")
def bulb_in_box(mi, tmp_path_factory):
    """A small ball in the middle of a box of grey walls; a mask of opacity 0.4 closes its top."""
    walls = [
        plane("floor", (0, 0, -1), (0, 0), GREY),
        *(plane(f"x{x}", (x, 0, 0), (0, 90), GREY) for x in (-1, 1)),
        *(plane(f"y{y}", (0, y, 0), (90, 0), GREY) for y in (-1, 1)),
    ]
    mask = f'<bsdf type="mask"><float name="opacity" value="0.4"/>{GREY}</bsdf>'
    shapes = sphere("bulb", BULB, inside=AREA), *walls, plane("lid", (0, 0, 1), (0, 0), mask)
    return lamp_of(tmp_path_factory.mktemp("box"), *shapes)


@pytest.fixture(scope="module")
def box_field(bulb_in_box, tmp_path_factory):
    return bake_light_field(bulb_in_box, CONFIG, tmp_path_factory.mktemp("state"))


def test_light_through_a_mask_is_straight(bulb_in_box, box_field):
    """A sixth of the light gets to the lid, of which the mask lets 60 % pass."""
    whole, bent = outside(box_field, bulb_in_box)
    assert (whole - bent).sum(axis=0) == pytest.approx(EMITTED * 0.6 / 6, rel=0.02)
    # All reflections in a closed grey box: bent light is a large part.
    assert bent[:, 0].sum() > 0.3 * whole[:, 0].sum()
    # Straight light starts at the ball, and not at the mask.
    middle = np.isin(box_field.cells, (7, 8)).all(axis=1)
    assert bent[~middle] == pytest.approx(whole[~middle])
    assert (bent[middle] < 1e-3 * whole[middle].max()).all()


def test_the_light_that_ends_is_straight_once(bulb_in_box, box_field):
    """Straight light is emitted light that the walls and the mask stop; later segments are bent."""
    whole, bent = ending(box_field, bulb_in_box)
    expected = EMITTED * (5 + 0.4) / 6
    assert (whole - bent).sum(axis=0) == pytest.approx(expected, rel=0.02)
    assert (bent.sum(axis=0) > 0.2 * whole.sum(axis=0)).all()


def test_bent_light_that_ends_has_its_own_reach(bulb_in_box, box_field):
    """Flux beyond three distances, of another trace; a reach starts anywhere in its cell."""
    inside = box_field.inside
    rays = LampRays(bulb_in_box).draw(1 << 18, 99, ending=EndingConfig(DEPTH, 98)).ending
    assert rays is not None
    straight, origin = np.array(rays.straight), as_rows(rays.origin)
    side = 2 / (1 << DEPTH)
    start = (np.floor(origin / side) + np.random.default_rng(1).random(origin.shape)) * side
    reach = np.array(rays.reach) + ((origin - start) * as_rows(rays.direction)).sum(axis=1)
    whole, bent = ending(box_field, bulb_in_box)
    flux = luminance(as_rows(rays.flux)) * bulb_in_box.frame.scale**2
    distances = inside.distances[[6, 12, 17]]
    for rows, light, chosen in (
        (inside.reach, whole, np.ones(len(straight), bool)),
        (inside.bent_reach, bent, ~straight),
    ):
        found = luminance(light) @ inside.reach_curves[rows][:, [6, 12, 17]]
        expected = [flux[chosen & (reach >= each)].sum() for each in distances]
        assert found == pytest.approx(expected, abs=0.02 * flux[chosen].sum())


def test_tinted_thin_glass(mi, tmp_path):
    """Straight light by Fresnel's equations, for a slab with interreflection."""
    shapes = sphere("bulb", BULB, inside=AREA), cube("shade", 1, inside=THIN)
    lamp = lamp_of(tmp_path, *shapes)
    whole, bent = outside(bake_light_field(lamp, CONFIG, tmp_path), lamp)
    direction = np.random.default_rng(0).normal(size=(1 << 18, 3))
    cosine = np.abs(direction).max(axis=1) / np.linalg.norm(direction, axis=1)
    inner = np.sqrt(1 - (1 - cosine**2) / 1.5**2)
    amplitudes = (
        (cosine - 1.5 * inner) / (cosine + 1.5 * inner),
        (inner - 1.5 * cosine) / (inner + 1.5 * cosine),
    )
    reflectance = np.mean(np.square(amplitudes), axis=0)
    transmittance = 1 - 2 * reflectance / (1 + reflectance)
    expected = EMITTED * TINT * transmittance.mean()
    assert (whole - bent).sum(axis=0) == pytest.approx(expected, rel=0.01)
    # Reflected light leaves through another face, from the face that has reflected it.
    assert (bent.sum(axis=0) > 0.05 * whole.sum(axis=0)).all()


@pytest.mark.parametrize("albedo", [0.0, 0.5])
def test_a_medium_attenuates_straight_light(mi, tmp_path, albedo):
    """exp(-σ r) of it stays straight; what is scattered is bent."""
    medium = (
        '<bsdf type="null"/><medium type="homogeneous" name="interior"><rgb name="sigma_t" '
        'value="0.25,0.5,1"/><float name="scale" value="2"/>'
        f'<float name="albedo" value="{albedo}"/></medium>'
    )
    black = '<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
    shapes = sphere("bulb", BULB, inside=AREA + black), sphere("fog", 1, inside=medium)
    lamp = lamp_of(tmp_path, *shapes)
    whole, bent = outside(bake_light_field(lamp, CONFIG, tmp_path), lamp)
    # The mean distance from the surface of the ball.
    expected = EMITTED * np.exp(-np.array([0.5, 1, 2]) * (1 - 2 * BULB / 3))
    assert (whole - bent).sum(axis=0) == pytest.approx(expected, rel=0.02)
    assert (bent.sum(axis=0) > 0.1 * whole.sum(axis=0)).all() == (albedo > 0)
    assert bent.any() == (albedo > 0)


def test_a_bare_ball_has_straight_light_alone(mi, tmp_path):
    field = bake_light_field(lamp_of(tmp_path, sphere("bulb", 1, inside=AREA)), CONFIG, tmp_path)
    assert not field.bent.any()


def test_colours_of_straight_and_bent_light_in_one_bin():
    """Red straight light, and white light beside it that is bent."""
    intensity, bent = np.zeros((1, 16, 3)), np.zeros((1, 16, 3))
    intensity[0, 3], bent[0, 3] = (1.0, 0.25, 0.25), (0.25, 0.25, 0.25)
    intensity[0, 5], bent[0, 5] = (0.5, 0.5, 0), (0.5, 0.5, 0)
    intensity[0, 7] = (0.1, 0.2, 0.3)
    field = make_light_field(np.zeros((1, 3), int), intensity, 1, bent=bent)
    assert unpack(field.bent) == pytest.approx(bent[0, [3, 5, 7]])
    assert field.bent[1] == field.intensity[1]
    assert field.bent[2] == 0
    alone = make_light_field(np.zeros((1, 3), int), intensity, 1)
    assert np.array_equal(alone.bent, alone.intensity)


def test_packed_parts_are_never_larger():
    random = np.random.default_rng(0)
    whole = random.random((1 << 16, 3)) * np.exp2(-random.uniform(0, 38, (1 << 16, 1)))
    words = pack(whole)
    part = whole * np.minimum(random.uniform(0, 1.2, whole.shape), 1)
    found = pack_part(part, words)
    assert is_part(found, words)
    error = np.abs(unpack(found) - part).max(axis=1)
    assert (error <= np.maximum(0.002 * whole.max(axis=1), 2**-40)).all()
    assert np.array_equal(pack_part(whole, words), words)
    assert not pack_part(0 * whole, words).any()
    assert not is_part(found + np.uint32(1), found)
