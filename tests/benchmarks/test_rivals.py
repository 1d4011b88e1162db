"""Methods of other renderers: their scenes, their figures, and the harness from end to end."""

import dataclasses
import json
import os
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import lumitree
from benchmarks.equal_error.batches import MAX_BATCHES, MIN_BATCHES, LongRun
from benchmarks.equal_error.error_against_time import Estimate
from benchmarks.rival_methods.figures import (
    Figures,
    bias_text,
    display_bias,
    display_ladder,
    display_times,
    display_variance,
    figures,
    relative_variance,
    time_text,
)
from benchmarks.rival_methods.method import Method, TimedImage, extend, opened_run
from lumitree.core.images import srgb_from_linear
from lumitree.core.photometry import flux_from_radiance, luminance
from lumitree.errors import LumitreeError
from support.lamps import AREA, GLASS, lamp_of, scene, sphere

luxcore = os.environ.get("LUMITREE_LUXCORE_PYTHON")
blender = os.environ.get("LUMITREE_BLENDER_PYTHON")
needs_luxcore = pytest.mark.skipif(not luxcore, reason="LUMITREE_LUXCORE_PYTHON is not set")
needs_blender = pytest.mark.skipif(not blender, reason="LUMITREE_BLENDER_PYTHON is not set")
METAL = (
    '<bsdf type="roughconductor"><string name="material" value="Au"/>'
    '<float name="alpha" value="0.2"/></bsdf>'
)
# Hollow: of what emits in solid glass, Cycles does not divide the radiance by the squared index.
BULB = (
    sphere("bulb", 0.5, inside=GLASS),
    sphere("cavity", 0.45, inside=GLASS, flip=True),
    sphere("wire", 0.1, inside=METAL + AREA),
)


class Noisy:
    """Images of a plain wall, 2 CPU seconds a sample, with independent noise."""

    def __init__(self, deviation, level=1.0, shape=(24, 32)):
        self.deviation, self.level, self.shape, self.calls = deviation, level, shape, []

    def images(self, samples, seeds):
        self.calls.append((samples, len(seeds)))
        for seed in seeds:
            noise = np.random.default_rng(seed).normal(0, self.deviation, (*self.shape, 1))
            image = np.repeat(self.level + noise / samples**0.5, 3, axis=-1)
            yield TimedImage(image.astype(np.float32), {"wall": samples, "cpu": 2.0 * samples})


def run_of(renderer, path, images=24):
    run = LongRun(path, path.name, 4)
    for image in renderer.images(4, run.next_seeds[:images]):
        run.append(image.radiance, image.seconds)
    return run


def test_images_are_made_until_they_have_cost_enough(tmp_path):
    renderer = Noisy(0.1)
    method = Method("noisy", "noisy", renderer)
    run = opened_run(method, tmp_path, {"width": 32})
    extend(run, method, 0)
    assert not renderer.calls
    extend(run, method, 100)
    assert renderer.calls == [(4, MIN_BATCHES), (4, 5)]
    assert run.seconds["cpu"] == 104
    again = opened_run(method, tmp_path, {"width": 32})
    assert len(again.batches) == 13
    extend(again, method, 100)
    assert len(renderer.calls) == 2
    extend(again, method, 400)
    assert again.seconds["cpu"] >= 400
    # Neighbours were averaged on the way, and no image is met twice.
    assert again.samples == 8
    assert len(np.unique(again.batches[:, 0, 0, 0])) == len(again.batches) < MAX_BATCHES
    assert len(opened_run(method, tmp_path, {"width": 64}).batches) == 0


def test_images_before_an_interruption_are_kept(tmp_path):
    def interrupted(samples, seeds):
        yield from Noisy(0.1).images(samples, seeds[:3])
        raise KeyboardInterrupt

    method = Method("noisy", "noisy", Noisy(0.1))
    halted = dataclasses.replace(method, renderer=SimpleNamespace(images=interrupted))
    with pytest.raises(KeyboardInterrupt):
        extend(opened_run(halted, tmp_path, {}), halted, 100)
    resumed = opened_run(method, tmp_path, {})
    assert len(resumed.batches) == 3
    extend(resumed, method, 100)
    whole = opened_run(method, tmp_path / "whole", {})
    extend(whole, method, 100)
    np.testing.assert_array_equal(resumed.batches, whole.batches)


