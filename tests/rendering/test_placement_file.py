"""TOML files of placements, and the luminous flux and colour of a placed lamp."""

# pyright: reportArgumentType=false
import dataclasses
import os

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.cli import main
from lumitree.core.photometry import colour_temperature, luminance
from lumitree.errors import LumitreeError
from support.damage import damaged, refused
from support.fields import random_asset
from support.light_fields import random_light_field
from support.placement_text import PLACEMENTS
from support.slow import slow

FIELD = random_asset(1)
LIGHT_FIELD = light_field_asset(random_light_field(2), FIELD.frame, "test")


def test_all_keys_are_read_and_paths_are_relative_to_the_file(tmp_path, mi):
    folder = tmp_path / "sub"
    folder.mkdir()
    (folder / "lights.toml").write_text(PLACEMENTS)
    first, second = lumitree.read_placements(folder / "lights.toml")
    assert first == lumitree.Placement(
        str(folder / "a.lumitree"), (0, 2.5, -1), 0.4, (0, 1, 0, 45), (1, 0.5, 0.25), 800, 2700,
        "kitchen",
    )  # fmt: skip
    assert second == lumitree.Placement("bulbs", gain=1.0, label="desk lamp")


def test_damaged_files_are_refused_or_read(tmp_path, mi):
    path = tmp_path / "lights.toml"
    rng, outcomes = np.random.default_rng(0), set()

    def check():
        for lamp in lumitree.read_placements(path):
            assert lamp.size is None or 0 < lamp.size < np.inf
            assert lamp.label is not None

    for _ in range(300):
        path.write_bytes(damaged(PLACEMENTS.encode(), rng))
        outcomes.add(refused(check))
    assert outcomes == {True, False}


def test_an_array_is_a_lamp_at_each_of_its_places(tmp_path):
    text = "[lamps.hall]\nasset = 'a.lumitree'\nat = [1, 2, 3]\ngrid = [3, 2]\npitch = [2, 1]"
    (tmp_path / "lights.toml").write_text(text)
    (array,) = lumitree.read_placements(tmp_path / "lights.toml")
    lamps = array.each()
    assert [lamp.at for lamp in lamps] == [
        *[(-1, 2, 2.5), (1, 2, 2.5), (3, 2, 2.5)],
        *[(-1, 2, 3.5), (1, 2, 3.5), (3, 2, 3.5)],
    ]
    assert {(lamp.label, lamp.grid, lamp.pitch) for lamp in lamps} == {("hall", None, None)}
    assert lamps[0].each() == [lamps[0]]
    upright = dataclasses.replace(array, grid=(1, 2, 1), pitch=(9.0, 3.0, 9.0))
    assert [lamp.at for lamp in upright.each()] == [(1, 0.5, 3), (1, 3.5, 3)]


