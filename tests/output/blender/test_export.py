"""`lumitree export`: the script's data, what is refused, and what Blender makes of it."""

import dataclasses
import json
import os
import runpy
import subprocess
import sys
import types
from importlib.util import find_spec

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.asset.geometry import AssetGeometry
from lumitree.cli import main
from lumitree.core.frames import LocalFrame, rotation, similarity
from support.every_material import every_material
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
    return dataclasses.replace(plain, gain=gain)


def data_of(path, monkeypatch):
    """The description and arrays of a script, read by the script itself without Blender."""
    monkeypatch.setitem(sys.modules, "bpy", types.ModuleType("bpy"))
    return runpy.run_path(str(path), run_name="lamp")["read_data"]()


def test_the_script_holds_the_flux_in_watts_and_metres_with_z_up(tmp_path, monkeypatch):
    from lumitree.output.direction_tables import table_angles
    from lumitree.output.point_lights import cluster_lights
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
        from lumitree.output.direction_tables import table_directions

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


def test_equal_seeds_give_equal_scripts(tmp_path):
    for name in "ab":
        lumitree.export(lamp(), tmp_path / f"{name}.py", lights=4, seed=3)
    assert (tmp_path / "a.py").read_bytes() == (tmp_path / "b.py").read_bytes()


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
def test_blender_makes_nodes_of_every_material(tmp_path):
    asset = dataclasses.replace(with_geometry(every_material()), luminaire="every material, ö")
    path = tmp_path / "every.blend"
    lumitree.export(asset, path, blender=blender)
    code = (
        "import bpy, sys; bpy.ops.wm.open_mainfile(filepath=sys.argv[1]);"
        "objects = bpy.data.objects; print(len([o for o in objects if o.type == 'MESH']),"
        "len([o for o in objects if o.type == 'LIGHT']), len(bpy.data.images), end=' ');"
        "light = next(o for o in objects if o.type == 'LIGHT'); empty = light.parent;"
        "energy = lambda: (empty.update_tag(), bpy.context.view_layer.update(),"
        " light.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.energy)[-1];"
        "before = energy(); empty.scale = (3, 3, 3); empty['gain'] = 0.5;"
        "print(energy() / before)"
    )
    run = subprocess.run(
        [str(blender), "-c", code, str(path)], capture_output=True, text=True, check=True
    )
    *counts, energy = run.stdout.split()[-4:]
    meshes, lights, images = map(int, counts)
    # Flux is proportional to gain and area.
    assert float(energy) == pytest.approx(0.5 * 9, rel=1e-5)
    assert (meshes, lights) == (len(asset.geometry.shapes), 5)
    assert images >= lights + 1
    assert sorted(os.listdir(tmp_path)) == ["every.blend"]


