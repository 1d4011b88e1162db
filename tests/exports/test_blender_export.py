"""`lumitree export`: the script's data, what is refused, and what Blender makes of it."""

import dataclasses
import json
import os
import runpy
import sys
import types
from importlib.util import find_spec

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.cli import main
from lumitree.core.frames import LocalFrame, rotation, similarity
from support.fields import random_asset
from support.geometry_assets import small_geometry, with_geometry
from support.light_fields import random_light_field

FRAME = LocalFrame([1, 0.5, 1], similarity(rotation([0, 1, 0], 90), 2.0, [1.0, 2, 3]))
blender = os.environ.get("LUMITREE_BLENDER_PYTHON")
needs_blender = pytest.mark.skipif(not blender, reason="LUMITREE_BLENDER_PYTHON is not set")

pytestmark = pytest.mark.usefixtures("mi")


GAIN = (2.0, 1.0, 0.5)


def lamp(name="lamp", gain=GAIN):
    plain = light_field_asset(random_light_field(1, depth=3, count=20), FRAME, name)
    return dataclasses.replace(plain, light_factors=gain)


def data_of(path, monkeypatch):
    """The description and arrays of a script, read by the script itself without Blender."""
    monkeypatch.setitem(sys.modules, "bpy", types.ModuleType("bpy"))
    return runpy.run_path(str(path), run_name="lamp")["read_data"]()


def test_the_script_holds_the_flux_in_watts_and_metres_with_z_up(tmp_path, monkeypatch):
    from lumitree.exports.blender import table_angles
    from lumitree.exports.point_lights import cluster_lights
    from lumitree.rendering.asset_flux import asset_watts

    asset = lamp()
    result = lumitree.export(asset, tmp_path / "lamp.py", lights=6)
    assert (result.lights, result.triangles) == (6, 0)
    assert result.file_bytes == (tmp_path / "lamp.py").stat().st_size
    assert any("no geometry" in line for line in result.not_carried_over)
    description, arrays = data_of(tmp_path / "lamp.py", monkeypatch)
    watts = np.array([light["watts"] for light in description["lights"]])
    tables = arrays["tables"].astype(np.float64)
    weight = table_angles(tables.shape[1])
    flux = np.einsum("s,shwc,h->c", watts / (4 * np.pi), tables, weight)
    # Half precision.
    np.testing.assert_allclose(flux, asset_watts(asset), rtol=1e-3)
    local = cluster_lights(asset.light_field, FRAME.half_extents, 6).position
    x, y, z = (local @ FRAME.rotation.T * FRAME.scale + FRAME.centre).T
    places = [light["position"] for light in description["lights"]]
    np.testing.assert_allclose(places, np.stack([x, -z, y], axis=-1), atol=1e-9)


def test_the_axis_that_is_up_turns_the_light(tmp_path, monkeypatch):
    """Light along +y of the file is along +z in Blender, or along +y if z was up."""
    from lumitree.asset.light_field import make_light_field
    from lumitree.core.octahedral import bin_of

    mi = pytest.importorskip("mitsuba")
    intensity = np.zeros((1, 256, 3))
    intensity[0, int(np.array(bin_of(mi.Vector3f(0, 1, 1e-3), 16))[0])] = 1
    field = make_light_field(np.zeros((1, 3), int), intensity, 1)
    asset = light_field_asset(field, LocalFrame(np.ones(3), np.eye(4)), "beam")
    for up, expected in (("y", [0, 0, 1]), ("z", [0, 1, 0])):
        lumitree.export(asset, tmp_path / "beam.py", up=up)
        _, arrays = data_of(tmp_path / "beam.py", monkeypatch)
        from lumitree.exports.blender import table_directions

        power = arrays["tables"][0, ..., 0].astype(float)
        power *= np.hypot(*np.moveaxis(table_directions(32), -1, 0)[:2])
        mean = (table_directions(32) * power[..., None]).sum(axis=(0, 1)) / power.sum()
        assert mean @ expected > 0.98


def test_the_script_holds_the_geometry(tmp_path, monkeypatch):
    geometry = small_geometry()
    result = lumitree.export(with_geometry(geometry), tmp_path / "lamp.py")
    assert result.triangles == len(geometry.faces)
    compile((tmp_path / "lamp.py").read_text(), "lamp.py", "exec")
    description, arrays = data_of(tmp_path / "lamp.py", monkeypatch)
    assert len(description["surfaces"]) == len(geometry.shapes)
    for index, image in enumerate(geometry.images):
        assert np.array_equal(arrays[f"image {index}"], image)
        assert arrays[f"image {index}"].dtype == image.dtype
    assert np.array_equal(arrays["0.faces"], geometry.faces[:4])


