"""Black bodies in RGB variants: their luminance and their colour are those of Planck's law."""

import warnings

import numpy as np
import pytest

from lumitree.core.photometry import WAVELENGTHS, blackbody_radiance, blackbody_spectrum, luminance
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.rendering.scene import place_shapes
from support.lamps import lamp_of, scene, sphere

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
