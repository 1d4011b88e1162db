"""The spectrum of a luminaire's emitters."""

import warnings

import numpy as np
import pytest

from lumitree.core.photometry import (
    WAVELENGTHS,
    blackbody_spectrum,
    luminance,
    sampled_spectrum,
    xyz_of_spectrum,
)
from lumitree.errors import LumitreeError
from lumitree.trace.flux import emitted_spectrum
from support.lamps import AREA, lamp_of, scene, sphere


def area(radiance):
    return f'<emitter type="area">{radiance}</emitter>'


def listed(*pairs):
    values = ", ".join(f"{at}:{value}" for at, value in pairs)
    return area(f'<spectrum name="radiance" value="{values}"/>')


def blackbody(temperature):
    inner = f'<float name="temperature" value="{temperature}"/>'
    return area(f'<spectrum type="blackbody" name="radiance">{inner}</spectrum>')


RED = listed((600, 0), (620, 2), (640, 0))
BLUE = listed((440, 0), (450, 5), (460, 0))


def spectrum_of(lamp):
    """The spectrum of its emitters, which it has."""
    found = emitted_spectrum(lamp)
    assert found is not None
    return found


def peak(spectrum):
    return spectrum / spectrum.max()


@pytest.mark.parametrize("scale", [1, 1e-3])
def test_a_spectrum_of_a_scene(mi, tmp_path, scale):
    pairs = [(400, 1 * scale), (555.5, 3 * scale), (700, 2 * scale)]
    found = spectrum_of(lamp_of(tmp_path, sphere("a", 1, inside=listed(*pairs))))
    assert found.power == pytest.approx(peak(sampled_spectrum(*np.array(pairs).T)), abs=1e-6)
    assert found.share == 1


def test_a_spectrum_of_a_file(mi, tmp_path):
    (tmp_path / "lamp.spd").write_text("# a comment\n400 1\n500 4\n")
    emitter = area('<spectrum name="radiance" filename="lamp.spd"/>')
    found = spectrum_of(lamp_of(tmp_path, sphere("a", 1, inside=emitter)))
    assert found.power == pytest.approx(peak(sampled_spectrum([400, 500], [1, 4])), abs=1e-6)


@pytest.mark.filterwarnings("ignore::lumitree.errors.LumitreeWarning")
def test_a_black_body(mi, tmp_path):
    found = spectrum_of(lamp_of(tmp_path, sphere("a", 1, inside=blackbody(3000))))
    assert found.power == pytest.approx(peak(blackbody_spectrum(3000)), abs=1e-6)


def test_a_constant_spectrum_is_one_and_a_number_is_none(mi, tmp_path):
    """As in Mitsuba: `spectrum` is of equal energy, `float` a white of D65."""
    flat = area('<spectrum name="radiance" value="3"/>')
    assert (spectrum_of(lamp_of(tmp_path, sphere("a", 1, inside=flat))).power == 1).all()
    for radiance in ('<float name="radiance" value="3"/>', '<rgb name="radiance" value="1,2,3"/>'):
        lamp = lamp_of(tmp_path, sphere("a", 1, inside=area(radiance)))
        assert emitted_spectrum(lamp) is None


@pytest.mark.parametrize("value", ["spectrum", "blackbody"])
def test_a_dictionary(mi, value):
    from lumitree.lamp.luminaire import load_luminaire

    radiance = {
        "spectrum": {"type": "spectrum", "value": [(400.0, 1.0), (700.0, 3.0)]},
        "blackbody": {"type": "blackbody", "temperature": 2700.0},
    }[value]
    emitter = {"type": "area", "radiance": radiance}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        lamp = load_luminaire({"type": "scene", "ball": {"type": "sphere", "emitter": emitter}})
    expected = {
        "spectrum": sampled_spectrum([400, 700], [1, 3]),
        "blackbody": blackbody_spectrum(2700),
    }[value]
    assert spectrum_of(lamp).power == pytest.approx(peak(expected), abs=1e-6)


def test_emitters_count_by_their_luminous_flux(mi, tmp_path):
    """Spheres of radii 1 and 2: the second has four times the flux at equal radiance."""
    lamp = lamp_of(tmp_path, sphere("a", 1, inside=RED), sphere("b", 2, (5, 0, 0), BLUE))
    found = spectrum_of(lamp)
    red, blue = (
        sampled_spectrum([600, 620, 640], [0, 2, 0]),
        sampled_spectrum([440, 450, 460], [0, 5, 0]),
    )
    assert found.share == pytest.approx(1)
    # As RGB both are clipped at the gamut of sRGB, so their luminances differ from the spectra's.
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(0, 0, 1)
    lumens = luminance([np.ravel(shape.emitter().eval(si)) for shape in lamp.scene.shapes()])
    weights = np.array([1, 4]) * lumens / [xyz_of_spectrum(each)[1] for each in (red, blue)]
    assert found.power == pytest.approx(peak(weights @ [red, blue]), abs=0.01)


def test_the_share_of_those_that_have_one(mi, tmp_path):
    """Both have luminance 1, and the areas are as 1 to 4."""
    flat, grey = (area(f'<{kind} name="radiance" value="1"/>') for kind in ("spectrum", "rgb"))
    lamp = lamp_of(tmp_path, sphere("a", 1, inside=flat), sphere("b", 2, (5, 0, 0), grey))
    assert spectrum_of(lamp).share == pytest.approx(0.2, abs=0.003)


def test_the_emission_of_a_lamp_does_not_change(mi, tmp_path):
    """Emitters without an id get one, by which their spectra are found."""
    lamp = lamp_of(tmp_path, *(sphere(f"{i}", 1, (3 * i, 0, 0), RED) for i in range(3)))
    assert [shape.label for shape in lamp.shapes] == ["'0'", "'1'", "'2'"]
    assert len({emitter.id() for emitter in lamp.scene.emitters()}) == 3


def test_a_lamp_far_from_its_origin_keeps_its_spectrum(mi, tmp_path):
    lamp = lamp_of(tmp_path, sphere("a", 0.1, (1e6, 0, 0), RED))
    assert lamp.origin.any()
    assert spectrum_of(lamp).power[WAVELENGTHS == 620] == 1


def test_invisible_light_is_no_spectrum(mi, tmp_path):
    lamp = lamp_of(
        tmp_path, sphere("a", 1, inside=listed((900, 1), (990, 1))), sphere("b", 1, inside=AREA)
    )
    assert emitted_spectrum(lamp) is None


def test_negative_values_are_refused(mi, tmp_path):
    lamp = lamp_of(tmp_path, sphere("a", 1, inside=listed((400, -1), (500, 5), (600, 1))))
    with pytest.raises(LumitreeError, match="a value is negative"):
        emitted_spectrum(lamp)


def test_a_scene_of_the_user_has_none(mi, tmp_path):
    from lumitree.lamp.luminaire import load_luminaire

    loaded = mi.load_string(scene(sphere("a", 1, inside=RED)))
    assert emitted_spectrum(load_luminaire(loaded)) is None