def test_a_hostile_name_is_data(tmp_path, monkeypatch):
    name = '"""\nimport os\n@@DATA@@\x00'
    lumitree.export(lamp(name), tmp_path / "lamp.py")
    text = (tmp_path / "lamp.py").read_text()
    assert "import os" not in text
    description, _ = data_of(tmp_path / "lamp.py", monkeypatch)
    assert description["name"].isprintable()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    # As on a machine that has no Blender.
    monkeypatch.setitem(sys.modules, "bpy", None)
    lumitree.save(lamp(), "lamp.lumitree")
    lumitree.save(random_asset(0), "field.lumitree")
    content = (tmp_path / "lamp.lumitree").read_bytes()
    (tmp_path / "half.lumitree").write_bytes(content[: len(content) // 2])
    (tmp_path / "fails").write_text("#!/bin/sh\necho first; echo it failed >&2; exit 7\n")
    (tmp_path / "idle").write_text("#!/bin/sh\n")
    for name in ("fails", "idle"):
        (tmp_path / name).chmod(0o755)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["field.lumitree", "-o", "a.py"], "no light field"),
        (["lamp.lumitree", "-o", "a.fbx"], "does not end in .py, .blend, .rad"),
        (["half.lumitree", "-o", "a.py"], "half.lumitree"),
        (["none.lumitree", "-o", "a.py"], "none.lumitree"),
        (["lamp.lumitree", "-o", "lamp.lumitree/a.py"], "cannot write"),
        (["lamp.lumitree", "-o", "a.py", "--lights", "0"], "lights is 0; expected 1 to 1,024"),
        (["lamp.lumitree", "-o", "a.blend"], "no Blender was found"),
        (["lamp.lumitree", "-o", "a.blend", "--blender", "none"], "none is not a program"),
        (["lamp.lumitree", "-o", "a.blend", "--blender", "./fails"], "status 7: it failed"),
        (["lamp.lumitree", "-o", "a.blend", "--blender", "./idle"], "idle ended without an error"),
        pytest.param(
            ["lamp.lumitree", "-o", "a.blend", "--blender", sys.executable],
            "has no module bpy",
            marks=pytest.mark.skipif(find_spec("bpy") is not None, reason="bpy is installed"),
        ),
    ],
)
def test_bad_input_is_explained_in_one_line(folder, arguments, message, capsys, monkeypatch):
    before = sorted(os.listdir(folder))
    assert main(["export", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("lumitree: error: ")
    assert message in line
    assert sorted(os.listdir(folder)) == before


def test_the_command_prints_what_is_lost_and_writes_json(folder, capsys):
    assert main(["export", "lamp.lumitree", "-o", "lamp.py", "--json", "r.json"]) == 0
    out = capsys.readouterr().out
    assert "note: the asset has no geometry" in out
    with open("r.json", encoding="utf-8") as file:
        assert json.load(file)["lights"] == 16


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize("gain", [1.0, 2.5])
def test_cycles_illuminates_the_room_as_mitsuba_does(mi, tmp_path, gain):
    from benchmarks.cycles.room import CyclesJob, render_cycles
    from lumitree.rendering.passes import Budget, render_passes
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire, place_luminaires
    from support.cycles_room import LAMP_CENTRE, PATH_DEPTH, mitsuba_room, region_masks

    half, width, height = 0.02, 64, 48
    asset = light_field_asset(
        random_light_field(5, depth=3, count=20),
        LocalFrame(np.ones(3), similarity(np.eye(3), half)),
        "lamp",
    )  # fmt: skip
    lumitree.export(asset, tmp_path / "lamp.py", lights=8)
    job = CyclesJob(
        str(tmp_path / "lamp.py"), False, list(LAMP_CENTRE), width, height, 64, [1], gain
    )
    found = render_cycles(str(blender), job).images[0]
    placed = PlacedLuminaire(Placement(asset, at=LAMP_CENTRE, gain=gain))
    scene = place_luminaires(mitsuba_room(width, height), [placed])
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": PATH_DEPTH})
    expected = render_passes(scene, integrator, Budget(256)).radiance
    for name, mask in region_masks(width, height, np.full(3, half)).items():
        ratio = found[mask].mean(axis=0) / expected[mask].mean(axis=0)
        np.testing.assert_allclose(ratio, 1, atol=0.04, err_msg=name)
