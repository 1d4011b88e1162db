"""`bake(parts=...)` and `--parts`: which parts an asset gets, and which later calls keep."""

import dataclasses
import json
import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.asset.file import save
from lumitree.cli import main
from lumitree.core.photometry import colour_temperature, luminance
from lumitree.errors import LumitreeError
from lumitree.fit.light_field import bake as light_field_bake
from lumitree.lamp.luminaire import load_luminaire
from support import tiny_bakes
from support.fields import random_asset
from support.lamps import AREA, cube, scene, sphere
from support.light_fields import assert_equal_fields, random_light_field
from support.slow import slow
from support.tiny_bakes import standard

# A radiance field of a second; most of the time is its first estimate.
FEW = {"estimate": {"rays": 1 << 17, "growth_rays": 1 << 16}, "rays": 1 << 14}


@pytest.fixture(autouse=True)
def folder(mi, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tiny_bakes.set_qualities(monkeypatch.setattr, tree_depth=4, **FEW)
    lamp = scene(sphere("ball", 0.5, inside=AREA), cube("bar", (1, 0.1, 0.1)))
    (tmp_path / "lamp.xml").write_text(lamp)
    return tmp_path


@pytest.fixture
def untraced(monkeypatch):
    """Fails a test that bakes a light field."""

    def refuse(*_, **__):
        raise AssertionError("light paths of a light field are traced")

    monkeypatch.setattr(light_field_bake, "bake_light_field", refuse)


@pytest.mark.slow
def test_the_light_field_alone(tmp_path):
    baked = lumitree.bake("lamp.xml", "lamp.lumitree", standard(parts=["light"]))
    asset = baked.asset
    assert (asset.info.leaves, asset.info.nodes) == (0, 1)
    assert asset.light_field is not None
    assert asset.info.light_field_cells == len(asset.light_field.cells) > 10
    config = tiny_bakes.LIGHT_FIELD
    assert (asset.light_field.depth, asset.light_field.resolution) == (
        config.depth,
        config.resolution,
    )
    assert asset.luminaire == load_luminaire("lamp.xml").name
    assert asset.frame.size == pytest.approx([2, 1, 1])
    assert set(baked.seconds) == {"light", "irradiance"}
    assert baked.held_out_psnr is baked.rays is baked.stopped_by is None
    json.dumps(baked.to_json(), allow_nan=False)
    # Neither the folder nor the state is left.
    assert sorted(os.listdir()) == ["lamp.lumitree", "lamp.xml"]
    again = lumitree.load("lamp.lumitree")
    assert_equal_fields(again.light_field, asset.light_field)
    lumitree.save(again, "again.lumitree")
    assert (tmp_path / "again.lumitree").read_bytes() == Path("lamp.lumitree").read_bytes()
    # It hides nothing and shows nothing to rays.
    radiance, transmittance = again.eval([[0, 0, 5]], [[0, 0, -1]])
    assert (radiance.tolist(), transmittance.tolist()) == ([[0, 0, 0]], [1])
    metrics = lumitree.evaluate(
        again, "lamp.xml", views=4, resolution=24, spp=16, irradiance_paths=1 << 16
    ).metrics
    assert all(np.isfinite(value) for value in metrics.values() if value is not None)
    assert metrics["irradiance_ratio"] == pytest.approx(1, abs=0.05)
    assert metrics["flux_error"] < 0.05


def test_equal_calls_give_equal_files(tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        lumitree.bake("lamp.xml", f"{name}.lumitree", standard(parts=["light"], seed=seed))
    files = [(tmp_path / f"{name}.lumitree").read_bytes() for name in "abc"]
    assert files[0] == files[1] != files[2]


@pytest.mark.slow
def test_the_field_alone(untraced):
    baked = lumitree.bake("lamp.xml", "lamp.lumitree", standard(parts=["field"]))
    assert baked.asset.info.leaves > 10
    assert set(baked.seconds) == {"bake", "irradiance"}
    # It is made of the field's rays.
    light_field = lumitree.load("lamp.lumitree").light_field
    assert light_field is not None
    assert len(light_field.cells) > 0
    assert light_field.traced is None


@pytest.mark.slow
def test_both_parts_and_their_refinement():
    """Each part equals the result of a bake of that part alone; `refine` keeps the light field."""
    both = lumitree.bake("lamp.xml", "both.lumitree", work="state")
    assert set(both.seconds) == {"light", "bake", "irradiance"}
    assert "light.npz" in os.listdir("state")
    alone = lumitree.bake("lamp.xml", config=standard(parts=("light",))).asset
    assert_equal_fields(both.asset.light_field, alone.light_field)
    field = lumitree.bake("lamp.xml", config=standard(parts={"field"})).asset
    for name in ("children", "density", "coefficients"):
        assert np.array_equal(getattr(both.asset, name), getattr(field, name))
    refined = lumitree.refine("both.lumitree", "lamp.xml", "refined.lumitree", rays=1 << 14)
    assert_equal_fields(refined.asset.light_field, alone.light_field)
    assert_equal_fields(lumitree.load("refined.lumitree").light_field, alone.light_field)
    assert refined.asset.info.leaves >= field.info.leaves
    plain = lumitree.refine(field, "lamp.xml", rays=1 << 14)
    assert plain.asset.light_field is not None
    assert plain.asset.light_field.traced is None
    assert plain.asset.light_field is not field.light_field


def test_the_same_work_folder_gives_the_field_without_tracing(monkeypatch):
    first = lumitree.bake("lamp.xml", config=standard(parts=["light"]), work="state").asset

    def refuse(*_, **__):
        raise AssertionError("light paths are traced")

    monkeypatch.setattr(light_field_bake, "LampRays", refuse)
    again = lumitree.bake("lamp.xml", config=standard(parts=["light"]), work="state").asset
    assert_equal_fields(again.light_field, first.light_field)
    with pytest.raises(AssertionError, match="light paths are traced"):
        lumitree.bake("lamp.xml", config=standard(parts=["light"], seed=1), work="state")


@pytest.mark.slow
@pytest.mark.parametrize("parts", [("light", "field", "geometry"), slow(("field",))])
def test_a_bake_gets_the_flux_and_the_colour_that_are_asked_for(parts, capsys):
    """The request changes no part of the asset, only its gain, which later calls keep."""
    from lumitree.rendering.asset_flux import asset_watts

    plain = lumitree.bake("lamp.xml", config=standard(parts=parts))
    light = {"lumens": 800.0, "temperature": 2700.0}
    warm = lumitree.bake("lamp.xml", "warm.lumitree", standard(parts=parts, **light))
    assert np.array_equal(warm.asset.coefficients, plain.asset.coefficients)
    assert warm.asset.parts == plain.asset.parts
    watts = asset_watts(warm.asset)
    exact = 1e-6 if "light" in parts else 0.01
    assert luminance(watts) == pytest.approx(800, rel=exact)
    assert colour_temperature(watts)[0] == pytest.approx(2700, rel=0.001 + exact)
    # The comparison with the luminaire does not depend on the gain.
    assert warm.irradiance is not None
    assert plain.irradiance is not None
    found, expected = (each["irradiance_ratio"] for each in (warm.irradiance, plain.irradiance))
    assert found == pytest.approx(expected, abs=1e-4 + 0.5 * plain.irradiance["ratio_error"])
    refined = lumitree.refine("warm.lumitree", "lamp.xml", rays=1 << 14, irradiance_paths=0)
    assert refined.asset.light_factors == warm.asset.light_factors
    assert main(["info", "warm.lumitree", "--json", "info.json"]) == 0
    shown = re.search(r"luminous flux  ([\d.,]+) lm", capsys.readouterr().out)
    assert shown is not None
    assert float(shown[1].replace(",", "")) == pytest.approx(luminance(watts), rel=1e-4)
    with open("info.json") as file:
        assert json.load(file)["asset"]["light_factors"] == list(warm.asset.light_factors)


def test_a_colour_that_a_lamp_cannot_have_is_refused_at_once(monkeypatch):
    from lumitree.fit.octree import bake as octree_fit

    red = AREA.replace("3,2,1", "3,0,0")
    with open("red.xml", "w") as file:
        file.write(scene(sphere("ball", 0.5, inside=red)))

    def refuse(*_, **__):
        raise AssertionError("a field is baked")

    monkeypatch.setattr(octree_fit, "bake", refuse)
    with pytest.raises(lumitree.LumitreeError, match="emits no green light, which 2700 K has"):
        lumitree.bake("red.xml", "red.lumitree", standard(temperature=2700.0))
    with pytest.raises(lumitree.LumitreeError, match="lumens is 0"):
        lumitree.bake("lamp.xml", config=standard(lumens=0))
    assert not os.path.exists("red.lumitree")


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((), r"^parts are none; expected"),
        (["nonsense"], "part is 'nonsense'; expected light, field"),
        (["light", "nonsense"], "part is 'nonsense'; expected light, field"),
        ("light", "parts are 'light'; expected a list of texts"),
        ([""], "part is ''; expected light, field"),
        ([None], "part is None; expected light, field"),
    ],
)
def test_unknown_and_empty_parts_are_refused_before_any_work(untraced, parts, message):
    with pytest.raises(lumitree.LumitreeError, match=message) as caught:
        lumitree.bake("lamp.xml", "lamp.lumitree", standard(parts=parts))
    assert str(caught.value).isprintable()
    assert os.listdir() == ["lamp.xml"]


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ("light,nonsense", "part is 'nonsense'; expected light, field"),
        ("nonsense", "part is 'nonsense'"),
        ("", "--parts needs a value; found ''"),
        ("light,", "part is ''"),
        ("light, field", "part is ' field'"),
        ("\x1b[2J\n", r"part is '\x1b[2J\n'"),
    ],
)
def test_a_command_refuses_unknown_parts(capsys, untraced, parts, message):
    assert main(["bake", "lamp.xml", "-o", "lamp.lumitree", "--parts", parts]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("lumitree: error: ")
    assert captured.err.count("\n") == 1
    assert captured.err.strip().isprintable()
    assert message in captured.err
    assert os.listdir() == ["lamp.xml"]


def test_a_command_bakes_one_part(capsys):
    command = ["bake", "lamp.xml", "-o", "lamp.lumitree", "--parts", "light"]
    assert main([*command, "--json", "report.json"]) == 0
    assert capsys.readouterr().err == ""
    asset = lumitree.load("lamp.lumitree")
    assert asset.light_field is not None
    assert asset.num_leaves == 0
    assert main(["info", "lamp.lumitree", "--json", "info.json"]) == 0
    with open("info.json") as file:
        assert f'"light_field_cells": {asset.info.light_field_cells}' in file.read()


@pytest.mark.slow
def test_datasets_have_a_field_only(untraced, capsys):
    lumitree.capture("lamp.xml", "views", views=6, resolution=24, spp=4)
    baked = lumitree.bake("views", "lamp.lumitree", parts=["field"])
    assert baked.asset.light_field is not None
    assert baked.asset.light_field.traced is None
    assert baked.irradiance is None
    assert baked.asset.info.leaves > 0
    for parts in ("light", "light,field"):
        assert main(["bake", "views", "-o", "lamp.lumitree", "--parts", parts]) == 2
        assert "is a dataset, from which only the part field" in capsys.readouterr().err


@pytest.mark.parametrize("parts", [("light",), slow(("field",)), slow(("light", "field"))])
def test_a_bake_states_the_error_of_its_irradiance(parts):
    """By the same function as `evaluate`, with the same light paths and random numbers.

    The tables from which rays of a field are sampled are sums in any order, and differ by rounding.
    """
    from lumitree.measure.irradiance import evaluate_irradiance

    baked = lumitree.bake("lamp.xml", config=standard(parts=parts))
    lamp = load_luminaire("lamp.xml")
    expected = evaluate_irradiance(baked.asset, lamp, 1 << 14)
    assert baked.irradiance is not None
    assert baked.irradiance["paths"] == 1 << 14
    assert baked.irradiance["faces"].keys() == expected.report()["faces"].keys()
    ratio = baked.irradiance["irradiance_ratio"]
    # Where rounding moves a few rays, the ratio moves by a small part of its standard error.
    slack = 1e-4 + 0.5 * baked.irradiance["ratio_error"]
    assert ratio == pytest.approx(expected.metrics["irradiance_ratio"], abs=slack)
    if "light" in parts:
        assert ratio == pytest.approx(1, abs=5 * baked.irradiance["ratio_error"] + 0.005)


@pytest.mark.slow
def test_the_irradiance_is_compared_on_request(capsys):
    command = ["bake", "lamp.xml", "-o", "lamp.lumitree", "--parts", "light", "--json", "r.json"]
    for paths, lines in ((None, 3), (4096, 3), (0, 0)):
        chosen = [] if paths is None else ["--config", "bake.toml"]
        with open("bake.toml", "w") as file:
            file.write(f"irradiance_paths = {paths}")
        assert main([*command, *chosen]) == 0
        out = capsys.readouterr().out.splitlines()
        found = [line for line in out if "irradiance, ratio" in line or "RMS error" in line]
        assert len(found) == lines
        with open("r.json") as file:
            report = json.load(file)
        assert ("irradiance" in report) == (lines > 0)
        if lines:
            assert report["irradiance"]["paths"] == (paths or 1 << 14)
            assert re.search(r"irradiance, ratio  \d\.\d{4} ± 0\.\d{4}$", found[0])
            assert re.search(r"RMS error  \d+\.\d %$", found[1])
            assert re.search(r"RMS error touching  \d+\.\d %$", found[2])


@pytest.mark.parametrize("paths", [-1, 1 << 27])
def test_irradiance_paths_out_of_range_are_refused_before_any_work(untraced, paths):
    with pytest.raises(lumitree.LumitreeError, match="irradiance_paths is"):
        lumitree.bake("lamp.xml", "lamp.lumitree", standard(irradiance_paths=paths))
    with pytest.raises(lumitree.LumitreeError, match="irradiance_paths is"):
        lumitree.refine(random_asset(0), "lamp.xml", irradiance_paths=paths)
    assert os.listdir() == ["lamp.xml"]


def test_an_interruption_after_the_bake_keeps_the_asset(monkeypatch, capsys):
    """The asset is written before its irradiance is compared; the same call continues."""
    from lumitree.measure import irradiance as evaluate

    compare = evaluate.evaluate_irradiance

    def interrupt(*_):
        """As Dr.Jit does while it traces a loop."""
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt as error:
            raise RuntimeError("in a loop") from error

    monkeypatch.setattr(evaluate, "evaluate_irradiance", interrupt)
    assert main(["bake", "lamp.xml", "-o", "lamp.lumitree", "--parts", "light"]) == 128 + 15
    line = "the asset in lamp.lumitree is complete, but its irradiance was not compared"
    assert capsys.readouterr().err.splitlines()[-1] == f"lumitree: error: interrupted; {line}"
    stopped = lumitree.bake("lamp.xml", "lamp.lumitree", standard(parts=["light"]))
    assert stopped.complete
    assert (stopped.stopped_by, stopped.irradiance) == (signal.SIGTERM, None)
    kept = lumitree.load("lamp.lumitree")
    assert os.path.exists("lamp.work")
    monkeypatch.setattr(evaluate, "evaluate_irradiance", compare)
    monkeypatch.setattr(light_field_bake, "LampRays", None)
    again = lumitree.bake("lamp.xml", "lamp.lumitree", standard(parts=["light"]))
    assert again.stopped_by is None
    assert again.irradiance is not None
    assert_equal_fields(again.asset.light_field, kept.light_field)
    assert sorted(os.listdir()) == ["lamp.lumitree", "lamp.xml"]


def test_a_light_field_alone_has_nothing_to_refine():
    """Gradient descent cannot begin without leaves: that is refused in one line."""
    rough = lumitree.bake("lamp.xml", config=standard(parts=["light"])).asset
    with pytest.raises(lumitree.LumitreeError, match="has no field"):
        lumitree.refine(rough, "lamp.xml", rays=1 << 14)


def test_an_interrupted_bake_keeps_the_light_field(monkeypatch):
    """The same call continues it, without tracing the light paths again."""
    from lumitree.fit.octree.descent import Refiner

    advance = Refiner.advance

    def interrupt(self, progress):
        os.kill(os.getpid(), signal.SIGTERM)
        return advance(self, progress)

    monkeypatch.setattr(Refiner, "advance", interrupt)
    cut = lumitree.bake("lamp.xml", "lamp.lumitree")
    assert not cut.complete
    assert cut.stopped_by == signal.SIGTERM
    assert cut.asset.light_field is not None
    assert "light.npz" in os.listdir("lamp.work")
    monkeypatch.setattr(Refiner, "advance", advance)
    monkeypatch.setattr(light_field_bake, "LampRays", None)
    whole = lumitree.bake("lamp.xml", "lamp.lumitree")
    assert whole.stopped_by is None
    assert_equal_fields(whole.asset.light_field, cut.asset.light_field)
    assert sorted(os.listdir()) == ["lamp.lumitree", "lamp.xml"]


def test_info_of_an_asset_counts_its_cells():
    asset = dataclasses.replace(random_asset(0), light_field=random_light_field(0, count=7))
    assert asset.info.light_field_cells == 7
    save(asset, "seven.lumitree")
    assert lumitree.load("seven.lumitree").info == asset.info


def test_info_of_an_light_field_needs_no_llvm(tmp_path, monkeypatch, capsys):
    lamp = random_asset(0)
    light = light_field_asset(random_light_field(0), lamp.frame, "lamp")
    lumitree.save(light, tmp_path / "lamp.lumitree")

    def refused():
        raise LumitreeError("no libLLVM")

    monkeypatch.setattr("lumitree.rendering.asset_cache.load_mitsuba", refused)
    assert main(["info", str(tmp_path / "lamp.lumitree")]) == 0
    assert "lm\n" in capsys.readouterr().out
    lumitree.save(lamp, tmp_path / "field.lumitree")
    assert main(["info", str(tmp_path / "field.lumitree")]) == 2
