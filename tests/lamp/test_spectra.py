"""Spectra of scenes: read beside the scene, known in fingerprints, and stored as colours."""

import numpy as np
import pytest

from lumitree.asset.materials import Diffuse
from lumitree.lamp.luminaire import load_luminaire
from lumitree.lamp.stored_geometry import stored_geometry
from support.lamps import scene, sphere

LISTED = "400:0.2, 500:0.7, 600:0.4, 700:0.9"


def lamp(folder, inside):
    (folder / "lamp.xml").write_text(scene(sphere("ball", 0.5, inside=inside)))
    return load_luminaire(folder / "lamp.xml")


def area(value):
    return f'<emitter type="area"><spectrum name="radiance" {value}/></emitter>'


def test_a_file_is_found_beside_the_scene_and_part_of_the_fingerprint(mi, tmp_path):
    (tmp_path / "led.spd").write_text("400 1\n500 4\n")
    first = lamp(tmp_path, area('filename="led.spd"'))
    assert next(iter(first.file.spectra.values()))[1].tolist() == [1, 4]
    assert load_luminaire(tmp_path / "lamp.xml").fingerprint == first.fingerprint
    (tmp_path / "led.spd").write_text("400 1\n500 5\n")
    assert load_luminaire(tmp_path / "lamp.xml").fingerprint != first.fingerprint


@pytest.mark.parametrize("value", ['value="3"', f'value="{LISTED}"'])
def test_radiance_is_stored_as_what_the_scene_emits(mi, tmp_path, value):
    loaded = lamp(tmp_path, area(value))
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(0, 0, 1)
    emitted = np.ravel(loaded.scene.shapes()[0].emitter().eval(si))
    (shape,) = stored_geometry(loaded).shapes
    assert shape.radiance == pytest.approx(emitted, rel=1e-6)


@pytest.mark.parametrize(
    ("bsdf", "name"), [("diffuse", "reflectance"), ("conductor", "specular_reflectance")]
)
def test_reflectances_are_stored_as_colours(mi, tmp_path, bsdf, name):
    material = f'<bsdf type="{bsdf}"><spectrum name="{name}" value="{LISTED}"/></bsdf>'
    loaded = lamp(tmp_path, material + area('value="1"'))
    texture = mi.traverse(loaded.scene.shapes()[0].bsdf())[f"{name}.value"]
    (stored,) = stored_geometry(loaded).materials
    colour = getattr(stored, name)
    assert colour == pytest.approx(np.ravel(texture), rel=1e-6)
    assert np.ptp(colour) > 0.05


def test_a_constant_reflectance_is_a_number(mi, tmp_path):
    material = '<bsdf type="diffuse"><spectrum name="reflectance" value="0.25"/></bsdf>'
    (stored,) = stored_geometry(lamp(tmp_path, material + area('value="1"'))).materials
    assert stored == Diffuse(reflectance=0.25)


def test_an_index_of_refraction_may_exceed_one(mi, tmp_path):
    eta = '<spectrum name="eta" value="400:1.5, 700:2.5"/>'
    k = '<spectrum name="k" value="400:3, 700:4"/>'
    loaded = lamp(tmp_path, f'<bsdf type="conductor">{eta}{k}</bsdf>' + area('value="1"'))
    (stored,) = stored_geometry(loaded).materials
    assert min(stored.k) > 2
    assert max(stored.eta) > 1.6
