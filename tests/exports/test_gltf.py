"""`lumitree export -o lamp.glb`: the file, its validator, three.js and our own importer."""

import io
import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import lumitree
from benchmarks.exported_files.gltf import GltfFile
from lumitree.asset.geometry import Medium
from lumitree.asset.materials import Dielectric, Mask, Principled
from lumitree.core.frames import similarity
from lumitree.core.photometry import LUMA, LUMENS_PER_WATT
from lumitree.exports.point_lights import turn_up
from lumitree.exports.surfaces import geometry_meshes
from support.every_material import MATERIALS, TEXTURE, every_material
from support.exported_lamps import beam, lamp
from support.geometry_assets import small_geometry, with_geometry
from support.node_packages import node_modules, run_node

pytestmark = pytest.mark.usefixtures("mi")


def rotated(quaternion, vector):
    *axis, real = quaternion
    return vector + 2 * np.cross(axis, np.cross(axis, vector) + real * np.array(vector))


@pytest.mark.parametrize("gain", [(1.0, 1.0, 1.0), (2.0, 1.0, 0.5)])
def test_both_kinds_of_lights_have_the_flux_of_the_asset(tmp_path, gain):
    from lumitree.rendering.asset_flux import asset_watts

    asset = lamp(gain=gain)
    result = lumitree.export(asset, tmp_path / "lamp.glb", lights=6)
    file, punctual, profiled = GltfFile(result.file), np.zeros(3), np.zeros(3)
    for node, point, profile in file.lights():
        assert point["type"] == "point"
        punctual += 4 * np.pi * point["intensity"] * np.array(point["color"])
        used = node["extensions"]["EXT_lights_ies"]
        # Colours above 1 are clipped.
        assert max(used["color"]) == max(point["color"]) == 1
        lumens = file.profile(profile).lumens
        profiled += used["multiplier"] * lumens * np.array(used["color"])
    np.testing.assert_allclose(punctual / LUMENS_PER_WATT, asset_watts(asset), rtol=1e-9)
    np.testing.assert_allclose(profiled / LUMENS_PER_WATT, asset_watts(asset), rtol=5e-3)


@pytest.mark.parametrize(
    ("up", "direction", "expected"),
    [
        ("y", (0.3, -0.8, 0.52), (0.3, -0.8, 0.52)),
        ("z", (-0.9, 0.3, -0.3), (-0.9, -0.3, -0.3)),
    ],
)
def test_the_brightest_direction_is_that_of_the_lamp(mi, tmp_path, up, direction, expected):
    lumitree.export(beam(mi, direction), tmp_path / "beam.glb", up=up)
    file = GltfFile(tmp_path / "beam.glb")
    ((node, _, profile),) = file.lights()
    profile = file.profile(profile)
    c, gamma = np.unravel_index(profile.intensity.argmax(), profile.intensity.shape)
    c, gamma = np.deg2rad(profile.c[c]), np.deg2rad(profile.gamma[gamma])
    # γ from the node's -z, C from its +x towards its +y.
    local = np.array([np.sin(gamma) * np.cos(c), np.sin(gamma) * np.sin(c), -np.cos(gamma)])
    turned = rotated(node["rotation"], local)
    assert turned @ np.array(expected) / np.linalg.norm(expected) > 0.98
    place = turn_up(up, "y") @ [1, 2, 3]
    np.testing.assert_allclose(node["translation"], place, atol=0.11)


def test_the_file_holds_the_surfaces(tmp_path):
    geometry, turn = small_geometry(), turn_up("z", "y")
    lumitree.export(with_geometry(geometry), tmp_path / "lamp.glb", up="z")
    file = GltfFile(tmp_path / "lamp.glb")
    expected = geometry_meshes(geometry, similarity(turn))
    for mesh, arrays in zip(file.json["meshes"], expected, strict=True):
        (primitive,) = mesh["primitives"]
        attributes = primitive["attributes"]
        np.testing.assert_array_equal(file.array(attributes["POSITION"]), arrays["vertices"])
        faces = file.array(primitive["indices"]).reshape(-1, 3)
        np.testing.assert_array_equal(faces, arrays["faces"])
        if "TEXCOORD_0" in attributes:
            np.testing.assert_array_equal(file.array(attributes["TEXCOORD_0"]), arrays["texcoords"])


