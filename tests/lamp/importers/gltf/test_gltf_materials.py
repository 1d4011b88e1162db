"""The core of glTF materials: factors, textures, opacity, emission, normals, vertex colours."""

import io

import numpy as np
import pytest
from PIL import Image

from lumitree.core.images import linear_from_srgb
from lumitree.errors import LumitreeError
from lumitree.lamp.importers.gltf import read_gltf
from lumitree.lamp.parts import Principled, Texture, VertexColour
from support.gltf_builder import QUAD, QUAD_FACES, QUAD_UV, Gltf, box
from support.gltf_materials import RAMP, extended, material_of, read_only


def test_the_default_material(tmp_path):
    gltf = Gltf()
    gltf.quad()
    (material,) = read_only(gltf.save(tmp_path)).materials
    assert material.surface == Principled((1.0, 1.0, 1.0), metallic=1.0, roughness=1.0)
    assert material.radiance is None
    assert material.opacity == 1
    assert material.normal_map is None
    assert not material.two_sided


def test_factors(tmp_path):
    core = {"baseColorFactor": [0.1, 0.2, 0.3, 1], "metallicFactor": 0.4, "roughnessFactor": 0.6}
    fields = {"pbrMetallicRoughness": core, "doubleSided": True, "name": "brass knob"}
    material = material_of(tmp_path, Gltf(), fields)
    assert material.surface == Principled((0.1, 0.2, 0.3), metallic=0.4, roughness=0.6)
    assert material.two_sided
    assert material.name == "brass_knob"


@pytest.mark.parametrize(
    "extension", [{"ior": {"ior": 1.0}}, {"specular": {"specularFactor": 0.0}}]
)
def test_surfaces_without_reflection_can_be_stored_in_an_asset(tmp_path, extension):
    from lumitree.asset.plugins import PLUGINS

    material = material_of(tmp_path, Gltf(), extended({"metallicFactor": 0.0}, **extension))
    low, high = PLUGINS["lumitree_metallic_roughness"].parameters["eta"].range
    assert low <= np.float32(material.surface.ior) <= high
    assert material.surface.ior < 1.01 or material.surface.specular == 0


def test_textures_keep_their_bytes_without_factors(tmp_path):
    gltf = Gltf()
    core = {"baseColorTexture": gltf.texture(RAMP), "metallicRoughnessTexture": gltf.texture(RAMP)}
    surface = material_of(tmp_path, gltf, {"pbrMetallicRoughness": core}).surface
    assert surface.base_color.encoded
    np.testing.assert_array_equal(surface.base_color.pixels, RAMP)
    for value, channel in ((surface.roughness, 1), (surface.metallic, 2)):
        assert not value.encoded
        np.testing.assert_array_equal(value.pixels, RAMP[..., channel : channel + 1])


def test_factors_are_baked_into_textures(tmp_path):
    gltf = Gltf()
    core = {
        "baseColorTexture": gltf.texture(RAMP),
        "baseColorFactor": [0.5, 0.25, 0, 1],
        "metallicRoughnessTexture": gltf.texture(RAMP),
        "metallicFactor": 0.5,
        "roughnessFactor": 0.25,
    }
    surface = material_of(tmp_path, gltf, {"pbrMetallicRoughness": core}).surface
    found = linear_from_srgb(surface.base_color.pixels / 255)
    np.testing.assert_allclose(found, linear_from_srgb(RAMP / 255) * (0.5, 0.25, 0), atol=0.004)
    np.testing.assert_allclose(surface.metallic.pixels, RAMP[..., 2:] * 0.5, atol=0.51)
    np.testing.assert_allclose(surface.roughness.pixels, RAMP[..., 1:2] * 0.25, atol=0.51)


def test_a_texture_of_one_value_is_a_number(tmp_path):
    gltf = Gltf()
    core = {"metallicRoughnessTexture": gltf.texture(np.full((4, 4, 3), (9, 51, 255)))}
    surface = material_of(tmp_path, gltf, {"pbrMetallicRoughness": core}).surface
    assert surface.roughness == pytest.approx(0.2)
    assert surface.metallic == 1


