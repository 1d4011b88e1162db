"""The extension for Blender: its archive, and what it does in Blender."""

import dataclasses
import json
import os
import subprocess
import sys
import time
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.cli import main
from lumitree.core.frames import LocalFrame, rotation, similarity
from lumitree.errors import LumitreeError
from lumitree.output.blender.extension import light, model_file, program
from support.gltf_builder import Gltf
from support.light_fields import random_light_field

blender = os.environ.get("LUMITREE_BLENDER_PYTHON")
needs_blender = pytest.mark.skipif(not blender, reason="LUMITREE_BLENDER_PYTHON is not set")
TINY_BAKES = Path(__file__).parents[2] / "support" / "tiny_bakes.py"


@pytest.fixture(scope="module")
def archive(tmp_path_factory, mi):
    path = tmp_path_factory.mktemp("extension") / "lumitree-blender.zip"
    lumitree.blender_extension(path)
    return path


@pytest.fixture
def table(archive, tmp_path, monkeypatch):
    """The table of an installed extension."""
    with zipfile.ZipFile(archive) as found:
        found.extract("blackbody.json", tmp_path)
    monkeypatch.setattr(light, "TABLE", tmp_path / "blackbody.json")
    light._table.cache_clear()
    yield
    light._table.cache_clear()


def test_the_manifest_is_one_of_blender_4_2(archive):
    with zipfile.ZipFile(archive) as found:
        names = set(found.namelist())
        manifest = tomllib.loads(found.read("blender_manifest.toml").decode())
        for name in names:
            if name.endswith(".py"):
                compile(found.read(name), name, "exec")
    assert {"__init__.py", "blackbody.json"} <= names
    assert manifest["schema_version"] == "1.0.0"
    assert manifest["id"].isidentifier()
    assert manifest["version"] == lumitree.__version__
    assert manifest["type"] == "add-on"
    assert manifest["blender_version_min"] == "4.2.0"
    assert manifest["license"] == ["SPDX:BSD-3-Clause"]
    assert {"name", "maintainer"} <= {key for key, value in manifest.items() if value}
    # Blender refuses longer texts, and those that end with punctuation.
    texts = [manifest["tagline"], *manifest["permissions"].values()]
    assert all(len(text) <= 64 and text[-1].isalnum() for text in texts)
    assert set(manifest["permissions"]) == {"files"}


def test_equal_versions_give_equal_archives(archive, tmp_path):
    result = lumitree.blender_extension(tmp_path / "again.zip")
    content = (tmp_path / "again.zip").read_bytes()
    assert content == archive.read_bytes()
    assert (result.file_bytes, result.version) == (len(content), lumitree.__version__)