@pytest.mark.parametrize(
    ("radiance", "cpu", "message"),
    [(0.0, 1.0, "a black image"), (1.0, -0.01, "images in no measurable time")],
)
def test_images_that_cannot_be_right_are_refused(tmp_path, monkeypatch, radiance, cpu, message):
    image = TimedImage(np.full((2, 2, 3), radiance, np.float32), {"wall": cpu, "cpu": cpu})
    renderer = Noisy(0.1)
    monkeypatch.setattr(renderer, "images", lambda *_: [image], raising=False)
    method = Method("odd", "Odd", renderer)
    run = opened_run(method, tmp_path, {})
    with pytest.raises(LumitreeError, match=f"Odd has rendered {message}"):
        extend(run, method, 1)
    assert len(opened_run(method, tmp_path, {}).batches) == 0


def test_variance_is_relative_and_of_the_chosen_pixels():
    random = np.random.default_rng(1)
    scale = np.full((40, 50, 3), 2.0)
    batches = np.repeat(random.normal(2, 0.5, (200, 40, 50, 1)), 3, axis=-1)
    batches[:, :20] *= 100
    mask = np.arange(40)[:, None] * np.ones(50) >= 20
    assert relative_variance(batches, scale, mask) == pytest.approx(0.0625, rel=0.02)


def test_figures_of_known_noise(tmp_path):
    run = run_of(Noisy(0.3, 1.05), tmp_path / "a.npz")
    reference = run_of(Noisy(0.01, 1.0), tmp_path / "b.npz")
    clean, mask = np.ones((24, 32, 3)), np.ones((24, 32), bool)
    found = figures(run, mask, reference, None, clean)
    assert found.milliseconds == pytest.approx(2000)
    assert found.variance == pytest.approx(0.09, rel=0.1)
    assert found.product == pytest.approx(180, rel=0.1)
    assert found.mean.value == pytest.approx(1.05, abs=3 * found.mean.error)
    assert (found.samples, found.images, found.display) == (96, 24, ())
    assert found.verdict == "biased"


@pytest.mark.parametrize(
    ("mean", "error", "verdict"),
    [
        (1.01, 0.002, "agrees"),
        (0.985, 0.008, "agrees"),
        (1.05, 0.01, "biased"),
        (1.05, 0.04, "unknown"),
        (1.0, 0.02, "unknown"),
    ],
)
def test_verdicts(mean, error, verdict):
    found = Figures(1.0, 1.0, Estimate(mean, error), (), None, 1, 1, 1.0)
    assert found.verdict == verdict


def test_display_error_of_noise_falls_as_the_root_of_time(tmp_path):
    """Images of other brightness have the noise's error alone."""
    run = run_of(Noisy(0.05, 1.3), tmp_path / "a.npz")
    seconds, errors = display_ladder(run, np.ones((24, 32, 3)))
    assert len(seconds) == 4
    np.testing.assert_allclose(errors * np.sqrt(seconds), errors[0] * seconds[0] ** 0.5, rtol=0.1)
    # One image: 8 CPU s; its deviation from the mean of 24 has less variance.
    assert seconds[0] == pytest.approx(8 / (1 - 1 / 24))
    kinds = [each.kind for each in display_times(run, np.ones((24, 32, 3)))]
    assert kinds == ["below"] * 3
    # Beyond the images the variance tells the time, however many tones are clipped in them.
    loud = display_times(run_of(Noisy(2.0), tmp_path / "b.npz"), np.ones((24, 32, 3)))
    assert [each.kind for each in loud] == ["extrapolated"] * 3
    for each in loud:
        quiet = errors[0] ** 2 * seconds[0] * (2.0 / 0.05) ** 2 / each.level**2
        assert each.seconds == pytest.approx(quiet, rel=0.15)


@pytest.mark.parametrize("level", [1.0, 1.02])
def test_bias_is_known_without_the_noise(tmp_path, level):
    """Of two noisy runs: the difference of their levels, on the display's scale."""
    run = run_of(Noisy(0.2, level), tmp_path / "a.npz")
    reference = run_of(Noisy(0.4), tmp_path / "b.npz")
    whole = np.ones((24, 32, 3))
    found = display_bias(run, reference, whole)
    encoded = srgb_from_linear(0.18 * np.array([1.0, level]))
    expected = 255 * (encoded[1] - encoded[0])
    assert found.value == pytest.approx(expected**2, abs=4 * found.error)
    # Noise is more than three times as much.
    assert found.error < 1 < display_variance(reference, whole) / reference.samples_per_pixel / 3


