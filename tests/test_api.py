"""From a luminaire to an image, end to end, with the smallest settings."""

import inspect
import json
import os
import re

import numpy as np
import pytest

import lumitree
from lumitree import demo
from lumitree.core.files import WorkFolder
from lumitree.core.frames import rotation, similarity
from lumitree.fit.config import BakeConfig
from support import tiny_bakes
from support.fields import random_asset
from support.light_fields import assert_equal_fields
from support.reference_field import integrate_ray
from support.tiny_bakes import standard

LAMP = """<scene version="3.0.0">
<shape type="sphere"><float name="radius" value="0.5"/>
<emitter type="area"><rgb name="radiance" value="3,2,1"/></emitter></shape>
<shape type="cube"><transform name="to_world"><scale x="1" y="0.1" z="0.1"/></transform>
<bsdf type="diffuse"/></shape></scene>"""


@pytest.fixture
def tiny(mi, monkeypatch):
    """An octree fit of seconds."""
    tiny_bakes.set_qualities(monkeypatch.setattr)


@pytest.fixture
def tiny_network(network_packages, monkeypatch):
    """A network's bake of seconds: few views, a small network, few light paths."""
    tiny_bakes.set_qualities(monkeypatch.setattr)


@pytest.mark.slow
def test_bake_evaluate_render(mi, tiny, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(LAMP)
    baked = lumitree.bake("lamp.xml", "lamp.lumitree")
    assert baked.asset.info.leaves > 50
    assert baked.asset.tree_depth == 5
    assert tiny_bakes.RAYS <= (baked.rays or 0) < tiny_bakes.RAYS + 6 * (1 << 14)
    assert set(baked.seconds) == {"light", "bake", "irradiance"}
    assert not (tmp_path / "lamp.work").exists()
    json.dumps(baked.to_json(), allow_nan=False)
    report = lumitree.evaluate(
        "lamp.lumitree", "lamp.xml", "sheet.png", views=3, resolution=48, spp=64,
        irradiance_paths=1 << 17,
    )  # fmt: skip
    metrics = report.metrics
    assert metrics["gain_linear"] == metrics["psnr_linear"] - metrics["psnr_linear_black"] > 6
    assert metrics["opacity_rmse"] < 0.2
    assert metrics["flux_error"] < 0.2
    assert (tmp_path / "sheet.png").stat().st_size > 10_000
    assert metrics["irradiance_ratio"] == pytest.approx(1, abs=0.05)
    assert 0 <= metrics["irradiance_rms"] < 0.15
    assert 0 <= metrics["irradiance_rms_touching"] < 0.15
    assert report.irradiance["paths"] == 1 << 17
    assert len(report.irradiance["faces"]) == 7
    assert {"evaluate", "irradiance"} < set(report.seconds)
    assert report.irradiance_sheet.name == "sheet-irradiance.png"
    assert report.irradiance_sheet.read_bytes() == report.irradiance_png
    json.dumps(report.to_json(), allow_nan=False)


@pytest.mark.slow
def test_network_bake_evaluate(mi, tiny_network, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(LAMP)
    baked = lumitree.bake("lamp.xml", "lamp.lumitree", method="network")
    assert baked.asset.info.leaves > 50
    assert set(baked.seconds) == {"light", "capture", "train", "extract", "irradiance"}
    lit = lumitree.bake("lamp.xml", config=standard(parts=["light"], irradiance_paths=0)).asset
    assert_equal_fields(baked.asset.light_field, lit.light_field)
    assert baked.irradiance["irradiance_ratio"] == pytest.approx(1, abs=0.05)
    assert not (tmp_path / "lamp.work").exists()
    metrics = lumitree.evaluate(
        "lamp.lumitree", "lamp.xml", views=3, resolution=48, spp=64,
        irradiance_paths=0,
    ).metrics  # fmt: skip
    assert metrics["psnr_linear"] > metrics["psnr_linear_black"] + 6


def test_a_network_needs_the_part_field(mi, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for parts, message in (
        (["light"], "parts are light; expected field"),
        ([], "parts are none; expected"),
        (["nonsense"], "part is 'nonsense'; expected light, field"),
        (["field", "geometry"], "parts are field, geometry; expected field"),
    ):
        with pytest.raises(lumitree.LumitreeError, match=message):
            BakeConfig(method="network", parts=parts)
    assert os.listdir() == []


@pytest.mark.slow
def test_an_interrupted_network_bake_continues(mi, tiny_network, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(LAMP)

    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("lumitree.octree.extract.extract", interrupt)
        with pytest.raises(KeyboardInterrupt):
            lumitree.bake("lamp.xml", "lamp.lumitree", method="network")
    assert not (tmp_path / "lamp.lumitree").exists()
    views = tmp_path / "lamp.work" / "dataset" / "view_000001.exr"
    history = tmp_path / "lamp.work" / "run" / "run.npz"
    before = views.stat().st_mtime_ns, history.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(WorkFolder, "remove", lambda *_: None)
        lumitree.bake("lamp.xml", "lamp.lumitree", method="network")
    assert (tmp_path / "lamp.lumitree").exists()
    # Neither the views nor the training are repeated.
    assert (views.stat().st_mtime_ns, history.read_bytes()) == before


@pytest.fixture
def tiny_demo(mi, tiny, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(LAMP)
    monkeypatch.setattr(demo, "LUMINAIRE", "lamp.xml")
    monkeypatch.setattr(demo, "BAKE_SECONDS", 2)
    monkeypatch.setattr(demo, "WIDTH", 40)
    monkeypatch.setattr(demo, "FULL_ROOM_SECONDS", 0.2)
    monkeypatch.setattr(demo, "ROOM_SECONDS", 0.1)
    monkeypatch.setattr(demo, "IRRADIANCE_PATHS", 1 << 14)


def test_demo(tiny_demo, tmp_path):
    quick = demo.demo("quick")
    assert set(quick["room"]) == {"baked", "explicit"}
    assert "evaluate" not in quick
    assert quick["room"]["baked"]["spp"] >= 16
    assert (tmp_path / "quick" / "comparison.png").stat().st_size > 10_000


DICTIONARY = {
    "type": "scene",
    "bulb": {
        "type": "sphere",
        "radius": 0.5,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [3, 2, 1]}},
    },
    "bar": {"type": "cube", "to_world": np.diag([1, 0.1, 0.1, 1])},
}


@pytest.mark.slow
def test_dictionaries_and_scenes_are_luminaires(mi, tmp_path):
    (tmp_path / "lamp.xml").write_text(LAMP)
    file = lumitree.load_luminaire(tmp_path / "lamp.xml")
    seen = tiny_view(file)
    bar = {**DICTIONARY["bar"], "to_world": mi.ScalarTransform4f(DICTIONARY["bar"]["to_world"])}
    dictionary = {**DICTIONARY, "bar": bar}
    for luminaire in (dictionary, mi.load_dict(dictionary)):
        loaded = lumitree.load_luminaire(luminaire)
        assert isinstance(loaded, lumitree.Luminaire)
        np.testing.assert_allclose(loaded.frame.half_extents, file.frame.half_extents)
        assert (loaded.num_emitters, loaded.has_media) == (1, False)
        view = tiny_view(loaded)
        assert view.max_radiance == pytest.approx(seen.max_radiance, rel=1e-3)
        assert view.image is None
        assert view._repr_png_().startswith(b"\x89PNG")


def tiny_view(luminaire):
    return lumitree.preview(luminaire, sheet=True, resolution=16, spp=16, progress=None)


@pytest.mark.parametrize(
    ("luminaire", "message"),
    [
        ({"type": "sphere"}, "no emitter"),
        ({"type": "sphere", "radius": object()}, "not a Mitsuba scene"),
        ({"type": "constant"}, "no shapes"),
        (7, "not of type int"),
    ],
)
def test_what_is_no_luminaire_is_refused(mi, luminaire, message):
    with pytest.raises(lumitree.LumitreeError, match=message) as refusal:
        lumitree.load_luminaire(luminaire)
    assert "\n" not in str(refusal.value)


def test_scenes_that_are_no_luminaires_are_refused(mi):
    sphere = {"type": "sphere", "emitter": {"type": "area"}}
    for scene, message in (
        ({"type": "scene"}, "no shapes"),
        ({"type": "scene", "a": {"type": "sphere"}}, "no emitter"),
        ({"type": "scene", "a": sphere, "sky": {"type": "constant"}}, "light without a surface"),
    ):
        with pytest.raises(lumitree.LumitreeError, match=message):
            lumitree.load_luminaire(mi.load_dict(scene))


def test_lines_of_an_asset_are_those_of_the_reference(mi):
    place = similarity(rotation([1, 2, 3], 40), 2.5, [3.0, -1.0, 7.0])
    asset = random_asset(5, half_extents=np.array([1.0, 0.5, 0.75]), world_from_local=place)
    random = np.random.default_rng(0)
    local = random.uniform(-0.5, 0.5, (40, 3))
    towards = random.normal(size=(40, 3))
    origin = local @ place[:3, :3].T + place[:3, 3]
    direction = towards @ place[:3, :3].T
    radiance, through = asset.eval(origin, direction)
    for index in range(len(local)):
        unit = towards[index] / np.linalg.norm(towards[index])
        expected, transmittance = integrate_ray(asset, local[index], unit)
        np.testing.assert_allclose(radiance[index], expected, rtol=2e-3, atol=1e-4)
        assert through[index] == pytest.approx(transmittance, abs=1e-3)
    assert asset.eval(np.zeros((0, 3)), np.zeros((0, 3)))[0].shape == (0, 3)
    for bad in (np.zeros((4, 3)), np.full((4, 3), np.nan), np.ones((3, 3)), np.ones(3)):
        with pytest.raises(lumitree.LumitreeError):
            asset.eval(np.zeros((4, 3)), bad)


def test_every_public_name_is_there_and_documented():
    for name in lumitree.__all__:
        assert getattr(lumitree, name).__doc__, name


FUNCTIONS = [name for name in lumitree.__all__ if inspect.isfunction(getattr(lumitree, name))]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_argument_has_a_type_and_a_description(name):
    function = getattr(lumitree, name)
    arguments = inspect.getdoc(function).partition("Args:\n")[2].partition("\n\n")[0]
    described = re.findall(r"^    (\w+): ", arguments, re.MULTILINE)
    parameters = inspect.signature(function).parameters
    assert described == list(parameters)
    assert all(each.annotation is not each.empty for each in parameters.values())


def test_results_are_json_without_numbers_that_it_does_not_have():
    from lumitree.core.results import plain

    values = {"a": float("nan"), "b": [1.0, np.inf], "c": np.array([[np.nan, 2.0]]), "d": np.nan}
    expected = {"a": None, "b": [1.0, None], "c": [[None, 2.0]], "d": None}
    assert json.loads(json.dumps(plain(values), allow_nan=False)) == expected