def test_materials_have_the_numbers_of_the_lamp(tmp_path):
    lumitree.export(with_geometry(small_geometry()), tmp_path / "lamp.glb")
    textured, metal, glass = GltfFile(tmp_path / "lamp.glb").json["materials"]
    assert textured["doubleSided"] is True
    assert textured["alphaMode"] == "BLEND"
    assert textured["extensions"]["KHR_materials_specular"] == {"specularFactor": 0.0}
    core = metal["pbrMetallicRoughness"]
    assert core["metallicFactor"] == 1
    assert core["roughnessFactor"] == pytest.approx(0.2**0.5)
    strength = metal["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
    emitted = strength * np.array(metal["emissiveFactor"])
    np.testing.assert_allclose(emitted, 683 * np.array([3, 2, 1]))
    extensions = glass["extensions"]
    assert extensions["KHR_materials_transmission"] == {"transmissionFactor": 1.0}
    # A sphere of the radius 0.2: twice its volume over its area.
    thickness = extensions["KHR_materials_volume"]["thicknessFactor"]
    assert thickness == pytest.approx(2 * 0.2 / 3, rel=2e-3)


@pytest.mark.parametrize(("kind", "told"), [("rectangle", True), ("sphere", False)])
def test_emission_from_backs_is_told(tmp_path, kind, told):
    first, second, third = small_geometry().shapes
    third = replace(third, type=kind, radiance=(1.0, 1, 1))
    asset = with_geometry(small_geometry(shapes=(first, replace(second, radiance=None), third)))
    result = lumitree.export(asset, tmp_path / "lamp.glb")
    assert any("from their backs" in line for line in result.not_carried_over) == told


def test_a_medium_is_the_attenuation_of_a_volume(tmp_path):
    absorption = (2.0, 20.0, 70.0)
    *others, sphere = small_geometry().shapes
    sphere = replace(sphere, interior=Medium(absorption))
    lumitree.export(with_geometry(small_geometry(shapes=(*others, sphere))), tmp_path / "lamp.glb")
    glass = GltfFile(tmp_path / "lamp.glb").json["materials"][2]
    volume = glass["extensions"]["KHR_materials_volume"]
    found = -np.log(volume["attenuationColor"]) / volume["attenuationDistance"]
    np.testing.assert_allclose(found, absorption, rtol=1e-9)


def test_roughness_and_metalness_share_an_image(tmp_path):
    metalness = replace(TEXTURE, image=0, raw=True)
    material = Principled(roughness=replace(TEXTURE, raw=True), metallic=metalness)
    geometry = small_geometry()
    geometry = small_geometry(materials=(material, *geometry.materials[1:]))
    lumitree.export(with_geometry(geometry), tmp_path / "lamp.glb")
    file = GltfFile(tmp_path / "lamp.glb")
    core = file.json["materials"][0]["pbrMetallicRoughness"]
    assert (core["roughnessFactor"], core["metallicFactor"]) == (1, 1)
    texture = file.json["textures"][core["metallicRoughnessTexture"]["index"]]
    content = file.view(file.json["images"][texture["source"]]["bufferView"])
    pixels = np.asarray(Image.open(io.BytesIO(content)))
    roughness = geometry.images[1] @ np.array(LUMA)
    np.testing.assert_allclose(pixels[..., 1], roughness, atol=0.51)
    # The other image is larger or smaller, and is resampled.
    assert pixels[..., 2].mean() == pytest.approx(255 * geometry.images[0].mean(), rel=0.1)


def test_what_emits_and_is_partly_present_keeps_its_light(tmp_path):
    """It is multiplied by its opacity in the asset, and by readers of glTF."""
    geometry = small_geometry()
    masked = Mask(opacity=0.25, nested=(MATERIALS[1],))
    shape = replace(geometry.shapes[1], material=len(geometry.materials))
    assert shape.radiance == (3.0, 2.0, 1.0)
    geometry = replace(
        geometry,
        materials=(*geometry.materials, masked),
        shapes=(geometry.shapes[0], shape, *geometry.shapes[2:]),
    )
    lumitree.export(with_geometry(geometry), tmp_path / "lamp.glb")
    (found,) = (
        each
        for each in GltfFile(tmp_path / "lamp.glb").json["materials"]
        if each["pbrMetallicRoughness"]["baseColorFactor"][3] == 0.25
    )
    assert found["alphaMode"] == "BLEND"
    strength = found["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
    emitted = 0.25 * strength * np.array(found["emissiveFactor"])
    np.testing.assert_allclose(emitted, 683 * np.array([3, 2, 1]))


def everything():
    """A lamp with every material, and a mask and a colour of which one is larger."""
    geometry = every_material()
    masked = Mask(opacity=replace(TEXTURE, image=0), nested=(MATERIALS[1],))
    inside = Medium((1.0, 2.0, 3.0))
    shape = replace(geometry.shapes[0], material=len(MATERIALS), interior=inside)
    geometry = replace(
        geometry, materials=(*geometry.materials, masked), shapes=(shape, *geometry.shapes[1:])
    )
    return with_geometry(geometry)


def test_our_importer_reads_the_lamp(tmp_path):
    from lumitree.lamp.importers.gltf import read_gltf

    asset = with_geometry(small_geometry())
    lumitree.export(asset, tmp_path / "lamp.glb", lights=3)
    with pytest.warns(lumitree.LumitreeWarning) as caught:
        model = read_gltf(tmp_path / "lamp.glb")
    assert any("EXT_lights_ies" in str(each.message) for each in caught)
    materials = {each.name: each for each in model.materials}
    places = {part.name: part.places[0][:3, 3] for part in model.parts}
    lights = list(GltfFile(tmp_path / "lamp.glb").lights())
    assert len(lights) == 3
    for node, point, _ in lights:
        name = f"light_{node['name']}"
        np.testing.assert_allclose(places[name], node["translation"], atol=1e-9)
        # The luminous intensity of a small sphere, of whose triangles some more area is seen.
        area = np.pi * 0.005**2
        found = area * LUMENS_PER_WATT * np.array(materials[name].radiance)
        expected = point["intensity"] * np.array(point["color"])
        np.testing.assert_allclose(found, expected, rtol=0.02)
    np.testing.assert_allclose(materials["material1"].radiance, [3, 2, 1], rtol=1e-6)
    glass = materials["material2"].surface
    assert isinstance(glass, Dielectric)
    assert glass.int_ior == pytest.approx(1.5, abs=1e-3)


def test_our_importer_reads_every_material(tmp_path):
    from lumitree.lamp.importers.gltf import read_gltf

    lumitree.export(everything(), tmp_path / "lamp.glb", lights=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lumitree.LumitreeWarning)
        model = read_gltf(tmp_path / "lamp.glb")
    # A mesh with a normal map and mirrored texture coordinates becomes two parts.
    names = {part.name.split("_")[0] for part in model.parts}
    assert names == {"light", *(f"surface{index}" for index in range(len(MATERIALS)))}


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    return node_modules(tmp_path_factory.mktemp("npm"))


VALIDATE = """
const validator = require('gltf-validator');
const bytes = new Uint8Array(require('fs').readFileSync(process.argv[1]));
validator.validateBytes(bytes).then(report => console.log(JSON.stringify(report)));
"""


@pytest.mark.slow
def test_the_official_validator_finds_no_errors(tmp_path, packages):
    lumitree.export(everything(), tmp_path / "lamp.glb")
    report = json.loads(run_node(packages, VALIDATE, str(tmp_path / "lamp.glb")))
    issues = report["issues"]
    assert (issues["numErrors"], issues["truncated"]) == (0, False), issues
    # It does not know EXT_lights_ies, the only user of the views of the profiles; a normal map has
    # no tangents; and test images have two or three pixels a side.
    assert {each["code"] for each in issues["messages"]} == {
        "UNSUPPORTED_EXTENSION",
        "UNUSED_OBJECT",
        "MESH_PRIMITIVE_GENERATED_TANGENT_SPACE",
        "IMAGE_NPOT_DIMENSIONS",
    }
    assert report["info"]["drawCallCount"] == len(MATERIALS)
    lumitree.export(everything(), tmp_path / "spots.glb", importer="blender")
    report = json.loads(run_node(packages, VALIDATE, str(tmp_path / "spots.glb")))
    assert report["issues"]["numErrors"] == 0, report["issues"]["messages"]