def test_the_command_writes_it_and_refuses_other_names(tmp_path, monkeypatch, capsys, mi):
    monkeypatch.chdir(tmp_path)
    assert main(["blender-extension", "-o", "x.zip"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "Open: x.zip"
    assert zipfile.is_zipfile("x.zip")
    assert main(["blender-extension", "-o", "x.tar"]) == 2
    assert "does not end in .zip" in capsys.readouterr().err


def test_factors_are_those_of_lumitree(table, mi):
    from lumitree.core.photometry import luminance
    from lumitree.rendering.asset_flux import gain_to

    random = np.random.default_rng(0)
    for kelvin in [1000.0, 20000.0, *random.uniform(1000, 20000, 20)]:
        watts = random.uniform(0.1, 5, 3)
        tint = np.array(light.tint_for(watts.tolist(), kelvin))
        np.testing.assert_allclose(
            tint, gain_to(watts, None, kelvin, "lamp"), atol=1e-3 * tint.max()
        )
        found = light.lumens(watts.tolist(), tint.tolist(), 1.5, 2.0)
        assert found == pytest.approx(float(luminance(watts)) * 1.5 * 4, rel=1e-3)


def test_a_temperature_needs_light_in_its_channels(table):
    assert light.tint_for([1.0, 1.0, 0.0], 6500.0) is None
    # A black body of 1500 K is so red that its blue is clipped.
    assert light.tint_for([1.0, 1.0, 0.0], 1500.0)[2] == 0


def test_models_become_photometric_and_relative_to_a_point(tmp_path, mi):
    from lumitree.lamp.importers.gltf import read_gltf

    gltf = Gltf()
    strong = {"KHR_materials_emissive_strength": {"emissiveStrength": 4.0}}
    gltf.json["extensionsUsed"] = list(strong)
    for extensions in ({}, strong):
        material = gltf.material(emissiveFactor=[1.0, 0.5, 0.25], extensions=extensions)
        # Where Blender has (3, -7, 5), with z up.
        gltf.quad(material, translation=[3.0, 5.0, 7.0])
    gltf.quad(gltf.material(), translation=[3.0, 5.0, 7.0])
    path = tmp_path / "lamp.glb"
    path.write_bytes(model_file.prepared(gltf.glb(), (3.0, -7.0, 5.0)))
    geometry = read_gltf(path)
    radiance = [material.radiance for material in geometry.materials]
    np.testing.assert_allclose(radiance[:2], [[1, 0.5, 0.25], [4, 2, 1]], rtol=1e-6)
    assert radiance[2] is None
    for part in geometry.parts:
        (place,) = part.places
        np.testing.assert_allclose(place[:3, 3], 0, atol=1e-6)


def test_closed_glass_is_solid_as_in_cycles(tmp_path, mi):
    from lumitree.lamp.importers.gltf import read_gltf

    gltf = Gltf()
    glass = {"KHR_materials_transmission": {"transmissionFactor": 1.0}}
    gltf.json["extensionsUsed"] = list(glass)
    material = gltf.material(
        pbrMetallicRoughness={"roughnessFactor": 0.0, "metallicFactor": 0.0}, extensions=glass
    )
    gltf.sphere(material)
    gltf.quad(material)
    path = tmp_path / "lamp.glb"
    path.write_bytes(model_file.prepared(gltf.glb(), (0.0, 0.0, 0.0)))
    geometry = read_gltf(path)
    surfaces = {each.name: each.surface for each in geometry.materials}
    ball, sheet = (surfaces[part.material] for part in geometry.parts)
    assert (ball.thin, sheet.thin) == (False, True)


def python(code):
    return [sys.executable, "-c", code]


def test_commands_run_one_after_the_other(tmp_path):
    path = tmp_path / "written"
    first = python(f"open({str(path)!r}, 'w').write('first')")
    second = python(
        f"f = open({str(path)!r}, 'r+'); assert f.read() == 'first'; f.write(' second')"
    )
    program.Job([first, second], tmp_path / "log").wait()
    assert path.read_text() == "first second"


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("import sys; sys.exit('more\\nlumitree: error: no emitter\\n')", "no emitter"),
        ("import sys; sys.exit(3)", "lumitree ended with status 3"),
    ],
)  # fmt: skip
def test_a_program_that_fails_is_explained_by_its_last_line(tmp_path, code, message):
    never = python(f"open({str(tmp_path / 'never')!r}, 'w')")
    with pytest.raises(program.ExtensionError) as caught:
        program.Job([python(code), never], tmp_path / "log").wait()
    assert str(caught.value) == message
    assert not (tmp_path / "never").exists()


def test_a_job_shows_progress_and_can_be_ended(tmp_path):
    code = (
        "import sys, time; print('bake lamp: 40 %', file=sys.stderr, flush=True); time.sleep(600)"
    )
    job = program.Job([python(code), python("assert False")], tmp_path / "log")
    while "40 %" not in job.progress():
        assert not job.poll()
        time.sleep(0.01)
    assert job.progress().startswith("bake lamp: 40 % (")
    job.stop()
    job.stop()
    assert job._process.poll() is not None
    assert not job._commands


