"""Lamps of opal glass shown by their geometries, against the explicit lamps."""

from typing import Any

import numpy as np
import pytest
from test_geometry_appearance import (
    GREY,
    PASSES,
    ROUGH,
    assert_direct_light_is_the_field,
    assert_same_expectation,
    baked,
    camera,
    explicit,
    floor,
    lit_room,
    passes,
)

import lumitree
from lumitree.core.frames import similarity
from support.explicit_lamps import baked_once
from support.lamps import GLASS, cube, scene, sphere
from support.slow import slow

GLOWS = (
    '<bsdf type="diffuse"><rgb name="reflectance" value="0.2,0.2,0.2"/></bsdf>'
    '<emitter type="area"><rgb name="radiance" value="8,6,4"/></emitter>'
)
DARK = GLOWS.replace("8,6,4", "1e-4,1e-4,1e-4")
FROSTED = (
    '<bsdf type="roughdielectric"><float name="int_ior" value="1.3"/>'
    '<float name="ext_ior" value="1"/><float name="alpha" value="0.4"/></bsdf>'
)
MILK = (
    '<medium type="homogeneous" name="{}"><rgb name="sigma_t" value="0.6,0.8,1"/>'
    '<float name="scale" value="{}"/><rgb name="albedo" value="0.95,0.9,0.8"/>'
    '<phase type="hg"><float name="g" value="0.3"/></phase></medium>'
)
DEEP: dict[str, Any] = {"max_depth": 200, "rr_depth": 40}


def solid(glass, light=GLOWS):
    """A ball of opal glass, with a light in the medium and metal before it."""
    return scene(
        sphere("bulb", 0.25, (0.2, 0, 0), light + MILK.format("exterior", 3)),
        sphere("ball", 0.9, inside=glass + MILK.format("interior", 3)),
        cube("bar", (0.9, 0.05, 0.05), (0, 0.95, 0), ROUGH),
    )


def hollow(glass):
    """A shell of opal glass around a light in the air."""
    return scene(
        sphere("bulb", 0.25, (0.2, 0, 0), GLOWS),
        sphere("outer", 0.9, inside=glass + MILK.format("interior", 6)),
        sphere("inner", 0.7, inside=glass + MILK.format("interior", 6), flip=True),
        cube("bar", (0.9, 0.05, 0.05), (0, 0.95, 0), GREY),
    )


LAMPS = {
    "smooth": solid(GLASS),
    "frosted": solid(FROSTED),
    "hollow": hollow(GLASS),
    "frosted and hollow": hollow(FROSTED),
}


@pytest.fixture(scope="module")
def make(mi, tmp_path_factory):
    return baked_once(tmp_path_factory.mktemp("lamps"), paths=1 << 18)


def seen_alone():
    """The lamp before nothing: it fills most of the image."""
    return {"sensor": camera([0.3, 1.2, 1.6], [0, 1, 0], 32)}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "frosted",
        *(slow(each) for each in LAMPS if each != "frosted"),
    ],
)
def test_opal_glass_is_seen_as_it_is(make, name):
    """Pixel by pixel and as a whole: by what the lamp's shapes emit, and by nothing else."""
    lamp, asset = make(LAMPS[name])
    assert any(shape.scatters for shape in asset.geometry.shapes)
    ours = passes(seen_alone() | baked(asset), spp=1024, **DEEP)
    theirs = passes(seen_alone() | explicit(lamp), spp=1024, seed=500, **DEEP)
    assert theirs.mean() > 0.1
    assert_same_expectation(ours, theirs)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["smooth", slow("frosted")])
def test_a_lamp_that_lights_its_box_does_not_light_itself(make, name):
    """Something black in a corner of the box: the lamp looks as before, but for what it hides."""
    lamp, asset = make(LAMPS[name])
    black = {"type": "diffuse", "reflectance": 0.0}
    crumb = {"type": "sphere", "center": [0.27, 0.8, 0.27], "radius": 0.04, "bsdf": black}
    objects = seen_alone() | {"crumb": crumb}
    ours = passes(objects | baked(asset), spp=1024, **DEEP)
    theirs = passes(objects | explicit(lamp), spp=1024, seed=500, **DEEP)
    assert_same_expectation(ours, theirs)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["smooth", slow("hollow")])
