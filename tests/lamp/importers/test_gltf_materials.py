"""The core of glTF materials: factors, textures, opacity, emission, normals, vertex colours."""

import numpy as np
import pytest

from lumitree.asset.materials import MetallicRoughness, Texture, VertexColours
from lumitree.core.images import linear_from_srgb
from lumitree.errors import LumitreeError
from lumitree.lamp.importers.gltf import read_gltf
from support.gltf_builder import QUAD, QUAD_FACES, QUAD_UV, Gltf, box
from support.gltf_materials import RAMP, extended, images_of, material_of, read_only


def test_the_default_material(tmp_path):
    gltf = Gltf()
    gltf.quad()
    (material,) = read_only(gltf.save(tmp_path)).materials
    assert material.surface == MetallicRoughness(
        base_color=(1.0, 1.0, 1.0), metallic=1.0, roughness=1.0
    )
    assert material.radiance is None
    assert material.opacity == 1
    assert material.normal_map is None
    assert not material.two_sided


def test_factors(tmp_path):
    core = {"baseColorFactor": [0.1, 0.2, 0.3, 1], "metallicFactor": 0.4, "roughnessFactor": 0.6}
    fields = {"pbrMetallicRoughness": core, "doubleSided": True, "name": "brass knob"}
    material = material_of(tmp_path, Gltf(), fields)
    assert material.surface == MetallicRoughness(
        base_color=(0.1, 0.2, 0.3), metallic=0.4, roughness=0.6
    )
    assert material.two_sided
    assert material.name == "brass_knob"


def test_textures_keep_their_bytes_without_factors(tmp_path):
    gltf = Gltf()
    core = {"baseColorTexture": gltf.texture(RAMP), "metallicRoughnessTexture": gltf.texture(RAMP)}
    material, pixels = images_of(tmp_path, gltf, {"pbrMetallicRoughness": core})
    surface = material.surface
    assert not surface.base_color.raw
    np.testing.assert_array_equal(pixels(surface.base_color), RAMP)
    for value, channel in ((surface.roughness, 1), (surface.metallic, 2)):
        assert value.raw
        np.testing.assert_array_equal(pixels(value), RAMP[..., channel : channel + 1])


def test_factors_are_baked_into_textures(tmp_path):
    gltf = Gltf()
    core = {
        "baseColorTexture": gltf.texture(RAMP),
        "baseColorFactor": [0.5, 0.25, 0, 1],
        "metallicRoughnessTexture": gltf.texture(RAMP),
        "metallicFactor": 0.5,
        "roughnessFactor": 0.25,
    }
    material, pixels = images_of(tmp_path, gltf, {"pbrMetallicRoughness": core})
    surface = material.surface
    found = linear_from_srgb(pixels(surface.base_color) / 255)
    np.testing.assert_allclose(found, linear_from_srgb(RAMP / 255) * (0.5, 0.25, 0), atol=0.004)
    np.testing.assert_allclose(pixels(surface.metallic), RAMP[..., 2:] * 0.5, atol=0.51)
    np.testing.assert_allclose(pixels(surface.roughness), RAMP[..., 1:2] * 0.25, atol=0.51)


def two_sets(gltf, first, second):
    return {"baseColorTexture": gltf.texture(RAMP) | first}, {
        "emissiveTexture": gltf.texture(RAMP) | second,
        "emissiveFactor": [1, 1, 1],
    }


@pytest.mark.parametrize(
    ("own", "other", "notes", "used"),
    [
        ({"texCoord": 1}, {"texCoord": 1}, "", 1),
        ({"texCoord": 1}, {}, "several sets of texture coordinates", 1),
        ({}, {"texCoord": 1}, "several sets of texture coordinates", 0),
        ({"extensions": {"KHR_texture_transform": {"texCoord": 1}}}, {"texCoord": 1}, "", 1),
    ],
)
def test_sets_of_texture_coordinates(tmp_path, own, other, notes, used):
    gltf = Gltf()
    core, rest = two_sets(gltf, own, other)
    fields = {"pbrMetallicRoughness": core, **rest}
    gltf.quad(gltf.material(**fields), attributes={"TEXCOORD_1": QUAD_UV * 3})
    uv = read_only(gltf.save(tmp_path), notes).parts[0].mesh.uv
    assert uv.max() == (3 if used else 1)