def test_programs_are_found(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(program.ExtensionError, match="lumitree was not found; install it"):
        program.find_program("")
    with pytest.raises(program.ExtensionError, match="/none is not a program"):
        program.find_program("/none")
    for name in ("lumitree", "python3"):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(0o755)
    assert program.find_program("") == [str(tmp_path / "lumitree")]
    python3 = str(tmp_path / "python3")
    assert program.find_program(python3) == [python3, "-m", "lumitree.cli"]
    with pytest.raises(program.ExtensionError, match="does not start"):
        program.Job([[str(tmp_path)]], tmp_path / "log")


# Installs the extension by Blender's own operator, into folders of the test.
INSTALL = """
import json, os, sys
from pathlib import Path
import bpy
archive, folder, program, *arguments = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
repos = bpy.context.preferences.extensions.repos
os.mkdir(folder + "/repository")
repos.new(name="test", module="test", custom_directory=folder + "/repository")
bpy.ops.extensions.package_install_files(filepath=archive, repo="test", enable_on_install=True)
addon = bpy.context.preferences.addons["bl_ext.test.lumitree"]
addon.preferences.program = program
scene = bpy.context.scene

def lights_of(lamp):
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    data = [each.evaluated_get(graph).data for each in lamp.children if each.type == "LIGHT"]
    return [[each.energy * channel for channel in each.color] for each in data]

def error_of(call):
    try:
        call()
    except RuntimeError as error:
        return str(error).strip()

"""


def in_blender(archive, folder, code, *arguments, program=sys.executable):
    """JSON that code prints in Blender with the extension installed."""
    resources = {"BLENDER_USER_RESOURCES": str(folder / "user")}
    # Without the end of the module bpy, which crashes in version 4.2 after an export as glTF.
    code = INSTALL + code + "\nsys.stdout.flush()\nos._exit(0)\n"
    command = [str(blender), "-c", code, str(archive), str(folder), str(program)]
    run = subprocess.run(
        [*command, *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, **resources},
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


@needs_blender
@pytest.mark.slow
def test_blender_finds_the_archive_valid(archive):
    where = "import bpy; print(bpy.utils.resource_path('LOCAL'))"
    run = subprocess.run([str(blender), "-c", where], capture_output=True, text=True, check=True)
    tool = Path(run.stdout.strip()) / "scripts/addons_core/bl_pkg/cli/blender_ext.py"
    run = subprocess.run(
        [str(blender), str(tool), "validate", str(archive)], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout + run.stderr


@needs_blender
@pytest.mark.slow
def test_the_extension_registers_and_unregisters(archive, tmp_path):
    code = """
state = lambda: [hasattr(bpy.types, "OBJECT_PT_lumitree"), "lumitree" in bpy.types.Object.bl_rna.properties]
found = [state()]
for _ in range(2):
    bpy.ops.preferences.addon_disable(module="bl_ext.test.lumitree")
    found.append(state())
    bpy.ops.preferences.addon_enable(module="bl_ext.test.lumitree")
    found.append(state())
print(json.dumps(found))
"""  # noqa: E501
    on, off = [True, True], [False, False]
    assert in_blender(archive, tmp_path, code) == [on, off, on, off, on]


FRAME = LocalFrame([1, 0.5, 1], similarity(rotation([0, 1, 0], 90), 0.2, [1.0, 2, 3]))


@pytest.fixture
def asset(tmp_path, mi):
    made = light_field_asset(random_light_field(1, depth=3, count=20), FRAME, "lamp")
    made = dataclasses.replace(made, gain=(2.0, 1.0, 0.5))
    lumitree.save(made, tmp_path / "lamp.lumitree")
    return made


IMPORT = """
source, = arguments
print(bpy.ops.import_scene.lumitree(filepath=source, lights=6))
lamp = bpy.context.object
settings = lamp.lumitree
found = {"first": lights_of(lamp), "lumens": settings.lumens, "kelvin": settings.temperature}
settings.lumens = 800
found["lumens set"] = lights_of(lamp)
settings.use_temperature, settings.temperature = True, 2700
found["temperature set"] = lights_of(lamp)
found["lumens then"] = settings.lumens
bpy.ops.object.select_all(action="DESELECT")
lamp.location, lamp.scale = (1, 2, 3), (2, 2, 2)
child = bpy.data.objects.new("mine", None)
child.parent = lamp
scene.collection.objects.link(child)
settings.lights = 3
bpy.data.objects.new("copy", next(each for each in lamp.children if each.type == "LIGHT").data)
bpy.context.view_layer.objects.active = next(each for each in lamp.children if each.type == "LIGHT")
print(bpy.ops.lumitree.import_again())
found["again"] = lights_of(lamp)
found["scaled lumens"] = settings.lumens
found["location"] = list(lamp.location)
found["kept"] = ["copy" in bpy.data.objects, child.parent == lamp]
found["counts"] = [len(bpy.data.lights), len(bpy.data.collections)]
settings.use_temperature = False
found["own colour"] = lights_of(lamp)
lamp.scale = (1, 1, 1)
bpy.context.view_layer.update()
settings.lumens = found["lumens"]
found["back"] = lights_of(lamp)
print(json.dumps(found))
"""


@needs_blender
@pytest.mark.slow
def test_an_asset_is_imported_and_changed(archive, asset, tmp_path):
    from lumitree.core.photometry import colour_temperature, luminance
    from lumitree.rendering.asset_flux import asset_watts, gain_to

    found = in_blender(archive, tmp_path, IMPORT, tmp_path / "lamp.lumitree")

    def flux(name):
        # Tables of lights have the flux 1 in the mean of their channels.
        assert len(found[name]) == (6 if "set" in name or name == "first" else 3)
        return np.array(found[name]).sum(axis=0)

    watts = asset_watts(asset)
    lumens = float(luminance(watts))
    np.testing.assert_allclose(flux("first"), watts.mean(), rtol=1e-5)
    assert found["lumens"] == pytest.approx(lumens, rel=1e-5)
    assert found["kelvin"] == pytest.approx(
        np.clip(colour_temperature(watts)[0], 1e3, 2e4), rel=1e-3
    )
    np.testing.assert_allclose(flux("lumens set"), watts.mean() * 800 / lumens, rtol=1e-5)
    wanted = gain_to(watts, 800, 2700, "lamp")
    np.testing.assert_allclose(flux("temperature set"), watts.mean() * wanted, rtol=2e-3)
    assert found["lumens then"] == pytest.approx(800, rel=1e-3)
    np.testing.assert_allclose(flux("again"), 4 * watts.mean() * wanted, rtol=2e-3)
    assert found["scaled lumens"] == pytest.approx(3200, rel=1e-3)
    assert found["location"] == [1, 2, 3]
    # Three lights, and the one that is in use elsewhere.
    assert (found["counts"], found["kept"]) == ([4, 1], [True, True])
    np.testing.assert_allclose(flux("own colour"), 4 * watts.mean() * 800 / lumens, rtol=1e-3)
    np.testing.assert_allclose(flux("back"), watts.mean(), rtol=1e-5)


@needs_blender
@pytest.mark.slow
def test_scripts_are_imported_without_the_program_and_others_are_not_run(archive, asset, tmp_path):
    lumitree.export(asset, tmp_path / "lamp.py", lights=4)
    (tmp_path / "other.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    (tmp_path / "fails").write_text("#!/bin/sh\necho 'lumitree: error: it failed' >&2; exit 2\n")
    (tmp_path / "fails").chmod(0o755)
    code = """
folder, = arguments
load = lambda name: bpy.ops.import_scene.lumitree(filepath=f"{folder}/{name}")
addon.preferences.program = "/none"
load("lamp.py")
found = [len(lights_of(bpy.context.object)), error_of(lambda: load("other.py"))]
found.append(error_of(lambda: load("lamp.lumitree")))
addon.preferences.program = f"{folder}/fails"
found.append(error_of(lambda: load("lamp.lumitree")))
found.append(bpy.ops.lumitree.import_again.poll())
print(json.dumps(found))
"""
    count, other, missing, failed, again = in_blender(archive, tmp_path, code, tmp_path)
    assert count == 4
    assert other == "Error: other.py is not a script of 'lumitree export'; it was not run"
    assert not (tmp_path / "ran").exists()
    assert "/none is not a program" in missing
    assert failed == "Error: it failed"
    # A script does not say what it was made from.
    assert again is False


DRAW = """
from types import SimpleNamespace
from bl_ext.test.lumitree import interface
shown = []
class Layout:
    def prop(self, data, name, **_):
        shown.append((name, data.bl_rna.properties[name].name))
    def operator(self, name, **_):
        group, _, rest = name.partition(".")
        shown.append((name, getattr(getattr(bpy.ops, group), rest).get_rna_type().name))
    def label(self, **_):
        pass
    separator = label
    def column(self, **_):
        return self
    row = column
panel = SimpleNamespace(layout=Layout())
bpy.ops.import_scene.lumitree(filepath=arguments[0])
lamp = bpy.context.object
# The panels are shown for the parts of a lamp, too.
bpy.context.view_layer.objects.active = lamp.children[0]
found = [interface.ObjectPanel.poll(bpy.context)]
for draw in (interface.SidebarPanel.draw, interface.ObjectPanel.draw):
    draw(panel, bpy.context)
interface.LumitreePreferences.draw(SimpleNamespace(layout=Layout(), bl_rna=addon.preferences.bl_rna), bpy.context)
interface._import_entry(panel, bpy.context)
bpy.context.view_layer.objects.active = None
found.append(interface.ObjectPanel.poll(bpy.context))
print(json.dumps([found, shown]))
"""  # noqa: E501


@needs_blender
@pytest.mark.slow
def test_panels_show_settings_that_there_are(archive, asset, tmp_path):
    polled, shown = in_blender(archive, tmp_path, DRAW, tmp_path / "lamp.lumitree")
    assert polled == [True, False]
    names = [name for name, _ in shown]
    settings = ["lumens", "use_temperature", "temperature", "source", "lights", "up"]
    assert all(names.count(name) == 2 for name in settings)
    assert "program" in names
    assert ["import_scene.lumitree", "Import Lumitree Asset"] in shown
    assert ["lumitree.bake_selected", "Bake Selected as Lamp"] in shown


BAKE = """
folder, = arguments
def add(thing, place):
    scene.collection.objects.link(thing)
    thing.location = place
    return thing
bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.05, location=(0.3, -0.4, 1.2))
ball = bpy.context.object
material = bpy.data.materials.new("glow")
if material.node_tree is None:
    material.use_nodes = True
principled = material.node_tree.nodes["Principled BSDF"]
principled.inputs["Base Color"].default_value = (0, 0, 0, 1)
principled.inputs["Specular IOR Level"].default_value = 0
principled.inputs["Emission Color"].default_value = (1, 0.5, 0.25, 1)
principled.inputs["Emission Strength"].default_value = 20
ball.data.materials.append(material)
lamp = bpy.data.lights.new("spot", "SPOT")
apart = add(bpy.data.objects.new("apart", lamp), (5, 5, 5))
ball.select_set(True)
bpy.ops.lumitree.bake_selected(filepath=folder + "/ball.lumitree", quality="preview", lights=3)
lamp = bpy.context.object
centre = sum((each.matrix_world.translation for each in lamp.children if each.type == "LIGHT"), lamp.location * 0) / 3
found = {"watts": list(lamp["watts"]), "location": list(lamp.location), "centre": list(centre)}
found["names"] = [lamp.name, lamp.users_collection[0].name, lamp.children[0].name]
found["hidden"] = [ball.hide_get(), ball.hide_render, apart.hide_get(), apart.hide_render]
found["files"] = os.listdir(folder)
lamp.select_set(False)
lamp = add(bpy.data.objects.new("panel", bpy.data.lights.new("panel", "AREA")), (0, 0, 0))
lamp.select_set(True)
bake = lambda: bpy.ops.lumitree.bake_selected(filepath=folder + "/panel.lumitree", quality="preview")
found["panel"] = error_of(bake)
lamp.select_set(False)
bpy.ops.mesh.primitive_cube_add()
found["dark"] = error_of(bake)
print(json.dumps(found))
"""  # noqa: E501


@needs_blender
@pytest.mark.slow
def test_a_ball_is_baked_in_its_place(archive, tmp_path):
    tiny = tmp_path / "tiny"
    run = f'exec "{sys.executable}" "{TINY_BAKES}" "$@"'
    parts = "--parts light,geometry"
    tiny.write_text(f'#!/bin/sh\nif [ "$1" = bake ]; then {run} {parts}; else {run}; fi\n')
    tiny.chmod(0o755)
    (tmp_path / "made").mkdir()
    found = in_blender(archive, tmp_path, BAKE, tmp_path / "made", program=tiny)
    # π L A; the mesh has 64 segments and 32 rings, so it is a little smaller than the sphere.
    expected = np.pi * np.array([20.0, 10.0, 5.0]) * 4 * np.pi * 0.05**2
    np.testing.assert_allclose(found["watts"], expected, rtol=0.01)
    np.testing.assert_allclose(found["location"], [0.3, -0.4, 1.2], atol=1e-6)
    # The lights are inside the ball, and balance.
    np.testing.assert_allclose(found["centre"], [0.3, -0.4, 1.2], atol=0.02)
    assert found["names"] == ["ball", "ball", "ball light 0"]
    assert found["hidden"] == [True, True, False, False]
    assert found["files"] == ["ball.lumitree"]
    assert "panel is a light of type area" in found["panel"]
    assert "has no emitter" in found["dark"]
    assert len(found["dark"].splitlines()) == 1


@needs_blender
@pytest.mark.slow
def test_a_bake_is_cancelled_by_escape(archive, tmp_path):
    """Without a window there are no events; these are made."""
    (tmp_path / "slow").write_text("#!/bin/sh\necho 'bake ball: 40 %' >&2\nexec sleep 600\n")
    (tmp_path / "slow").chmod(0o755)
    code = """
import time
from types import SimpleNamespace
from bl_ext.test.lumitree import bake, program
bpy.ops.mesh.primitive_cube_add()
started = bake.Bake.started(bpy.context, [addon.preferences.program], Path("a.lumitree"), "high", 1)
names = ("modal", "cancel", "_clean", "_finish", "_fail")
kept, texts, reports = vars(bake.BakeSelected), [], []
operator = type("Operator", (), {name: kept[name] for name in names})()
operator.bake, operator.timer = started, "timer"
operator.report = lambda kind, text: reports.append(text)
context = SimpleNamespace(
    mode="OBJECT",
    workspace=SimpleNamespace(status_text_set=texts.append),
    window_manager=SimpleNamespace(event_timer_remove=texts.append),
)
event = lambda kind: SimpleNamespace(type=kind, value="PRESS")
while not texts or "40 %" not in texts[-1]:
    assert operator.modal(context, event("TIMER")) == {"PASS_THROUGH"}
    time.sleep(0.05)
assert operator.modal(context, event("MOUSEMOVE")) == {"PASS_THROUGH"}
ended = operator.modal(context, event("ESC"))
print(json.dumps([list(ended), texts[-3:], reports, os.path.exists(started.folder.name),
    started.job._process.poll() is None, bpy.context.object.hide_render]))
"""
    ended, texts, reports, folder, runs, hidden = in_blender(
        archive, tmp_path, code, program=tmp_path / "slow"
    )
    assert ended == ["CANCELLED"]
    assert texts[0].startswith("bake ball: 40 % (")
    assert texts[1:] == ["timer", None]
    assert reports == ["The bake was cancelled"]
    assert (folder, runs, hidden) == (False, False, False)


def test_a_wrong_name_is_refused(tmp_path):
    with pytest.raises(LumitreeError, match=r"does not end in \.zip"):
        lumitree.blender_extension(tmp_path / "extension")