def test_paths_from_elsewhere_do_not_find_the_lights_in_the_lamp(make, name):
    """A floor has that light already: its mean agrees with the explicit lamp, within cells."""
    lamp, asset = make(LAMPS[name])
    sensor = camera([0.5, 0.35, 1.2], [0.3, 0, 0.6], 25)
    objects = {"sensor": sensor, "floor": floor({"type": "diffuse", "reflectance": 0.9})}
    place = similarity(np.eye(3), 0.4, [0, 0.45, 0])
    ours = passes(objects | baked(asset, place=place), spp=1024, **DEEP).mean(axis=(1, 2))
    theirs = passes(objects | explicit(lamp, place), spp=4096, seed=500, **DEEP).mean(axis=(1, 2))
    error = np.hypot(ours.std(0), theirs.std(0)) / np.sqrt(PASSES)
    assert (np.abs(ours.mean(0) - theirs.mean(0)) < 4 * error + 0.02 * theirs.mean(0)).all()
    assert (error < 0.03 * theirs.mean(0)).all()


@pytest.mark.slow
def test_light_that_scatters_in_the_lamp_is_shown_at_any_depth(make):
    """The largest depth cuts paths in the room, and not the lamp's image."""
    _, asset = make(LAMPS["hollow"])
    deep = passes(seen_alone() | baked(asset), spp=1024, **DEEP)
    shallow = passes(seen_alone() | baked(asset), spp=1024, seed=500, max_depth=2)
    assert_same_expectation(shallow, deep)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["smooth", slow("frosted and hollow")])
def test_direct_light_is_the_light_field_once(make, name):
    assert_direct_light_is_the_field(make(LAMPS[name])[1], floor({"type": "diffuse"}))


@pytest.mark.slow
def test_fog_gets_the_light_of_the_lamp(make):
    """A scattering in a medium of the room is a receiver like any other."""
    _, asset = make(LAMPS["smooth"])
    fog = {"type": "homogeneous", "sigma_t": 0.3, "albedo": 0.8}
    clear, foggy = (
        assert_direct_light_is_the_field(asset, floor({"type": "diffuse"}), **medium)
        for medium in ({}, {"medium": fog})
    )
    assert abs(foggy.mean() / clear.mean() - 1) > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("glass", [GLASS, FROSTED], ids=["smooth", "frosted"])
def test_a_lamp_that_is_nearly_dark_is_an_object_of_the_room(make, glass):
    """Light of others scatters in it, and the floor gets it, as with the explicit lamp."""
    lamp, asset = make(solid(glass, DARK))
    ours = passes(lit_room() | baked(asset), spp=2048, **DEEP)
    theirs = passes(lit_room() | explicit(lamp), spp=2048, seed=500, **DEEP)
    assert_same_expectation(ours, theirs)


@pytest.mark.slow
def test_a_medium_gets_the_own_light_of_its_lamp_alone(make):
    """The light of another lamp of opal glass comes from its light field, once."""
    _, asset = make(LAMPS["frosted"])
    dark, dark_asset = make(solid(GLASS, DARK))
    above, below = (similarity(np.eye(3), 0.3, [0, y, 0]) for y in (1.65, 0.9))
    objects = {
        "sensor": camera([0.3, 1.2, 1.9], [0.1, 0.6, 0], 50),
        "floor": floor({"type": "diffuse"}),
        "other": lumitree.shape(asset, above, appearance="geometry"),
    }
    ours = passes(objects | baked(dark_asset, place=below), spp=2048, **DEEP)
    theirs = passes(objects | explicit(dark, below), spp=2048, seed=500, **DEEP)
    assert ours.mean() > 1e-3
    assert_same_expectation(ours, theirs)


@pytest.mark.slow
def test_shapes_share_the_objects_of_equal_media(mi, make):
    from lumitree.lamp.media import media, scatters

    for name in LAMPS:
        loaded = mi.load_dict({"type": "scene", **baked(make(LAMPS[name])[1])})
        assert len({id(each) for each in media(loaded)}) == 1
        assert all(map(scatters, media(loaded)))
