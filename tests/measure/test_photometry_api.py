"""`lumitree.photometry` and `lumitree photometry`."""

# pyright: reportOptionalMemberAccess=false
import dataclasses
import json
import re
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.cli import main
from lumitree.core.frames import LocalFrame, rotation, similarity
from lumitree.core.photometry import luminance
from lumitree.errors import LumitreeError
from lumitree.formats.ies import read_ies
from lumitree.formats.ldt import read_ldt
from lumitree.formats.tm25 import read_tm25
from lumitree.measure.figures import _cone
from lumitree.rendering.asset_flux import asset_lumens
from lumitree.trace.light_paths import LampRays
from support.ies_text import ies_text
from support.lamps import AREA, scene, sphere
from support.light_fields import random_light_field

PATHS = 1 << 14


@pytest.fixture(autouse=True)
def folder(mi, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(scene(sphere("ball", 0.5, inside=AREA)))
    return tmp_path


def small_asset(path=None):
    frame = LocalFrame(np.array([1.0, 1, 1]), similarity(np.eye(3), 0.2))
    asset = light_field_asset(random_light_field(1), frame, "a <b> & $c$")
    if path is not None:
        lumitree.save(asset, path)
    return asset


def test_all_files_of_a_luminaire(folder):
    names = ["lamp.ies", "lamp.ldt", "lamp.ray", "lamp.TM25RAY", "lamp.html", "lamp.pdf"]
    result = lumitree.photometry("lamp.xml", names, step=10, paths=PATHS, file_rays=1000)
    assert [path.name for path in result.files] == names
    assert sorted(path.name for path in folder.iterdir()) == sorted(["lamp.xml", *names])
    assert result.intensity.shape == (36, 19)
    assert result.c_angles[-1] == 350
    assert result.gamma_angles[-1] == 180
    for distribution in (read_ies("lamp.ies"), read_ldt("lamp.ldt")):
        assert distribution.lumens == pytest.approx(result.lumens.value, rel=1e-5)
        assert distribution.intensity == pytest.approx(result.intensity, rel=1e-5)
        assert distribution.emitted_lumens == pytest.approx(result.emitted_lumens.value)
        assert distribution.opening.sides[::2] == pytest.approx((1, 1), rel=0.02)
    rays, _ = read_tm25("lamp.ray")
    assert 1000 <= len(rays) < PATHS
    assert luminance(rays.flux.sum(axis=0)) == pytest.approx(result.lumens.value, rel=0.02)
    assert (folder / "lamp.pdf").read_bytes().startswith(b"%PDF-")
    assert result.png.startswith(b"\x89PNG")
    text = json.dumps(result.to_json(), allow_nan=False)
    assert json.loads(text)["lumens"]["value"] == result.lumens.value
    assert "intensity" not in json.loads(text)
    assert str(result).startswith("PhotometryResult\n")


def test_a_report_loads_nothing_and_shows_names_as_they_are(folder):
    small_asset("odd.lumitree")
    lumitree.photometry("odd.lumitree", ["a.html", "a.pdf"], step=30, paths=PATHS)
    text = (folder / "a.html").read_text()
    assert "a &lt;b&gt; &amp; $c$" in text
    assert "<b>" not in text
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert sources
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert not re.search(r"<script|url\(|@import", text)


def test_an_asset_and_its_file():
    asset = small_asset("a.lumitree")
    first = lumitree.photometry(asset, step=30, paths=PATHS)
    second = lumitree.photometry("a.lumitree", step=30, paths=PATHS)
    assert first.intensity.tolist() == second.intensity.tolist()
    assert first.lumens.value == pytest.approx(asset_lumens(asset), rel=0.05)
    assert first.emitted_lumens is first.light_output_ratio is None
    assert first.files == []
    assert first.size == pytest.approx((0.4, 0.4, 0.4))


@pytest.mark.parametrize(
    ("output", "options", "message"),
    [
        ("a.txt", {}, "does not end in"),
        (["a.ies", "a"], {}, "does not end in"),
        ("nowhere\0.ies", {}, "ies"),
        ((), {"step": 7.0}, "angular step"),
        ((), {"paths": 3}, "light paths is 3"),
        ((), {"file_rays": 0}, "rays of a ray file"),
        ((), {"seed": -1}, "seed"),
        ((), {"up": "x"}, "up is"),
        ((), {"unit": "yd"}, "unit is 'yd'"),
        ((), {"unit": 0.0}, "unit is 0.0"),
        ((), {"unit": float("nan")}, "unit is nan"),
    ],
)
def test_bad_arguments_are_refused_before_work(folder, output, options, message):
    with pytest.raises(LumitreeError, match=message):
        lumitree.photometry("lamp.xml", output, **options)
    assert [path.name for path in folder.iterdir()] == ["lamp.xml"]


def test_the_command(folder, capsys):
    command = ["photometry", "lamp.xml", "-o", "a.ies", "-o", "a.html", "--paths", str(PATHS)]
    assert main([*command, "--step", "15", "--seed", "3", "--json", "a.json"]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"luminous flux  14,428 lm", shown)
    assert re.search(r"largest intensity  [\d,.]+ ± [\d.]+ cd at C = \d+°, gamma = \d+°", shown)
    assert re.search(r"light output ratio  100 %", shown)
    assert "written: a.ies" in shown
    assert "horizontal, C90" in shown
    report = json.loads((folder / "a.json").read_text())
    assert report["step"] == 15
    assert report["files"] == ["a.ies", "a.html"]
    assert len(report["near_field"]) == 11


def test_units_and_upward_axes(mi):
    """A lamp that emits along -z of its file, in centimetres, is one that emits down, in metres."""
    down = light_field_asset(
        random_light_field(1), LocalFrame(np.ones(3), similarity(np.eye(3))), "down"
    )
    turned = similarity(rotation([1, 0, 0], 90), 100.0, [1, 2, 3])
    other = dataclasses.replace(down, frame=LocalFrame(np.array([1.0, 1, 1]), turned))
    first = lumitree.photometry(down, "a.ray", step=15, paths=PATHS)
    second = lumitree.photometry(other, "b.ray", step=15, paths=PATHS, unit="cm", up="z")
    assert second.intensity == pytest.approx(first.intensity, rel=1e-4, abs=1e-3)
    assert second.size == pytest.approx(first.size)
    rays, turned_rays = read_tm25("a.ray")[0], read_tm25("b.ray")[0]
    assert turned_rays.direction == pytest.approx(rays.direction, abs=1e-4)
    # Ray files have the origin of the lamp's file.
    offset = turned_rays.origin - rays.origin
    assert offset == pytest.approx(np.tile([0.01, 0.03, -0.02], (len(rays), 1)), abs=1e-4)


@pytest.mark.slow
def test_a_file_that_states_no_colour_has_none(folder):
    lamp = lumitree.photometry("lamp.xml", ["a.ies"], step=30, paths=PATHS)
    file = lumitree.photometry("a.ies", ["b.html"], step=30, paths=PATHS)
    assert lamp.colour_temperature is not None
    assert (file.colour_temperature, file.duv) == (None, None)
    assert len(file.near_field) == len(lamp.near_field)
    assert "not known" in (folder / "b.html").read_text(encoding="utf-8")
    # Without rays the intensities are the same, and there is no far field.
    known = lumitree.photometry("a.ies", ["c.html", "c.pdf", "c.ldt"], step=30)
    assert (known.rays, known.near_field) == (0, [])
    np.testing.assert_array_equal(known.intensity, file.intensity)
    assert known.opening == file.opening
    assert "Far field" not in (folder / "c.html").read_text(encoding="utf-8")
    # Nor has the asset of it.
    asset = lumitree.bake("a.ies").asset
    assert lumitree.photometry(asset, step=30, paths=PATHS).colour_temperature is None


@pytest.mark.slow
def test_an_ies_file_there_and_back(folder, capsys):
    """Luminaire, IES file, asset, and its photometry."""
    flux = lumitree.photometry("lamp.xml", "a.ies", step=10, paths=PATHS).lumens
    command = ["bake", "a.ies", "-o", "a.lumitree", "--lumens", "800", "--temperature", "3000"]
    assert main(command) == 0
    again = lumitree.photometry("a.lumitree", step=10, paths=PATHS)
    assert again.lumens.value == pytest.approx(800, rel=0.01)
    assert again.colour_temperature.value == pytest.approx(3000, abs=10)
    assert main(["bake", "a.ies", "-o", "a.lumitree"]) == 0
    assert asset_lumens(lumitree.load("a.lumitree")) == pytest.approx(flux.value, rel=1e-3)
    capsys.readouterr()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["photometry", "lamp.xml", "-o", "a.png"], "does not end in"),
        (["photometry", "none.lumitree"], "does not exist"),
        (["photometry", "none"], "no luminaire"),
        (["bake", "none.ies", "-o", "a.lumitree"], "does not exist"),
        (["bake", "lamp.ies", "-o", "a.lumitree", "--keep", "x"], "keep: not for a photometric"),
        (["bake", "lamp.ies", "-o", "a.lumitree", "--method", "network"], "ies"),
        (["bake", "lamp.xml", "-o", "a.lumitree", "--lumens", "0"], "lumens is 0"),
    ],
)
def test_errors_of_the_command_are_one_line(folder, capsys, arguments, message):
    (folder / "lamp.ies").write_text("not an IES file")
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert re.search(message, error)
    assert error.count("\n") == 1
    assert not (folder / "a.lumitree").exists()