@pytest.mark.parametrize("cutoff", [0.25, 0.5])
def test_masks(tmp_path, cutoff):
    gltf = Gltf()
    pixels = np.zeros((1, 8, 4))
    pixels[..., 3] = np.arange(8) * 36
    core = {"baseColorTexture": gltf.texture(pixels), "baseColorFactor": [1, 1, 1, 0.8]}
    fields = {"pbrMetallicRoughness": core, "alphaMode": "MASK", "alphaCutoff": cutoff}
    material, found = images_of(tmp_path, gltf, fields)
    expected = pixels[..., 3] / 255 * 0.8 >= cutoff
    np.testing.assert_array_equal(found(material.opacity)[..., 0], 255 * expected)


def test_blending_and_opaque(tmp_path):
    core = {"baseColorFactor": [1, 1, 1, 0.3]}
    for mode, opacity in (("BLEND", 0.3), ("OPAQUE", 1), ("MASK", 0)):
        fields = {"pbrMetallicRoughness": core, "alphaMode": mode}
        assert material_of(tmp_path, Gltf(), fields).opacity == opacity
    gltf = Gltf()
    pixels = np.dstack([RAMP, RAMP[..., 0]])
    core = {"baseColorTexture": gltf.texture(pixels)}
    fields = {"pbrMetallicRoughness": core, "alphaMode": "BLEND"}
    material, found = images_of(tmp_path, gltf, fields)
    np.testing.assert_array_equal(found(material.opacity), RAMP[..., :1])


def test_emission(tmp_path):
    fields = extended(emissive_strength={"emissiveStrength": 20})
    assert material_of(tmp_path, Gltf(), fields).radiance is None
    fields["emissiveFactor"] = [1, 0.5, 0.25]
    radiance = material_of(tmp_path, Gltf(), fields).radiance
    assert radiance == pytest.approx(np.array([20, 10, 5]) / 683)
    gltf = Gltf()
    fields["emissiveTexture"] = gltf.texture(RAMP)
    material, pixels = images_of(tmp_path, gltf, fields)
    radiance = pixels(material.radiance)
    assert radiance.dtype == np.float32
    assert material.radiance.raw
    np.testing.assert_allclose(
        radiance, linear_from_srgb(RAMP / 255) * (20, 10, 5) / 683, rtol=1e-5
    )
    gltf = Gltf()
    fields["emissiveTexture"] = gltf.texture(np.zeros((2, 2, 3)))
    assert material_of(tmp_path, gltf, fields).radiance is None


def test_emission_of_the_back_is_reported_unless_it_is_hidden(tmp_path):
    fields = {"emissiveFactor": [1, 1, 1], "doubleSided": True}
    material_of(tmp_path, Gltf(), fields, "emission (from the front only)")
    gltf = Gltf()
    gltf.sphere(gltf.material(**fields), segments=16)
    read_only(gltf.save(tmp_path))


def test_normal_maps(tmp_path):
    gltf = Gltf()
    pixels = np.full((2, 2, 3), (191, 64, 230))
    fields = {"normalTexture": gltf.texture(pixels) | {"scale": 0.5}}
    material, found = images_of(tmp_path, gltf, fields)
    normal = pixels[0, 0] / 255 * 2 - 1
    normal[:2] *= 0.5
    normal /= np.linalg.norm(normal)
    assert material.normal_map.raw
    np.testing.assert_allclose(found(material.normal_map)[0, 0] / 255 * 2 - 1, normal, atol=0.005)


def test_mirrored_coordinates_get_normals_of_their_own(tmp_path):
    gltf = Gltf()
    pixels = np.full((2, 2, 3), (189, 51, 209))
    wears = gltf.material(normalTexture=gltf.texture(pixels))
    uv = np.concatenate([QUAD_UV, QUAD_UV * (-1, 1)]).astype(np.float32)
    vertices = np.concatenate([QUAD, QUAD + np.float32([3, 0, 0])])
    faces = np.concatenate([QUAD_FACES, QUAD_FACES + 4])
    gltf.node(gltf.primitive(vertices, faces, material=wears, TEXCOORD_0=uv))
    model = read_only(gltf.save(tmp_path))
    assert len(model.parts) == len(model.materials) == 2
    found = {}
    for part in model.parts:
        material = next(entry for entry in model.materials if entry.name == part.material)
        normals = model.images[material.normal_map.image]
        found[part.mesh.vertices[:, 0].min() > 1] = normals[0, 0].astype(int)
    np.testing.assert_allclose(found[False] - found[True], (0, 51 - 204, 0), atol=2)


