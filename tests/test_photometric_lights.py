"""Photometric files and ray files are taken wherever an asset is."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.core.photometry import colour_temperature, luminance
from lumitree.errors import LumitreeError
from lumitree.formats.ies import write_ies
from lumitree.formats.ldt import write_ldt
from lumitree.formats.opening import Opening
from lumitree.formats.tm25 import Rays, write_tm25
from lumitree.formats.type_c import Grid, IntensityDistribution
from lumitree.lamp.dataset import MANIFEST
from lumitree.lamp.source import LuminaireSource, source_kind
from lumitree.rendering.asset_cache import open_asset
from lumitree.rendering.asset_flux import asset_watts
from support.gldf_files import l3d, product, zipped
from support.lamps import room
from support.slow import slow
from support.tm33_files import tm33
from support.walls import irradiance

FILES = ("a.ies", "B.LDT", "c.Ray", "d.TM25RAY")


@pytest.fixture(autouse=True)
def folder(mi, tmp_path, monkeypatch):
    """Files of a lamp that emits 100 cd · cos γ downwards from 0.2 x 0.1 m, and a room."""
    monkeypatch.chdir(tmp_path)
    grid = Grid(15)
    down = 100 * np.maximum(np.cos(np.deg2rad(grid.gamma)), 0) * np.ones((len(grid.c), 1))
    distribution = IntensityDistribution("down", grid.c, grid.gamma, down, Opening((0.2, 0, 0.1)))
    write_ies("a.ies", distribution)
    write_ldt("B.LDT", distribution)
    random = np.random.default_rng(0)
    direction = random.normal(size=(2000, 3))
    direction[:, 1] = -np.abs(direction[:, 1])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    # From the corners of a box: few cells.
    origin = random.choice([-0.1, 0.1], (2000, 3))
    rays = Rays(origin, direction, np.full((2000, 3), 1e-3))
    write_tm25("c.Ray", rays, "rays")
    write_tm25("d.TM25RAY", rays, "rays")
    (tmp_path / "room.xml").write_text(room(16, 12))
    return tmp_path


def test_one_function_says_what_a_source_is(folder):
    asset = open_asset("a.ies")
    (folder / "views").mkdir()
    (folder / "views" / MANIFEST).touch()
    for source, kind in (
        (asset, "asset"),
        ("x/y.lumitree", "asset"),
        ("Y.LUMITREE", "asset"),
        *((name, "photometric") for name in FILES),
        (folder / "a.ies", "photometric"),
        (LuminaireSource("a.IES"), "photometric"),
        ("views", "dataset"),
        ("bulbs", "luminaire"),
        ("ies", "luminaire"),
        ("lamp.xml", "luminaire"),
        ({"type": "scene"}, "luminaire"),
        (None, "luminaire"),
    ):
        assert source_kind(source) == kind


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_the_asset_that_a_bake_makes_of_it(name):
    baked = lumitree.bake(name).asset
    opened = lumitree.load(name)
    assert opened.light_field.intensity.tolist() == baked.light_field.intensity.tolist()
    assert opened.frame == baked.frame
    # The same one while it is in use.
    assert lumitree.load(name) is opened


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a.ies", slow("d.TM25RAY")])
def test_commands_take_files(name, folder, capsys):
    for command, shown in (
        (["info", name], "luminous flux"),
        (["preview", name, "-o", "p.png", "--resolution", "8"], "p.png"),
        (["photometry", name, "--paths", "16384", "--step", "15"], "luminous flux"),
        (["export", name, "-o", "lamp.py"], "lights"),
        (["view", name, "-o", "lamp.html"], "lamp.html"),
    ):
        assert main([*command, "--json", "report.json"]) == 0
        assert shown in capsys.readouterr().out
    report = json.loads((folder / "report.json").read_text())
    assert report["page_bytes"] == (folder / "lamp.html").stat().st_size


def lux_below(distance, placement, unit="m"):
    """Illuminance at a distance below a lamp at the origin, lx."""
    plane = lumitree.Plane((0, -distance, 0), extent=(1e-3, 1e-3), spacing=1e-3)
    room = {
        "type": "scene",
        "floor": {"type": "sphere", "center": [0, -2 * distance, 0], "radius": distance / 9},
    }
    found = lumitree.illuminance(
        room, [placement], planes=[plane], unit=unit, direct=True, progress=None
    )
    return float(found.total[0])


@pytest.mark.parametrize("name", ["a.lumitree", slow("lamp.tm33")])
def test_the_size_of_a_file_is_that_of_its_opening_alone(name, folder):
    """E = I / d² whatever the size: intensities of a file are absolute."""
    lumitree.bake("a.ies", "a.lumitree")
    (folder / "lamp.tm33").write_text(tm33())
    own, small, large = (
        lux_below(5, lumitree.Placement(name, at=(0, 0, 0), size=size)) for size in (None, 0.05, 1)
    )
    assert (small, large) == pytest.approx((own, own), rel=0.02)
    assert own == pytest.approx((300 if name == "lamp.tm33" else 100) / 25, rel=0.01)
    dimmed = lumitree.Placement(name, at=(0, 0, 0), size=1, gain=0.5)
    assert lux_below(5, dimmed) == pytest.approx(large / 2, rel=1e-3)


@pytest.mark.parametrize("size", [None, slow(50)])
def test_a_file_in_a_scene_in_centimetres_gives_the_same_lux(size):
    """100 cd at 5 m; the file states metres, so that its own size is 20 cm."""
    lamp = lumitree.Placement("a.ies", at=(0, 0, 0), size=size)
    assert lux_below(500, lamp, "cm") == pytest.approx(100 / 25, rel=0.01)
    watts = dataclasses.replace(lamp, lumens=300.0, gain=0.5)
    assert lux_below(500, watts, "cm") == pytest.approx(150 / np.pi / 25, rel=0.01)


@pytest.mark.slow
def test_a_shape_of_a_file_keeps_its_intensities_when_it_is_scaled(mi, folder):
    lumitree.register()
    gldf = {
        "product.xml": product(),
        "geo/lamp.l3d": l3d(),
        "ldc/lamp.ldt": Path("B.LDT").read_bytes(),
    }
    (folder / "lamp.gldf").write_bytes(zipped(gldf))
    values = []
    for scale in (1.0, 3.0):
        to_world = mi.ScalarTransform4f().scale(scale)
        lamp = {"lamp": lumitree.shape("lamp.gldf", to_world, gain=0.5)}
        found, _ = irradiance(mi, lamp, [0, -6, 0], [0, 1, 0], samples=1 << 14)
        values.append(luminance(found))
        # The parameter is the gain that was given.
        gains = [v for k, v in mi.traverse(mi.load_dict({"type": "scene", **lamp})) if "gain" in k]
        assert np.ravel(gains[0]).tolist() == pytest.approx([0.5] * 3)
    assert values == pytest.approx([100 / 36 / 2] * 2, rel=0.04)


def test_a_ray_file_has_its_flux_at_any_size(mi):
    lamp = lumitree.shape("c.Ray", mi.ScalarTransform4f().scale(7))
    emitter = mi.load_dict({"type": "scene", "lamp": lamp}).emitters()[0]
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 1 << 16)
    _, flux = emitter.sample_ray(0.0, sampler.next_1d(), sampler.next_2d(), sampler.next_2d())
    assert np.ravel(flux).mean() == pytest.approx(2000 * 1e-3, rel=0.01)


def test_a_placed_file_has_the_flux_and_the_colour_that_are_asked_for():
    from lumitree.rendering.scene import PlacedLuminaire

    placement = lumitree.Placement("a.ies", size=0.4, lumens=800, temperature=2700)
    assert placement.is_baked
    placed = PlacedLuminaire(placement)
    watts = asset_watts(placed.asset) * placed.gain
    assert luminance(watts) == pytest.approx(800)
    assert colour_temperature(watts)[0] == pytest.approx(2700, rel=1e-3)


@pytest.mark.slow
def test_an_asset_is_compared_with_its_file(folder, capsys):
    lumitree.bake("a.ies", "a.lumitree", lumens=10.0)
    command = ["evaluate", "a.lumitree", "a.ies", "-o", "sheet.png", "--json", "report.json"]
    assert main([*command, "--irradiance-paths", "65536"]) == 0
    report = json.loads((folder / "report.json").read_text())
    # Without its gain.
    assert report["metrics"]["irradiance_ratio"] == pytest.approx(1, abs=0.02)
    assert report["irradiance"]["faces"]["-y"]["explicit_lux"] > 0
    assert (folder / "sheet-irradiance.png").exists()
    assert not (folder / "sheet.png").exists()
    assert "held-out" not in capsys.readouterr().out
    for target, options, message in (
        ("c.Ray", {}, "bounding boxes of 0.2 x 0.0002 x 0.1 and .*lumitree photometry"),
        ("a.ies", {"irradiance_paths": 0}, "nothing is compared"),
        (LuminaireSource("a.ies", keep=("x",)), {}, "keep: not for an asset or a photometric file"),
    ):
        with pytest.raises(LumitreeError, match=message):
            lumitree.evaluate("a.lumitree", target, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--parts", "light,field"], "parts are light, field, but a.ies is a photometric"),
        (["--parts", "field"], "only the part light can be made"),
        (["--keep", "a", "--materials", "m.toml"], "materials, keep: not for"),
    ],
)
def test_parts_and_options_that_do_not_apply_are_refused(folder, capsys, options, message):
    before = sorted(folder.iterdir())
    assert main(["bake", "a.ies", "-o", "a.lumitree", *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("options", [["--unit", "cm"], ["--up", "z"]])
def test_the_unit_of_a_file_is_its_own(capsys, options):
    assert main(["photometry", "a.ies", *options]) == 2
    assert "unit and up: not for a photometric file such as a.ies" in capsys.readouterr().err


def test_a_missing_or_broken_file_is_one_line(folder, capsys):
    (folder / "broken.ies").write_text("not an IES file")
    for command in (["info"], ["view", "-o", "a.html"], ["preview", "-o", "a.png"]):
        for name in ("none.ies", "broken.ies"):
            assert main([command[0], name, *command[1:]]) == 2
            error = capsys.readouterr().err
            assert name in error
            assert error.count("\n") == 1


def test_a_bake_does_not_advise_what_a_file_cannot_have(folder, capsys):
    """Also where a list names the file."""
    (folder / "lamps.txt").write_text("a.ies\n")
    assert main(["bake", "@lamps.txt", "-o", "a.lumitree"]) == 0
    assert "Images show the luminous opening, evenly bright.\n" in capsys.readouterr().out
