"""The extension in Blender: installed, imports, settings, panels and bakes."""

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.core.frames import LocalFrame, rotation, similarity
from support.light_fields import random_light_field

blender = os.environ.get("LUMITREE_BLENDER_PYTHON")
TINY_BAKES = Path(__file__).parents[3] / "tests" / "support" / "tiny_bakes.py"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not blender, reason="LUMITREE_BLENDER_PYTHON is not set"),
]


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


def test_blender_finds_the_archive_valid(archive):
    where = "import bpy; print(bpy.utils.resource_path('LOCAL'))"
    run = subprocess.run([str(blender), "-c", where], capture_output=True, text=True, check=True)
    tool = Path(run.stdout.strip()) / "scripts/addons_core/bl_pkg/cli/blender_ext.py"
    run = subprocess.run(
        [str(blender), str(tool), "validate", str(archive)], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout + run.stderr


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
def asset(tmp_path):
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


def test_an_asset_is_imported_and_changed(archive, asset, tmp_path):
    from lumitree.core.photometry import colour_temperature, luminance
    from lumitree.rendering.asset_flux import asset_watts, factors_to

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
    wanted = factors_to(watts, 800, 2700, "lamp")
    np.testing.assert_allclose(flux("temperature set"), watts.mean() * wanted, rtol=2e-3)
    assert found["lumens then"] == pytest.approx(800, rel=1e-3)
    np.testing.assert_allclose(flux("again"), 4 * watts.mean() * wanted, rtol=2e-3)
    assert found["scaled lumens"] == pytest.approx(3200, rel=1e-3)
    assert found["location"] == [1, 2, 3]
    # Three lights, and the one that is in use elsewhere.
    assert (found["counts"], found["kept"]) == ([4, 1], [True, True])
    np.testing.assert_allclose(flux("own colour"), 4 * watts.mean() * 800 / lumens, rtol=1e-3)
    np.testing.assert_allclose(flux("back"), watts.mean(), rtol=1e-5)


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
