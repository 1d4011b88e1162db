"""IES TM-33 files as lamps, against the intensities that they state."""

# pyright: reportArgumentType=false
import warnings
from pathlib import Path

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.core.file_kinds import SCENE, TM33, what_it_is
from lumitree.core.octahedral import middle_directions
from lumitree.core.photometry import blackbody_colour, colour_temperature, luminance
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.formats.opening import Opening
from lumitree.formats.tm33 import read_tm33
from lumitree.formats.type_c import direction_of
from lumitree.lamp.source import source_kind
from lumitree.rendering.asset_flux import asset_lumens, asset_watts
from support.slow import slow
from support.tm33_files import candela, table, tm33


@pytest.fixture
def made(mi, tmp_path, monkeypatch):
    """Function that writes a file."""
    monkeypatch.chdir(tmp_path)

    def write(*args, name="lamp.xml", **others):
        Path(name).write_text(tm33(*args, **others))
        return name

    return write


def exact(direction):
    x, y, _ = np.moveaxis(direction, -1, 0)
    return 300 * np.maximum(-y, 0) * (1 + 0.5 * x)


@pytest.mark.parametrize("name", [slow("lamp.xml"), "lamp.tm33", slow("LAMP.XML")])
def test_a_file_is_a_lamp(made, name):
    """∫ 300 cos γ dω over the half-sphere is 300 π lm."""
    asset = lumitree.load(made(name=name))
    assert asset.luminaire == "A lamp"
    distribution, colour = read_tm33(name)
    assert colour == (1, 1, 1)
    assert asset_lumens(asset) == pytest.approx(distribution.lumens, rel=5e-3)
    assert asset_lumens(asset) == pytest.approx(300 * np.pi, rel=5e-3)
    # Width along C = 0, and length along C = 90.
    assert asset.frame.size == pytest.approx([0.2, 6e-4, 0.6])
    directions = middle_directions(32)
    assert distribution.at(directions) == pytest.approx(exact(directions), abs=6)
    assert main(["info", name]) == 0
    assert main(["bake", name, "-o", "lamp.lumitree"]) == 0


def test_the_root_tells_it_from_scenes(made, tmp_path):
    assert source_kind(made()) == "photometric"
    assert what_it_is("lamp.xml") == TM33
    for text, kind in (
        ('<scene version="3.0.0"></scene>', SCENE),
        ("<!-- <IESTM33> --><scene version='3.0.0'/>", SCENE),
        ("<Root><IESTM33/></Root>", "an XML file"),
        (tm33(root="IESTM33"), TM33),
        (tm33(root="IESTM33-18"), TM33),
    ):
        Path("other.xml").write_text(text)
        assert what_it_is("other.xml") == kind
        assert source_kind("other.xml") == ("photometric" if kind == TM33 else "luminaire")
    Path("other.xml").write_bytes(tm33().replace("utf-8", "utf-16").encode("utf-16"))
    assert lumitree.load("other.xml").luminaire == "A lamp"
    assert source_kind("missing.xml") == "luminaire"


def test_symmetry_and_other_spellings(made):
    """Half of the circle, one plane, and names as other programs write them."""
    half = read_tm33(made(table(c=np.arange(0, 181, 22.5))))[0]
    assert half.intensity == pytest.approx(read_tm33(made())[0].intensity)
    alone = read_tm33(made(table(c=[0.0])))[0]
    assert alone.at(direction_of([10, 200], 45)) == pytest.approx(candela(0, 45))
    other = table(point="IntensityData", keys=("horz", "vert"))
    other = other.replace("<LuminousIntensity>", "").replace("</LuminousIntensity>", "")
    found, first = read_tm33(made(other))[0], read_tm33(made())[0]
    assert found.intensity.tolist() == first.intensity.tolist()


@pytest.mark.parametrize(
    ("rated", "warns"),
    [
        ("<RatedLumens>4000</RatedLumens>", True),
        ("<RatedLumens>942</RatedLumens>", False),
        ("<Quantity>2</Quantity><RatedLumens>471</RatedLumens>", False),
        ("<RatedLumens>471</RatedLumens>", True),
        ("", False),
    ],
)
def test_lamps_of_another_flux_are_warned_of(made, rated, warns):
    """300 cos γ (1 + a part without flux) cd are 300 pi = 942 lm."""
    name = made(before=rated)
    text = Path(name).read_text()
    Path(name).write_text(text.replace("<Quantity>1</Quantity>", "", 1))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        read_tm33(name)
    texts = [str(each.message) for each in found]
    lumens = rated.split("<RatedLumens>")[-1].split("<")[0]
    expected = f"its intensities have 941.879 lm, where its lamps are rated at {lumens} lm"
    assert any(expected in text for text in texts) == warns
    assert len(texts) == int(warns)


def test_factors(made):
    plain = read_tm33(made())[0].lumens
    doubled = read_tm33(made(table(extra="<Multiplier>2</Multiplier>")))[0].lumens
    assert doubled == pytest.approx(2 * plain)
    ballast = "<BallastFactor>0.9</BallastFactor>"
    assert read_tm33(made(before=ballast))[0].lumens == pytest.approx(0.9 * plain)
    absolute = table(extra="<AbsolutePhotometry>true</AbsolutePhotometry>")
    assert read_tm33(made(absolute, before=ballast))[0].lumens == pytest.approx(plain)
    tilt = (
        '<TiltAngles><NumberAngles>2</NumberAngles><Tilt angle="0">0.5</Tilt>'
        '<Tilt angle="90">0.2</Tilt></TiltAngles>'
    )
    with pytest.warns(LumitreeWarning, match="the one for 0 degrees, 0.5, is used"):
        assert read_tm33(made(before=tilt))[0].lumens == pytest.approx(0.5 * plain)
    with pytest.warns(LumitreeWarning, match="941.879 lm, where it states 500 lm"):
        read_tm33(made(table() + "<LuminousFlux>500</LuminousFlux>"))
    assert read_tm33(made(emitters=2))[0].lumens == pytest.approx(2 * plain)
    power = "<InputWattage>5</InputWattage>"
    assert read_tm33(made(emitters=2, before=power))[0].watts == 10
    assert read_tm33(made())[0].watts is None