def coloured(gltf, fields, colours):
    wears = gltf.material(**fields)
    attributes = {"TEXCOORD_0": QUAD_UV, "COLOR_0": np.asarray(colours, np.float32)}
    gltf.node(gltf.primitive(QUAD, QUAD_FACES, material=wears, **attributes))


def test_vertex_colours_times_factors(tmp_path):
    gltf = Gltf()
    fields = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 1, 0.2, 1]}, "name": "paint"}
    colours = np.eye(4)[:, :3]
    coloured(gltf, fields, colours)
    model = read_only(gltf.save(tmp_path))
    assert isinstance(model.materials[0].surface.base_color, VertexColours)
    expected = colours[QUAD_FACES.ravel()] * (0.5, 1, 0.2)
    np.testing.assert_allclose(model.parts[0].mesh.colours, expected)


def variants():
    gltf = Gltf()
    on = gltf.material(name="on", emissiveFactor=[1, 1, 1])
    off = gltf.material(name="off")
    vertices, faces = box((0, 0, 0), (1, 1, 1))
    primitive = gltf.primitive(vertices, faces, material=on)
    mappings = [{"material": on, "variants": [0]}, {"material": off, "variants": [1, 2]}]
    primitive["extensions"] = {"KHR_materials_variants": {"mappings": mappings}}
    gltf.node(primitive)
    names = [{"name": "Lamp on"}, {"name": "Lamp off"}, {"name": "Broken"}]
    gltf.json["extensions"] = {"KHR_materials_variants": {"variants": names}}
    return gltf


def test_variants(tmp_path):
    path = variants().save(tmp_path)
    for variant, name in ((None, "on"), ("Lamp on", "on"), ("Lamp off", "off"), ("Broken", "off")):
        model = read_only(path, variant=variant)
        assert [material.name for material in model.materials] == [name]


def test_unknown_variants_list_the_known(tmp_path):
    with pytest.raises(LumitreeError, match=r"no material variant 'Dim'.*Lamp on, Lamp off"):
        read_gltf(variants().save(tmp_path), variant="Dim")
    gltf = Gltf()
    gltf.quad()
    with pytest.raises(LumitreeError, match="there are: none"):
        read_gltf(gltf.save(tmp_path), variant="Dim")


@pytest.mark.parametrize("kind", ["JPEG", "WEBP"])
def test_other_image_formats(tmp_path, kind):
    gltf = Gltf()
    pixels = np.full((8, 8, 3), (200, 100, 50))
    source = gltf.image(pixels, kind)
    texture = {"source": source} if kind == "JPEG" else {
        "extensions": {"EXT_texture_webp": {"source": source}}
    }  # fmt: skip
    core = {"baseColorTexture": {"index": gltf.add("textures", **texture)}}
    material, pixels = images_of(tmp_path, gltf, {"pbrMetallicRoughness": core})
    found = material.surface.base_color
    mean = pixels(found).mean(axis=(0, 1)) if isinstance(found, Texture) else None
    expected = linear_from_srgb(np.array([200, 100, 50]) / 255)
    np.testing.assert_allclose(
        found if mean is None else linear_from_srgb(np.array(mean) / 255), expected, atol=0.02
    )


def test_textures_without_coordinates_are_reported(tmp_path):
    gltf = Gltf()
    core = {"baseColorTexture": gltf.texture(RAMP)}
    wears = gltf.material(pbrMetallicRoughness=core)
    gltf.node(gltf.primitive(QUAD, QUAD_FACES, material=wears))
    model = read_only(gltf.save(tmp_path), "without texture coordinates")
    assert not model.parts[0].mesh.uv.any()