@pytest.mark.parametrize("installed", [True, False])
def test_reports_have_glare_ratings_or_say_what_is_missing(folder, monkeypatch, capsys, installed):
    if installed:
        pytest.importorskip("eulumdat_ugr")
    else:
        monkeypatch.setitem(sys.modules, "eulumdat_ugr", None)
    command = ["photometry", "lamp.xml", "-o", "a.html", "-o", "a.pdf", "--step", "10"]
    assert main([*command, "--paths", str(PATHS), "--json", "a.json"]) == 0
    printed, report = capsys.readouterr().out, (folder / "a.html").read_text()
    assert ("crosswise" in printed) == ("12H x 8H" in report) == installed
    assert ("lumitree[ugr]" in printed) == (not installed)
    # A report is read by others, who install nothing.
    assert "pip install" not in report
    assert (folder / "a.pdf").read_bytes().count(b"/Type /Page ") == 2


def test_power_efficacy_luminance_and_cone_of_a_file(folder):
    """A square panel of 0.5 m and 1000 lm, whose luminance is the same from everywhere below."""
    gamma = np.append(np.arange(0, 90.5, 2.5), [90.001, 180])
    candela = 1000 / np.pi * np.maximum(np.cos(np.deg2rad(gamma)), 0)
    text = ies_text([candela], gamma=gamma, c=[0], opening=(0.5, 0.5, 0))
    (folder / "panel.ies").write_text(text.replace("\n1 1 10\n", "\n1 1 12.5\n"))
    found = lumitree.photometry("panel.ies", ["panel.html", "panel.pdf", "panel.ldt"], paths=PATHS)
    assert found.watts == read_ldt("panel.ldt").watts == 12.5
    assert found.efficacy.value == pytest.approx(80, rel=1e-3)
    assert list(found.luminance) == ["C0", "C90", "C180", "C270"]
    for values in found.luminance.values():
        assert [each.value for each in values] == pytest.approx(3 * [1000 / np.pi / 0.25], rel=5e-3)
    assert "<td>12.5 W</td>" in (folder / "panel.html").read_text()
    axes = Figure().subplots()
    _cone(axes, found.step, found.intensity)
    # Half of the intensity at 60 degrees, and 318.3 cd / 4 m² at 2 m.
    shown = [each.get_text() for each in axes.texts]
    assert shown[1] == "79.6 lx\n6.93 m x 6.93 m"
    assert axes.get_title() == "cone straight down"


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nothing_is_written_of_a_flux_that_is_no_number(folder, monkeypatch, value):
    monkeypatch.setattr(LampRays, "bare_flux", lambda *_: np.full(3, value))
    with pytest.raises(LumitreeError, match=r"the bare emitters of .*lamp is NaN or inf"):
        lumitree.photometry("lamp.xml", ["lamp.ies", "lamp.ldt"], step=15, paths=PATHS)
    assert [each.name for each in folder.iterdir()] == ["lamp.xml"]