def test_samplers_and_transforms(tmp_path):
    gltf = Gltf()
    info = gltf.texture(RAMP, wrapS=33648, wrapT=33648, magFilter=9728)
    transform = {"offset": [0.1, 0.2], "rotation": np.pi / 2, "scale": [2, 3]}
    info["extensions"] = {"KHR_texture_transform": transform}
    core = {"baseColorTexture": info}
    texture = material_of(tmp_path, gltf, {"pbrMetallicRoughness": core}).surface.base_color
    assert (texture.wrap, texture.nearest) == ("mirror", True)
    # A quarter turn counter-clockwise, seen with v down: u goes to -v, v to u.
    at = texture.uv_transform @ np.array([[0, 1, 0], [0, 0, 1], [1, 1, 1]])
    np.testing.assert_allclose(at[:2, 0], (0.1, 0.2))
    np.testing.assert_allclose(at[:2, 1] - at[:2, 0], (0, -2), atol=1e-12)
    np.testing.assert_allclose(at[:2, 2] - at[:2, 0], (3, 0), atol=1e-12)


def test_the_example_of_the_transform_extension(tmp_path):
    """'Only the lower left quadrant of the source image, rotated clockwise 90°'."""
    gltf = Gltf()
    transform = {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}
    info = gltf.texture(RAMP) | {"extensions": {"KHR_texture_transform": transform}}
    core = {"baseColorTexture": info}
    texture = material_of(tmp_path, gltf, {"pbrMetallicRoughness": core}).surface.base_color
    corners = texture.uv_transform @ np.array([[0, 1, 0, 1], [0, 0, 1, 1], [1, 1, 1, 1]])
    assert corners[0].min() == pytest.approx(0)
    assert corners[0].max() == pytest.approx(0.5)
    assert corners[1].min() == pytest.approx(0.5)
    assert corners[1].max() == pytest.approx(1)


def test_different_wraps_are_reported(tmp_path):
    gltf = Gltf()
    core = {"baseColorTexture": gltf.texture(RAMP, wrapS=33071, wrapT=10497)}
    fields = {"pbrMetallicRoughness": core}
    texture = material_of(tmp_path, gltf, fields, "different wrapping").surface.base_color
    assert texture.wrap == "clamp"


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


def test_textures_without_coordinates_are_reported(tmp_path):
    gltf = Gltf()
    core = {"baseColorTexture": gltf.texture(RAMP)}
    wears = gltf.material(pbrMetallicRoughness=core)
    gltf.node(gltf.primitive(QUAD, QUAD_FACES, material=wears))
    model = read_only(gltf.save(tmp_path), "without texture coordinates")
    assert not model.parts[0].mesh.uv.any()


@pytest.mark.parametrize("cutoff", [0.25, 0.5])
def test_masks(tmp_path, cutoff):
    gltf = Gltf()
    pixels = np.zeros((1, 8, 4))
    pixels[..., 3] = np.arange(8) * 36
    core = {"baseColorTexture": gltf.texture(pixels), "baseColorFactor": [1, 1, 1, 0.8]}
    fields = {"pbrMetallicRoughness": core, "alphaMode": "MASK", "alphaCutoff": cutoff}
    opacity = material_of(tmp_path, gltf, fields).opacity
    expected = pixels[..., 3] / 255 * 0.8 >= cutoff
    np.testing.assert_array_equal(opacity.pixels[..., 0], 255 * expected)


def test_blending_and_opaque(tmp_path):
    core = {"baseColorFactor": [1, 1, 1, 0.3]}
    for mode, opacity in (("BLEND", 0.3), ("OPAQUE", 1), ("MASK", 0)):
        fields = {"pbrMetallicRoughness": core, "alphaMode": mode}
        assert material_of(tmp_path, Gltf(), fields).opacity == opacity
    gltf = Gltf()
    pixels = np.dstack([RAMP, RAMP[..., 0]])
    core = {"baseColorTexture": gltf.texture(pixels)}
    fields = {"pbrMetallicRoughness": core, "alphaMode": "BLEND"}
    opacity = material_of(tmp_path, gltf, fields).opacity
    np.testing.assert_array_equal(opacity.pixels, RAMP[..., :1])