LOOK = """
import runpy, sys
import bpy
import numpy as np
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
for light in runpy.run_path(sys.argv[1], run_name="lamp")["add_lamp"](scene).objects:
    light.hide_render = light.type == "LIGHT"
    if light.type == "EMPTY":
        light.scale = (float(sys.argv[3]),) * 3
scene.world = bpy.data.worlds.new("white")
if scene.world.node_tree is None:
    scene.world.use_nodes = True
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 0.1, (0, 0, 20)
scene.collection.objects.link(camera)
scene.camera, scene.render.engine, scene.cycles.samples = camera, "CYCLES", 16
scene.cycles.use_denoising = False
scene.view_settings.view_transform = "Raw"
scene.render.resolution_x = scene.render.resolution_y = 4
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.filepath = sys.argv[2]
bpy.ops.render.render(write_still=True)
"""


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_glass_absorbs_as_the_medium_in_it(tmp_path, mi, scale):
    """Beer's law through a block that bends no ray, whatever the lamp is scaled to."""
    absorption = [0.5, 1.0, 0.25]
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7],
             [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    none = np.zeros((0, 3), np.float32)
    block = {"type": "mesh", "vertices": 8, "faces": 12, "flipped": False, "material": 0}
    block |= {"normals": False, "texcoords": False, "colours": False, "radiance": None}
    geometry = AssetGeometry(
        vertices=0.5 * corners, normals=none, texcoords=none[:, :2], colours=none,
        faces=np.array(faces, np.uint32), images=(), shapes=(block | {"interior": absorption},),
        materials=({"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.0},),
    )  # fmt: skip
    lumitree.export(with_geometry(geometry), tmp_path / "block.py")
    image = tmp_path / "seen.exr"
    script = ["-c", LOOK, str(tmp_path / "block.py"), str(image), str(scale)]
    subprocess.run([str(blender), *script], capture_output=True, check=True)
    pixels = np.array(mi.Bitmap(str(image)))[..., :3]
    expected = np.broadcast_to(np.exp(-np.array(absorption)), pixels.shape)
    np.testing.assert_allclose(pixels, expected, rtol=0.01)


SUN = """
import math, runpy, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
runpy.run_path(sys.argv[1], run_name="lamp")["add_lamp"](scene)
for light in bpy.data.lights:
    light.energy = 0
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 0.5, (0, -5, 0)
camera.rotation_euler = (math.pi / 2, 0, 0)
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
for each in (camera, sun):
    scene.collection.objects.link(each)
scene.camera, scene.render.engine, scene.cycles.samples = camera, "CYCLES", 4
scene.cycles.use_denoising = False
scene.view_settings.view_transform = "Raw"
scene.render.resolution_x = scene.render.resolution_y = 4
scene.render.image_settings.file_format = "OPEN_EXR"
for sign in (-1, 1):
    sun.rotation_euler = (math.pi / 2 + sign * math.pi / 6, 0, 0)
    scene.render.filepath = sys.argv[2].replace("#", str(sign))
    bpy.ops.render.render(write_still=True)
"""


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize("mirrored", [False, True])
def test_normal_maps_lean_as_in_mitsuba(tmp_path, mi, mirrored):
    """A wall whose normals lean up is brighter where the sun is above it."""
    wall = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) / 2
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    # Mitsuba's second axis is the normal times the first one, whatever the coordinates are.
    up = -0.6 if mirrored else 0.6
    image = np.round((np.array([0, up, 0.8]) + 1) * 127.5).astype(np.uint8)
    none = np.zeros((0, 3), np.float32)
    shape = {"type": "mesh", "vertices": 4, "faces": 2, "flipped": False, "material": 0}
    shape |= {"normals": False, "texcoords": True, "colours": False, "radiance": None}
    texture = {"image": 0, "raw": True, "filter_type": "bilinear", "wrap_mode": "repeat"}
    texture["to_uv"] = np.eye(4).tolist()
    grey = {"type": "diffuse", "reflectance": 0.5}
    geometry = AssetGeometry(
        vertices=wall, normals=none, texcoords=uv * np.float32([-1 if mirrored else 1, 1]),
        colours=none, faces=np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
        images=(np.tile(image, (4, 4, 1)),), shapes=(shape,),
        materials=({"type": "normalmap", "normalmap": texture, "nested": [grey]},),
    )  # fmt: skip
    lamp = lumitree.shape(with_geometry(geometry), appearance="geometry")
    light = mi.ScalarTransform4f().look_at
    expected, found = [], []
    lumitree.export(with_geometry(geometry), tmp_path / "wall.py")
    script = ["-c", SUN, str(tmp_path / "wall.py"), str(tmp_path / "seen#.exr")]
    subprocess.run([str(blender), *script], capture_output=True, check=True)
    for sign in (-1, 1):
        # Of the same sun.
        from_y = -sign * np.sin(np.pi / 6)
        sun = {"type": "directional", "direction": [0, -from_y, -np.cos(np.pi / 6)]}
        scene = mi.load_dict(
            {
                "type": "scene",
                "lamp": lamp,
                "sun": {**sun, "irradiance": {"type": "rgb", "value": np.pi}},
                "sensor": {
                    "type": "radiancemeter",
                    "to_world": light([0.05, 0.05, 5], [0.05, 0.05, 0], [0, 1, 0]),
                    "film": {"type": "hdrfilm", "width": 1, "height": 1},
                },
            }
        )
        path = mi.load_dict({"type": "lumitree_path"})
        expected.append(np.array(mi.render(scene, integrator=path, spp=4)).ravel()[0])
        pixels = np.array(mi.Bitmap(str(tmp_path / f"seen{sign}.exr")))[..., 0]
        found.append(float(np.median(pixels)))
    assert expected[0] > 2 * expected[1]
    assert found[0] / found[1] == pytest.approx(expected[0] / expected[1], rel=0.1)


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