def test_bias_is_stated_with_its_bound():
    assert bias_text(None) == "-"
    assert bias_text({"value": 4.0, "error": 1.0}) == "2.0"
    assert bias_text({"value": 1.0, "error": 1.5}) == "<2.0"
    assert bias_text({"value": -1.0, "error": 2.0}) == "<2.0"


def test_denoised_images_have_less_noise(mi, tmp_path):
    pytest.importorskip("mitsuba_oidn")
    from benchmarks.rival_methods.denoising import Guides, denoised_noise

    shape = (48, 64)
    wall = Guides(np.full((*shape, 3), 0.5, np.float32), np.zeros((*shape, 3), np.float32))
    run, clean = run_of(Noisy(0.2, shape=shape), tmp_path / "a.npz"), np.ones((*shape, 3))
    found = denoised_noise(run, wall, np.ones(shape, bool), clean, 30.0)
    # Four images of 8 CPU s, of four samples each: 5 % without the filter.
    assert found.seconds == 32
    assert 0 < found.error < 0.02


def test_times_are_marked():
    texts = {"measured": "12", "extrapolated": "~12", "below": "<12"}
    for kind, text in texts.items():
        assert time_text({"level": 5.0, "seconds": 12.3, "kind": kind}) == text
    assert time_text({"level": 5.0, "seconds": 0.123, "kind": "measured"}) == "0.12"
    assert time_text({"level": 5.0, "seconds": 12345.0, "kind": "measured"}) == "12,345"


def test_the_room_is_the_same_for_all(mi):
    from benchmarks.rival_methods.room import Room
    from lumitree.output.geometry_meshes import geometry_meshes

    described = Room(16, [3.0, 2, 1])
    room, geometry = described.mitsuba(), described.geometry()
    assert {each["type"] for each in geometry.materials} == {"twosided"}
    areas = []
    for mesh in geometry_meshes(geometry, np.eye(4)):
        corners = mesh["vertices"][mesh["faces"]].astype(np.float64)
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas.append(np.linalg.norm(sides, axis=1).sum() / 2)
    exact = [float(np.ravel(shape.surface_area())[0]) for shape in room.shapes()]
    np.testing.assert_allclose(sorted(areas), sorted(exact), rtol=3e-3)
    view = described.camera()
    assert (view["width"], view["height"], view["fov"]) == (16, 12, 58)
    forward = np.subtract(view["target"], view["origin"])
    expected = np.array([-0.35, 0.05, -1.9])
    np.testing.assert_allclose(forward, expected / np.linalg.norm(expected), atol=1e-6)
    # The window emits half of what the lamp does.
    windows = [shape for shape in room.shapes() if shape.is_emitter()]
    radiance = mi.traverse(windows[0].emitter())["radiance.value"].numpy().ravel()
    area = sum(float(np.ravel(window.surface_area())[0]) for window in windows)
    lumens = flux_from_radiance(radiance, area)
    assert lumens == pytest.approx(0.5 * luminance([3.0, 2, 1]), rel=1e-5)


def test_luxcore_has_the_materials_of_a_lamp(mi, tmp_path):
    from benchmarks.rival_methods.luxcore import lines, luxcore_scene
    from lumitree.lamp.stored_geometry import stored_geometry

    geometry = stored_geometry(lamp_of(tmp_path, *BULB))
    matrix = np.diag([2.0, 2, 2, 1])
    matrix[:3, 3] = [0, 1, 0]
    view = {"origin": [0, 0, 3], "target": [0, 0, 0], "fov": 60, "width": 16, "height": 12}
    found = luxcore_scene([("lamp", geometry, matrix)], view)
    names = [f"lamp{index}" for index in range(3)]
    types = sorted(found.properties[f"scene.materials.{name}.type"] for name in names)
    assert types == ["glass", "glass", "metal2"]
    wire = next(n for n in names if f"scene.materials.{n}.emission" in found.properties)
    assert found.properties[f"scene.materials.{wire}.emission"] == [3, 2, 1]
    assert found.properties[f"scene.materials.{wire}.uroughness"] == pytest.approx(0.2)
    gold = found.properties[f"scene.textures.{wire}_fresnel.kr"]
    assert gold[0] > gold[1] > gold[2] > 0.2
    vertices = found.meshes[f"{wire}.vertices"]
    np.testing.assert_allclose(vertices.mean(axis=0), [0, 1, 0], atol=2e-2)
    np.testing.assert_allclose(np.linalg.norm(vertices - [0, 1, 0], axis=1), 0.2, rtol=1e-5)
    np.testing.assert_allclose(
        found.meshes[f"{wire}.normals"], (vertices - [0, 1, 0]) / 0.2, atol=1e-5
    )
    assert f"scene.materials.{wire}.emission = 3.0 2.0 1.0\n" in lines(found.properties)