def test_emission(tmp_path):
    fields = extended(emissive_strength={"emissiveStrength": 20})
    assert material_of(tmp_path, Gltf(), fields).radiance is None
    fields["emissiveFactor"] = [1, 0.5, 0.25]
    radiance = material_of(tmp_path, Gltf(), fields).radiance
    assert radiance == pytest.approx(np.array([20, 10, 5]) / 683)
    gltf = Gltf()
    fields["emissiveTexture"] = gltf.texture(RAMP)
    radiance = material_of(tmp_path, gltf, fields).radiance
    assert radiance.pixels.dtype == np.float32
    assert not radiance.encoded
    np.testing.assert_allclose(
        radiance.pixels, linear_from_srgb(RAMP / 255) * (20, 10, 5) / 683, rtol=1e-5
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
    found = material_of(tmp_path, gltf, fields).normal_map
    normal = pixels[0, 0] / 255 * 2 - 1
    normal[:2] *= 0.5
    normal /= np.linalg.norm(normal)
    assert not found.encoded
    np.testing.assert_allclose(found.pixels[0, 0] / 255 * 2 - 1, normal, atol=0.005)


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
        found[part.mesh.vertices[:, 0].min() > 1] = material.normal_map.pixels[0, 0].astype(int)
    np.testing.assert_allclose(found[False] - found[True], (0, 51 - 204, 0), atol=2)


def test_rotated_normal_maps_turn_their_vectors(tmp_path):
    gltf = Gltf()
    info = gltf.texture(np.full((2, 2, 3), (218, 128, 218)))
    info["extensions"] = {"KHR_texture_transform": {"rotation": np.pi / 2}}
    found = material_of(tmp_path, gltf, {"normalTexture": info}).normal_map
    # The image's u axis lies along the mesh's v axis, which points down: away from Mitsuba's
    # second axis.
    np.testing.assert_allclose(found.pixels[0, 0], (128, 38, 218), atol=2)


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
    assert isinstance(model.materials[0].surface.base_color, VertexColour)
    expected = colours[QUAD_FACES.ravel()] * (0.5, 1, 0.2)
    np.testing.assert_allclose(model.parts[0].mesh.colours, expected)


def test_vertex_colours_yield_to_textures(tmp_path):
    gltf = Gltf()
    core = {"baseColorTexture": gltf.texture(RAMP)}
    coloured(gltf, {"pbrMetallicRoughness": core, "name": "paint"}, np.ones((4, 3)))
    model = read_only(gltf.save(tmp_path), "material 'paint' is approximated: vertex colours")
    assert isinstance(model.materials[0].surface.base_color, Texture)
    assert model.parts[0].mesh.colours is None


def test_one_warning_lists_all_of_a_material(tmp_path):
    fields = extended(
        sheen={"sheenColorFactor": [1, 1, 1]}, iridescence={"iridescenceFactor": 1}
    ) | {"name": "silk"}
    gltf = Gltf()
    wears = gltf.material(**fields)
    gltf.quad(wears)
    gltf.sphere(wears, segments=8)
    notes = "lamp.gltf: material 'silk' is approximated: iridescence (left out); sheen"
    read_only(gltf.save(tmp_path), notes)


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


def test_sixteen_bit_and_grey_images(tmp_path):

    stream = io.BytesIO()
    Image.fromarray(np.array([[0, 32768, 65535]], np.uint16)).save(stream, "PNG")
    gltf = Gltf()
    source = gltf.add("images", bufferView=gltf.view(stream.getvalue()))
    info = {"index": gltf.add("textures", source=source)}
    core = {"metallicRoughnessTexture": info}
    surface = material_of(tmp_path, gltf, {"pbrMetallicRoughness": core}).surface
    np.testing.assert_array_equal(surface.roughness.pixels[0, :, 0], [0, 128, 255])


@pytest.mark.parametrize("kind", ["JPEG", "WEBP"])
def test_other_image_formats(tmp_path, kind):
    gltf = Gltf()
    pixels = np.full((8, 8, 3), (200, 100, 50))
    source = gltf.image(pixels, kind)
    texture = {"source": source} if kind == "JPEG" else {
        "extensions": {"EXT_texture_webp": {"source": source}}
    }  # fmt: skip
    core = {"baseColorTexture": {"index": gltf.add("textures", **texture)}}
    surface = material_of(tmp_path, gltf, {"pbrMetallicRoughness": core}).surface
    found = surface.base_color
    mean = found.pixels.mean(axis=(0, 1)) if isinstance(found, Texture) else None
    expected = linear_from_srgb(np.array([200, 100, 50]) / 255)
    np.testing.assert_allclose(
        found if mean is None else linear_from_srgb(np.array(mean) / 255), expected, atol=0.02
    )