def area(face, circular="", **sizes):
    values = "".join(f"<{key}>{value}</{key}>" for key, value in sizes.items())
    circular = f"<Circular>{circular}</Circular>" if circular else ""
    return f"<{face}Face><{face}Area>{values}{circular}</{face}Area></{face}Face>"


@pytest.mark.parametrize(
    ("areas", "opening"),
    [
        (area("Top", Length=0.4, Width=0.4, circular="true"),
         Opening((0.4, 0, 0.4), "cylinder")),
        # Two areas beside each other.
        (area("Bottom", Length=0.2, Width=0.1, LengthOffset=-0.3, WidthOffset=0)
         + area("Bottom", Length=0.2, Width=0.1, LengthOffset=0.3, WidthOffset=0),
         Opening((0.1, 0, 0.8))),
        (area("C0", Length=0.2, Height=0.1), Opening((0, 0.1, 0.2))),
        # Below and above: the height of the luminaire.
        (area("Top", Length=0.4, Width=0.2) + area("Bottom", Length=0.4, Width=0.2),
         Opening((0.2, 0.1, 0.4))),
    ],
)  # fmt: skip
def test_openings(made, areas, opening):
    found = read_tm33(made(areas=f"<EmissionAreas>{areas}</EmissionAreas>"))[0].opening
    assert found.sides == pytest.approx(opening.sides)
    assert (found.shape, found.axis) == (opening.shape, opening.axis)


def test_a_spectrum_gives_the_colour(made):
    """The spectrum of a black body, in steps of 5 nm."""
    wavelength = np.arange(360, 835, 5.0)
    power = wavelength**-5 / np.expm1(1.438777e7 / (wavelength * 2700))
    rows = "".join(f'<PwrData w="{w:g}">{p / power.max():.6g}</PwrData>'
                   for w, p in zip(wavelength, power, strict=True))  # fmt: skip
    spectrum = f"<SpectralData><EmitterSpectral>{rows}</EmitterSpectral></SpectralData>"
    asset = lumitree.load(made(after=spectrum))
    watts = asset_watts(asset)
    assert asset_lumens(asset) == pytest.approx(300 * np.pi, rel=5e-3)
    assert colour_temperature(watts)[0] == pytest.approx(2700, rel=5e-3)
    assert watts / luminance(watts) * 683 == pytest.approx(blackbody_colour(2700), abs=0.01)
    # An emitter that is off has no colour.
    off = '<TiltAngles><Tilt angle="0">0</Tilt></TiltAngles>'
    with pytest.warns(LumitreeWarning, match="the one for 0 degrees, 0, is used"):
        distribution, colour = read_tm33(made(before=off, after=spectrum))
    assert distribution.lumens == 0
    assert colour == (1, 1, 1)


@pytest.mark.parametrize("kind", ["CIE_C", "IES _ C", "TypeC", "B"])
def test_types(made, kind):
    top = f"<Equipment><Gonioradiometer><Type>{kind}</Type></Gonioradiometer></Equipment>"
    if kind != "B":
        assert read_tm33(made(top=top))[0].lumens == read_tm33(made())[0].lumens
        return
    # Type B: H = V = 0 is down, H = 90 towards C = 270.
    rows = "".join(f'<IntData h="{h}" v="{v}">{100 + (h > 0)}</IntData>'
                   for h in range(-90, 91, 10) for v in range(-90, 91, 10))  # fmt: skip
    found = read_tm33(made(f"<LuminousIntensity>{rows}</LuminousIntensity>", top=top))[0]
    assert found.at(direction_of([0, 270, 90], [1, 45, 45])) == pytest.approx([100.1, 101, 100],
                                                                              abs=0.2)  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (tm33(data=""), "table of intensities is empty"),
        (tm33().replace("LuminousData", "PhotonData"), "an emitter has PhotonData; expected"),
        (tm33(emitters=0), "it has 0 emitters"),
        (tm33(table(c=[0, 90, 100])), "C angles are 0 to 100"),
        (tm33().replace('h="22.5" v="5"', 'h="23" v="5"'), "expected one for each pair"),
        (tm33(table(scale=-1)), "negative intensity"),
        (tm33(table(scale=0)), "emits nothing"),
        (tm33(top="<Equipment><Gonioradiometer><Type>CUSTOM</Type></Gonioradiometer></Equipment>"),
         "type of photometry is 'CUSTOM'"),
        (tm33().replace("<Version>", "<!-- -->&a;<Version>"), "not well-formed"),
        (tm33().replace("<IESTM33-22>", '<!DOCTYPE a [<!ENTITY a "b">]><IESTM33-22>'), "entities"),
    ],
)  # fmt: skip
def test_refusals(mi, tmp_path, text, message):
    path = tmp_path / "lamp.tm33"
    path.write_text(text)
    with pytest.raises(LumitreeError, match=message) as found:
        lumitree.load(path)
    assert "\n" not in str(found.value)
