"""Colour rendering of spectra: published figures of illuminants, and lamps that have them."""

import builtins
import json
import re

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import EmittedSpectrum
from lumitree.cli import main
from lumitree.core.photometry import (
    WAVELENGTHS,
    blackbody_spectrum,
    sampled_spectrum,
    srgb_from_xyz,
    xyz_of_spectrum,
)
from lumitree.measure.photometric_figures import colour_figures, rendering_indices
from support.lamps import AREA, GLASS, scene, sphere
from support.tiny_bakes import LIGHT_FIELD

PATHS = 1 << 14


@pytest.fixture(autouse=True)
def folder(mi, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def illuminants():
    colour = pytest.importorskip("colour")
    return {
        name: sampled_spectrum(found.wavelengths, found.values)
        for name, found in colour.SDS_ILLUMINANTS.items()
    }


# CIE 15: illuminants, and Ra of fluorescent lamps, in whole numbers.
@pytest.mark.parametrize(
    ("name", "ra"),
    [
        *(("A", 100), ("D65", 100), ("FL1", 76), ("FL2", 64), ("FL3", 57), ("FL4", 51)),
        *(("FL5", 72), ("FL6", 59), ("FL7", 90), ("FL8", 95), ("FL9", 90), ("FL10", 81)),
        *(("FL11", 83), ("FL12", 83)),
    ],
)
def test_the_index_of_cie_illuminants(illuminants, name, ra):
    assert rendering_indices(illuminants[name]).ra == pytest.approx(ra, abs=0.6)


# FL2 by the calculator that the IES publishes with TM-30-18; A is its own reference.
@pytest.mark.parametrize(("name", "rf", "rg"), [("A", 100, 100), ("FL2", 70, 86)])
def test_fidelity_and_gamut_of_cie_illuminants(illuminants, name, rf, rg):
    found = rendering_indices(illuminants[name])
    assert (found.rf, found.rg) == (pytest.approx(rf, abs=0.6), pytest.approx(rg, abs=0.6))


def test_figures_do_not_depend_on_the_unit(illuminants):
    assert rendering_indices(7e-9 * illuminants["FL2"]).ra == pytest.approx(
        rendering_indices(illuminants["FL2"]).ra
    )


def test_saturated_red_is_rendered_badly_by_a_fluorescent_lamp(illuminants):
    """FL4, a halophosphate lamp of 2940 K."""
    assert rendering_indices(illuminants["FL4"]).r9 < -100


def test_the_colour_of_a_black_body():
    spectrum = EmittedSpectrum.of(blackbody_spectrum(2856))
    watts = srgb_from_xyz(xyz_of_spectrum(spectrum.power))
    found = colour_figures(spectrum, watts)
    assert found.colour_temperature == pytest.approx(2856, rel=1e-4)
    assert found.duv == pytest.approx(0, abs=1e-5)
    assert found.shift == pytest.approx(0, abs=1e-5)
    # Equal energy instead: (u', v') of E and A differ by 0.0680 (CIE 15).
    white = srgb_from_xyz(np.ones(3))
    assert colour_figures(spectrum, white).shift == pytest.approx(0.0680, abs=5e-4)


def test_green_light_has_no_colour_temperature_and_no_index():
    found = colour_figures(EmittedSpectrum.of(sampled_spectrum([530], [1])), np.ones(3))
    assert found.colour_temperature is None
    assert found.rendering is None


@pytest.mark.parametrize("share", [0.5, 0.998])
def test_without_all_emitters_nothing_is_known(share):
    spectrum = EmittedSpectrum.of(np.ones(471), share)
    assert colour_figures(spectrum, np.ones(3)) is None
    assert colour_figures(None, np.ones(3)) is None


def test_without_the_package_there_are_no_indices(monkeypatch):
    original = builtins.__import__

    def missing(name, *args, **options):
        if name.split(".")[0] == "colour":
            raise ImportError(name)
        return original(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", missing)
    found = colour_figures(EmittedSpectrum.of(blackbody_spectrum(2856)), np.ones(3))
    assert found.colour_temperature == pytest.approx(2856, rel=1e-4)
    assert found.rendering is None


def spectrum_file(path, spectrum):
    np.savetxt(path, np.column_stack([WAVELENGTHS, spectrum]))
    return f'<emitter type="area"><spectrum name="radiance" filename="{path.name}"/></emitter>'


@pytest.mark.slow
def test_a_lamp_its_asset_and_their_reports(folder, illuminants, capsys):
    emitter = spectrum_file(folder / "fl2.spd", illuminants["FL2"])
    (folder / "lamp.xml").write_text(scene(sphere("ball", 0.5, inside=emitter)))
    config = lumitree.BakeConfig(irradiance_paths=0, light=LIGHT_FIELD)
    result = lumitree.bake("lamp.xml", "lamp.lumitree", config)
    assert result.asset.spectrum.share == 1
    reports = [
        lumitree.photometry(source, output, step=30, paths=PATHS)
        for source, output in (("lamp.xml", ["a.html", "a.pdf"]), ("lamp.lumitree", []))
    ]
    for report in reports:
        found = report.emitted_colour
        assert found.rendering.ra == pytest.approx(64, abs=0.6)
        assert found.colour_temperature == pytest.approx(4225, rel=2e-3)
        assert found.duv == pytest.approx(0.0019, abs=1e-4)
        # Mitsuba's colour of the spectrum, through the whole measurement.
        assert found.shift < 5e-4
        assert report.colour_temperature.value == pytest.approx(4225, rel=5e-3)
    text = (folder / "a.html").read_text()
    assert re.search(r"CRI of the emitters</th><td>Ra 64, R9 -84", text)
    assert re.search(r"TM-30 of the emitters</th><td>Rf 70, Rg 86", text)
    capsys.readouterr()
    command = ["photometry", "lamp.lumitree", "--paths", str(PATHS), "--step", "30"]
    assert main([*command, "--json", "a.json"]) == 0
    assert re.search(r"CRI of the emitters  Ra 64, R9 -84", capsys.readouterr().out)
    stated = json.loads((folder / "a.json").read_text())["emitted_colour"]["rendering"]
    assert stated["rf"] == pytest.approx(70, abs=0.6)


def test_where_only_rgb_is_known_the_report_says_so(folder, capsys):
    (folder / "lamp.xml").write_text(scene(sphere("ball", 0.5, inside=AREA)))
    result = lumitree.photometry("lamp.xml", "a.html", step=30, paths=PATHS)
    assert result.emitted_colour is None
    assert result.spectrum_share == 0
    expected = "colour rendering</th><td>not known: no spectrum of the emitters is stated"
    assert expected in (folder / "a.html").read_text()


@pytest.mark.slow
def test_a_lamp_with_both_kinds_of_emitters_says_how_much_is_known(folder):
    """Two equal spheres of equal luminance, one of them by RGB."""
    flat = '<emitter type="area"><spectrum name="radiance" value="1"/></emitter>'
    grey = '<emitter type="area"><rgb name="radiance" value="1"/></emitter>'
    balls = sphere("a", 0.5, inside=flat), sphere("b", 0.5, (3, 0, 0), grey)
    (folder / "lamp.xml").write_text(scene(*balls))
    result = lumitree.photometry("lamp.xml", "a.html", step=30, paths=PATHS)
    assert result.spectrum_share == pytest.approx(0.5, abs=0.005)
    assert result.emitted_colour is None
    text = (folder / "a.html").read_text()
    assert re.search(r"emitters with (49|50)\.\d% of the flux have RGB", text)


def test_coloured_glass_shifts_the_colour_and_not_the_spectrum(folder, illuminants):
    emitter = spectrum_file(folder / "a.spd", illuminants["A"])
    glass = GLASS.replace("</bsdf>", '<rgb name="specular_transmittance" value="1,.5,.1"/></bsdf>')
    balls = sphere("ball", 0.5, inside=emitter), sphere("glass", 1, inside=glass)
    (folder / "lamp.xml").write_text(scene(*balls))
    found = lumitree.photometry("lamp.xml", step=30, paths=PATHS).emitted_colour
    assert found.colour_temperature == pytest.approx(2856, rel=1e-3)
    assert found.rendering.ra == pytest.approx(100, abs=0.1)
    assert found.shift > 0.02
