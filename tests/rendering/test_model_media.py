"""Lamps of opal glass shown by their models: against the explicit lamp, and what must not change."""

import dataclasses

import numpy as np
import pytest

import lumitree
import tiny_bakes
from lamps import GLASS, cube, scene, sphere
from lumitree.asset.asset import exitant_asset
from lumitree.core.frames import rotation, similarity
from lumitree.exitant.bake import bake_exitant
from lumitree.luminaire.luminaire import load_luminaire
from lumitree.luminaire.stored_model import stored_model
from test_model_appearance import (
    GREY,
    ROUGH,
    assert_same_expectation,
    camera,
    explicit,
    floor,
    panel,
    passes,
)

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
PLACE = similarity(rotation([0, 1, 1], 20), 0.4, [0, 1, 0])
DEEP = {"max_depth": 200, "rr_depth": 40}


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
    "null": solid('<bsdf type="null"/>'),
}


@pytest.fixture(scope="module")
def make(mi, tmp_path_factory):
    """A function: the luminaire of a scene's text, and its asset with a model."""
    folder = tmp_path_factory.mktemp("lamps")
    known = {}

    def made(text):
        if text not in known:
            path = folder / f"lamp{len(known)}.xml"
            path.write_text(text)
            lamp = load_luminaire(path)
            config = dataclasses.replace(tiny_bakes.EXITANT, paths=1 << 18, batch=1 << 18)
            exitant = bake_exitant(lamp, config, tmp_path_factory.mktemp("state"))
            asset = exitant_asset(exitant, lamp.frame, lamp.name)
            known[text] = lamp, dataclasses.replace(asset, model=stored_model(lamp))
        return known[text]

    return made


def baked(asset, place=PLACE, appearance="model"):
    return {"lamp": lumitree.shape(asset, place, appearance=appearance)}


def seen_alone():
    """The lamp before nothing: it fills most of the image."""
    return {"sensor": camera([0.3, 1.2, 1.6], [0, 1, 0], 32)}


@pytest.mark.parametrize("name", [name for name in LAMPS if name != "null"])
def test_opal_glass_is_seen_as_it_is(make, name):
    """Pixel by pixel and as a whole: by what the lamp's shapes emit, and by nothing else."""
    lamp, asset = make(LAMPS[name])
    assert asset.model.has_scattering
    ours = passes(seen_alone() | baked(asset), spp=1024, **DEEP)
    theirs = passes(seen_alone() | explicit(lamp), spp=1024, seed=500, **DEEP)
    assert theirs.mean() > 0.1
    assert_same_expectation(ours, theirs)