@pytest.mark.parametrize(
    ("grid", "pitch", "message"),
    [
        ((3, 2), None, "pitch is None; expected 2 distances"),
        (None, (1, 2), "grid is None; expected 2 or 3 whole numbers"),
        ((3, 0), (1, 2), r"grid is \(3, 0\)"),
        ((1000, 1000), (1, 2), "of 10,000 lamps at most"),
        ((3, 2, 1), (1, 2), "expected 3 distances"),
        ((3, 2), (1, np.nan), "expected 2 distances"),
    ],
)
def test_unusable_arrays_are_refused(grid, pitch, message):
    with pytest.raises(LumitreeError, match=message):
        lumitree.Placement("a.lumitree", (0, 0, 0), grid=grid, pitch=pitch)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no lamps"),
        ("lamps = 3", "lamps is '3'; expected tables"),
        ("[lamps]\nhall = 3", "lamps.hall is '3'; expected a table"),
        ("[lamp.hall]", "unknown key 'lamp'"),
        ("[lamps.hall]", "lamps.hall has no asset"),
        ("[lamps.hall]\nasset = 3", "lamps.hall.asset is '3'; expected a text"),
        ("[lamps.hall]\nasset = 'a.lumitree'\nsice = 1", "'lamps.hall.sice'; did you mean 'size'"),
        ("[lamps.hall]\nasset = 'a.lumitree'\nat = [0, 1]", "hall.at is '[0, 1]'; expected 3 num"),
        ("[lamps.hall]\nasset = 'a.lumitree'\nat = [0, 1, nan]", "expected 3 numbers"),
        ("[lamps.hall]\nasset = 'a.lumitree'\nat = [0, 1, true]", "expected 3 numbers"),
        ("[lamps.hall]\nasset = 'a.lumitree'\nat = [1e300, 1, 0]", "lamps.hall: at"),
        ("[lamps.hall]\nasset = 'a.lumitree'\nsize = 'big'", "hall.size is 'big'"),
        ("[lamps.hall]\nasset = 'a.lumitree'\nsize = 0", "lamps.hall: size"),
        ("[lamps.hall]\nasset = 'a.lumitree'\nrotate = [0, 0, 0, 9]", "lamps.hall: "),
        ("[lamps.hall]\nasset = 'a.lumitree'\ngain = [1, 2]", "a number or 3 numbers"),
        ("[lamps.hall]\nasset = 'a.lumitree'\ngain = -1", "lamps.hall: gain is -1"),
        ("[lamps.hall]\nasset = 'a.lumitree'\nlumens = inf", "hall.lumens is 'inf'"),
        ("[lamps.hall]\nasset = 'a.lumitree'\ntemperature = 300", "lamps.hall: temperature is 300"),
        ("[lamps.hall]\nasset = 'bulbs'\nlumens = 800", "lamps.hall: bulbs has lumens of 800"),
        ("[lamps.hall]\n[lamps.hall]", "not valid TOML"),
        ("\xff", "not valid TOML"),
    ],
)  # fmt: skip
def test_a_wrong_file_gives_one_line_with_file_and_lamp(tmp_path, text, message):
    path = tmp_path / "lights.toml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(LumitreeError) as caught:
        lumitree.read_placements(path)
    assert message in str(caught.value)
    assert "lights.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_explicit_geometry_are_refused(tmp_path):
    with pytest.raises(LumitreeError, match="does not exist; expected a TOML file of placements"):
        lumitree.read_placements(tmp_path / "no.toml")
    for lumens, temperature in ((800, None), (None, 2700)):
        with pytest.raises(LumitreeError, match="explicit geometry"):
            lumitree.Placement("bulbs", lumens=lumens, temperature=temperature)
    for lumens, temperature in ((-1, None), (np.nan, None), (None, 99)):
        with pytest.raises(LumitreeError, match="expected"):
            lumitree.Placement("a.lumitree", lumens=lumens, temperature=temperature)


def placed_flux(mi, placement):
    """R, G and B of the flux of a lamp in the scene, from rays that it emits; and its errors."""
    from lumitree.rendering.emitter import APPEARANCES
    from lumitree.rendering.scene import PlacedLuminaire

    shape = PlacedLuminaire(placement).shapes("emission", APPEARANCES[0])
    emitter = mi.load_dict({"type": "scene", **shape}).emitters()[0]
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(7, 1 << 20)
    args = sampler.next_1d(), sampler.next_2d(), sampler.next_2d()
    _, weight = emitter.sample_ray(0.0, *args)
    flux = np.array(weight, np.float64).reshape(3, -1)
    return flux.mean(axis=1), flux.std(axis=1) / np.sqrt(flux.shape[1])


@pytest.mark.parametrize(
    ("asset", "size"),
    [
        (LIGHT_FIELD, None),
        (LIGHT_FIELD, 0.3),
        slow(FIELD, 0.3),
        slow(FIELD, None),
    ],
)
def test_a_placed_lamp_has_the_lumens_and_the_colour(mi, asset, size):
    lumitree.register()
    options = {"size": size, "lumens": 800, "temperature": 2700}
    watts, errors = placed_flux(mi, lumitree.Placement(asset, **options))
    lumens = float(luminance(watts))
    # The flux of a field is an estimate too, by about as many rays.
    tolerance = 5 * np.sqrt(2) * float(luminance(errors))
    assert abs(lumens - 800) < tolerance
    assert tolerance < 20
    kelvin, duv = colour_temperature(watts)
    assert kelvin == pytest.approx(2700, rel=0.02)
    assert abs(duv) < 1e-3
    half = placed_flux(mi, lumitree.Placement(asset, **options, gain=(0.5, 0.5, 0)))[0]
    np.testing.assert_allclose(half, watts * [0.5, 0.5, 0], rtol=1e-3)