@pytest.mark.parametrize(
    ("material", "expected"),
    [
        ({"type": "diffuse", "reflectance": 0.5}, {"type": "matte", "kd": [0.5] * 3}),
        (
            {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
            {"type": "glass", "kr": [1.0] * 3, "kt": [1.0] * 3, "interiorior": 1.5},
        ),
        ({"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}, {"type": "archglass"}),
        (
            {"type": "roughdielectric", "int_ior": 1.5, "ext_ior": 1.0, "alpha": 0.3},
            {"type": "roughglass", "uroughness": 0.3, "vroughness": 0.3},
        ),
        (
            {"type": "conductor", "material": "none", "specular_reflectance": 0.5},
            {"type": "mirror", "kr": [0.5] * 3},
        ),
        (
            {"type": "mask", "opacity": 0.25, "nested": [{"type": "diffuse"}]},
            {"type": "mix", "amount": 0.25, "material1": "x_clear", "material2": "x_0"},
        ),
        (
            {"type": "twosided", "nested": [{"type": "diffuse", "reflectance": 0.5}]},
            {"type": "matte", "kd": [0.5] * 3},
        ),
        (
            {"type": "twosided", "nested": [{"type": "diffuse"}, {"type": "diffuse"}]},
            {"type": "twosided", "frontmaterial": "x_0", "backmaterial": "x_1"},
        ),
        (
            {"type": "blendbsdf", "weight": 0.1, "nested": [{"type": "diffuse"}] * 2},
            {"type": "mix", "amount": 0.1},
        ),
        (
            {"type": "roughplastic", "diffuse_reflectance": 0.3, "int_ior": 1.6, "ext_ior": 1.0},
            {"type": "glossy2", "kd": [0.3] * 3, "index": 1.6, "uroughness": 0.1},
        ),
        (
            {"type": "plastic", "int_ior": "polypropylene", "ext_ior": 1.0},
            {"type": "glossy2", "ks": [1.0] * 3, "index": 1.49, "uroughness": 0.0},
        ),
        (
            {"type": "principled", "base_color": [0.2, 0.4, 0.6], "roughness": 0.5, "eta": 1.4},
            {"type": "glossy2", "kd": [0.2, 0.4, 0.6], "index": 1.4, "vroughness": 0.25},
        ),
    ],
)  # fmt: skip
def test_luxcore_materials(mi, material, expected):
    from benchmarks.rival_methods.luxcore import material_properties

    found = material_properties("x", material)
    for name, value in expected.items():
        assert found[f"scene.materials.x.{name}"] == pytest.approx(value) or value == found[name]


@pytest.mark.parametrize(
    ("material", "message"),
    [
        ({"type": "principled", "metallic": 1.0}, "'principled' is not written"),
        ({"type": "diffuse", "reflectance": {"image": 0}}, "textures are not written"),
    ],
)
def test_luxcore_refuses_what_it_has_no_equal_for(mi, material, message):
    from benchmarks.rival_methods.luxcore import material_properties

    with pytest.raises(LumitreeError, match=message):
        material_properties("x", material)


def test_luxcore_media_are_per_unit_of_the_scene(mi):
    from benchmarks.rival_methods.luxcore import shape_properties

    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    shape = {"material": 0, "radiance": None, "interior": [1.0, 2.0, 3.0]}
    found = shape_properties("x", shape, [glass], scale=2.0)
    assert found["scene.volumes.x_medium.type"] == "clear"
    assert found["scene.volumes.x_medium.absorption"] == [0.5, 1.0, 1.5]
    assert found["scene.volumes.x_medium.ior"] == 1.5
    medium = {"absorption": [0.0] * 3, "scattering": [4.0] * 3, "anisotropy": 0.5}
    with pytest.raises(LumitreeError, match="media that scatter"):
        shape_properties("x", shape | {"interior": medium}, [glass], scale=2.0)
    with pytest.raises(LumitreeError, match="outside of a shape"):
        shape_properties("x", shape | {"exterior": [1.0] * 3}, [glass], scale=2.0)


def test_thin_glass_leaves_all_else(mi, tmp_path):
    from benchmarks.rival_methods.mitsuba_methods import with_thin_glass

    luminaire = lamp_of(tmp_path, *BULB)
    kinds = [
        sorted(node.props.plugin_name() for node in each.parsed.nodes("BSDF"))
        for each in (luminaire, with_thin_glass(luminaire))
    ]
    # Both surfaces of glass have one BSDF.
    assert kinds == [["dielectric", "roughconductor"], ["roughconductor", "thindielectric"]]


def test_point_lights_have_the_flux_of_the_light_field(mi):
    from benchmarks.rival_methods.mitsuba_methods import point_lights_asset
    from lumitree.asset.asset import light_field_asset
    from lumitree.core.frames import LocalFrame
    from lumitree.rendering.asset_flux import light_field_watts
    from support.light_fields import random_light_field

    frame = LocalFrame([1, 1, 1], np.eye(4))
    asset = light_field_asset(random_light_field(1, depth=3, count=20), frame, "lamp")
    for count in (1, 16):
        found = point_lights_asset(asset, count).light_field
        assert len(found.cells) == count
        np.testing.assert_allclose(
            light_field_watts(found), light_field_watts(asset.light_field), rtol=5e-3
        )


@pytest.fixture
def lamp(mi, tmp_path):
    """A luminaire file, and the work folder with its bake."""
    path = tmp_path / "lamp" / "bulb.xml"
    path.parent.mkdir()
    path.write_text(scene(*BULB))
    asset = tmp_path / "work" / "lamp-bulb" / "lamp.lumitree"
    asset.parent.mkdir(parents=True)
    light = lumitree.LightFieldConfig(paths=1 << 16, depth=3, resolution=8)
    config = lumitree.BakeConfig(parts=("light", "geometry"), irradiance_paths=0, light_field=light)
    lumitree.bake(str(path), asset, config, progress=None)
    return path


def measured(lamp: Path, *options: str):
    from benchmarks.__main__ import main

    folder = lamp.parents[1]
    command = ["rivals", str(lamp), "--work", str(folder / "work"), "-o", str(folder / "results")]
    assert main([*command, "--width", "16", "--seconds", "0.01", *options]) == 0
    text = (folder / "results" / "rivals.json").read_text(encoding="utf-8")
    return json.loads(text)["luminaires"][0]["methods"]


@pytest.mark.slow
def test_the_harness_from_end_to_end(lamp, capsys):
    names = ["baked", "light", "lumitree-path", "ptracer", "sphere"]
    found = measured(lamp, "--only", *names)
    said = capsys.readouterr().err
    assert "methods of luxcore are left out: --luxcore is not given" in said
    assert "methods of blender are left out: --blender is not given" in said
    assert list(found) == names
    assert found["baked"]["over"]["baked"] == found["light"]["over"]["light"] == 1
    assert found["lumitree-path"]["mean"]["value"] == 1
    assert len(found["baked"]["display"]) == 3
    assert found["ptracer"]["display"] == []
    if find_spec("mitsuba_oidn"):
        assert found["baked"]["denoised"]["error"] < found["baked"]["variance"] ** 0.5
    results = lamp.parents[1] / "results"
    assert (results / "rivals-lamp-bulb.png").stat().st_size > 1000
    text = (results / "rivals.md").read_text(encoding="utf-8")
    assert "| Mitsuba `ptracer` |" in text
    # Once more without rendering: the same images.
    again = measured(lamp, "--seconds", "0")
    assert again["ptracer"]["seconds"] == found["ptracer"]["seconds"]


@pytest.mark.slow
def test_a_program_without_the_module_is_left_out(lamp, capsys):
    found = measured(lamp, "--only", "baked", "light", "--luxcore", "no-such-program")
    assert list(found) == ["baked", "light"]
    assert "luxcore are left out: no-such-program is not a program" in capsys.readouterr().err


def expect_brightness_of_ours(lamp, names, *program):
    """Images of methods of another renderer are as bright as those of the reference."""
    found = measured(lamp, "--only", "baked", "light", *names, *program)
    for name in names:
        mean = found[name]["mean"]
        assert mean["value"] == pytest.approx(1, abs=0.1 + 4 * mean["error"])


@needs_luxcore
def test_luxcore_renders_the_lamp(lamp):
    names = ["luxcore-path", "luxcore-bidir-late", "luxcore-light"]
    expect_brightness_of_ours(lamp, names, "--luxcore", str(luxcore))


@needs_blender
def test_cycles_renders_the_lamp(lamp):
    names = ["cycles", "cycles-guided", "cycles-export"]
    expect_brightness_of_ours(lamp, names, "--blender", str(blender))
