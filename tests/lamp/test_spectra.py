"""Spectra of scenes: stored as colours, part of fingerprints; and black bodies by Planck's law."""

import warnings

import numpy as np
import pytest

from lumitree.asset.materials import Diffuse
from lumitree.core.photometry import WAVELENGTHS, blackbody_radiance, blackbody_spectrum, luminance
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp.luminaire import load_luminaire
from lumitree.lamp.stored_geometry import stored_geometry
from lumitree.rendering.scene import place_shapes
from support.lamps import lamp_of, scene, sphere

LISTED = "400:0.2, 500:0.7, 600:0.4, 700:0.9"


def lamp(folder, inside):
    return lamp_of(folder, sphere("ball", 0.5, inside=inside))


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


BODY = (
    '<emitter type="{}"><spectrum type="blackbody" name="{}">'
    '<float name="temperature" value="{}"/></spectrum></emitter>'
)


def test_platinum_at_its_freezing_point_has_60_candela_per_square_centimetre(mi):
    """By which the candela was defined from 1948 to 1979."""
    assert luminance(blackbody_radiance(2042.0)) == pytest.approx(60e4, rel=0.01)


def test_wavelengths_add_up(mi):
    parts = np.array([blackbody_radiance(3000.0, 360, 560.5), blackbody_radiance(3000.0, 560.5)])
    assert luminance(parts).sum() == pytest.approx(luminance(blackbody_radiance(3000.0)))


def test_a_lamp_emits_it_and_says_so_once(mi, tmp_path):
    body = BODY.format("area", "radiance", 2700)
    balls = [sphere(name, 0.5, (x, 0, 0), body) for x, name in enumerate(("a", "b"))]
    with pytest.warns(LumitreeWarning) as caught:
        lamp = lamp_of(tmp_path, *balls)
    (entry,) = [each for each in caught if each.category is LumitreeWarning]
    assert "a, b: a blackbody of 2700 K is taken as the RGB 3.3" in str(entry.message)
    expected = blackbody_radiance(2700.0)
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(0, 0, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error", LumitreeWarning)
        placed = list(place_shapes(lamp, np.eye(4)).values())
    for shape in (*lamp.scene.shapes(), *placed):
        assert np.ravel(shape.emitter().eval(si)) == pytest.approx(expected, rel=1e-6)


def test_emitters_of_rooms_are_converted(mi, tmp_path):
    from lumitree.rendering.scene import load_scene

    point, ball = BODY.format("point", "intensity", 2000), sphere("ball", 1)
    (tmp_path / "room.xml").write_text(
        scene('<integrator type="path"/><sensor type="perspective"/>', point, ball)
    )
    with pytest.warns(LumitreeWarning, match="point: a blackbody of 2000 K"):
        loaded, _ = load_scene(str(tmp_path / "room.xml"))
    found = mi.traverse(loaded.emitters()[0])["intensity.value"]
    assert np.ravel(found) == pytest.approx(blackbody_radiance(2000.0), rel=1e-6)


@pytest.mark.parametrize(
    ("temperature", "message"), [("0", "0 K; expected 100 to"), ("1e9", "expected 100 to")]
)
def test_a_temperature_out_of_range_is_refused(mi, tmp_path, temperature, message):
    with pytest.raises(LumitreeError, match=message):
        lamp_of(tmp_path, sphere("a", 1, inside=BODY.format("area", "radiance", temperature)))
    body = '<emitter type="area"><spectrum type="blackbody" name="radiance"/></emitter>'
    with pytest.raises(LumitreeError, match="temperature of a blackbody is None"):
        lamp_of(tmp_path, sphere("a", 1, inside=body))


@pytest.mark.parametrize(
    ("shortest", "longest"), [(550, 551), (545, 555), (500, 500.2), (550.4, 550.6), (300, 900)]
)
def test_a_range_of_wavelengths_has_its_own_power(shortest, longest):
    """Against the sum over a fine grid of Planck's law between the whole nanometres around."""
    whole = blackbody_spectrum(3000)
    fine = np.linspace(shortest, longest, 20001)
    inside = np.interp(fine, WAVELENGTHS, whole, left=0, right=0)
    found = blackbody_spectrum(3000, shortest, longest).sum()
    assert found == pytest.approx(np.trapezoid(inside, fine), rel=0.01)