def test_temperature_alone_keeps_the_lumens_and_lumens_alone_the_colour(mi):
    from lumitree.rendering.asset_flux import asset_watts, factors_to

    watts = asset_watts(LIGHT_FIELD)
    warm = watts * factors_to(watts, None, 2000, "lamp")
    assert luminance(warm) == pytest.approx(luminance(watts))
    bright = watts * factors_to(watts, 10.0, None, "lamp")
    np.testing.assert_allclose(bright / bright.sum(), watts / watts.sum())
    assert luminance(bright) == pytest.approx(10)
    with pytest.raises(LumitreeError, match="lamp emits no blue light, which 6500 K has"):
        factors_to(np.array([1.0, 1.0, 0.0]), None, 6500, "lamp")
    with pytest.raises(LumitreeError, match="emits no light"):
        factors_to(np.zeros(3), 10.0, None, "lamp")
    # A black body of 1000 K has no blue in linear sRGB.
    assert factors_to(np.array([1.0, 1.0, 0.0]), None, 1000, "lamp")[2] == 0


ROOM = (
    '<scene version="3.0.0"><integrator type="path"/><sensor type="perspective">'
    '<transform name="to_world"><lookat origin="0,1,6" target="0,0.5,0" up="0,1,0"/></transform>'
    '<film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/>'
    "</film></sensor></scene>"
)


@pytest.mark.slow
def test_render_takes_the_file_and_options(tmp_path, mi, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.xml").write_text(ROOM)
    lumitree.save(dataclasses.replace(FIELD, luminaire="x"), "lamp.lumitree")
    (tmp_path / "lights.toml").write_text(
        "[lamps.left]\nasset = 'lamp.lumitree'\nat = [-1.5, 0, 0]\nlumens = 500\n"
    )
    options = ("--spp", "4", "--placements", "lights.toml")
    assert main(["render", "room.xml", "-o", "one.exr", *options]) == 0
    left = ("--place", "lamp.lumitree", "--at", "-1.5,0,0", "--lumens", "1000")
    assert main(["render", "room.xml", "-o", "two.exr", "--spp", "4", *left]) == 0
    right = ("--place", "lamp.lumitree", "--at", "1.5,0,0")
    assert main(["render", "room.xml", "-o", "both.exr", *options, *right]) == 0
    one, two, both = (np.array(mi.Bitmap(f"{name}.exr")) for name in ("one", "two", "both"))
    np.testing.assert_allclose(two, 2 * one, rtol=1e-3, atol=1e-6)
    assert both[:, :12].mean() == pytest.approx(one[:, :12].mean(), rel=1e-3)
    assert both[:, 12:].mean() > 0 == one[:, 12:].mean()
    capsys.readouterr()
    assert main(["render", "room.xml", "-o", "a.png", "--lumens", "3"]) == 2
    assert "--lumens comes before any --place" in capsys.readouterr().err


def test_placements_are_read_as_they_were_written(tmp_path):
    folder = tmp_path / "sub"
    folder.mkdir()
    (folder / "lights.toml").write_text(PLACEMENTS)
    array = lumitree.Placement(
        str(tmp_path / "a.lumitree"), (1, 2, 3), grid=(2, 1), pitch=(1, 0), label='the "row"\t\x7f'
    )
    placements = [*lumitree.read_placements(folder / "lights.toml"), array]
    lumitree.write_placements(tmp_path / "written.toml", placements)
    found = lumitree.read_placements(tmp_path / "written.toml")
    for each, expected in zip(found, placements, strict=True):
        assert dataclasses.replace(each, source=expected.source) == expected
    assert found[1].source == "bulbs"
    assert os.path.samefile(os.path.dirname(found[0].source), folder)
    for wrong in (lumitree.Placement(LIGHT_FIELD, label="a"), lumitree.Placement("a.lumitree")):
        with pytest.raises(LumitreeError, match="has no label, or is no file"):
            lumitree.write_placements(tmp_path / "written.toml", [wrong])


def test_a_dimmed_lamp_has_a_part_of_its_gain():
    lamp = lumitree.Placement("a.lumitree", gain=(1, 0.5, 0.25))
    assert lamp.dimmed(0.5).gain == (0.5, 0.25, 0.125)
    assert lumitree.Placement("a.lumitree").dimmed(0.5).gain == 0.5
