"""glTF files that lie about what they hold: refused with one line, before memory is made."""

import base64
import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from lumitree.errors import LumitreeWarning
from lumitree.lamp.importers import gltf_document as container
from lumitree.lamp.importers import gltf_scene as accessors
from lumitree.lamp.importers import model_files as images
from lumitree.lamp.importers.gltf import read_gltf
from support.gltf_builder import QUAD, QUAD_FACES, QUAD_UV, Gltf
from support.gltf_refusals import quad, refused, refused_json, sparse, textured


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"count": 10**12}, "claims"),
        ({"count": 5}, "claims 5 elements"),
        ({"count": 0}, "count is 0"),
        ({"byteOffset": 8}, "claims 4 elements"),
        ({"bufferView": 99}, r"bufferViews\[99\]"),
        ({"componentType": 5124}, "componentType 5124"),
        ({"type": "MAT4"}, "type 'MAT4'"),
    ],
)
def test_lying_accessors(tmp_path, change, match):
    gltf = quad()
    position = gltf.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    gltf.json["accessors"][position] |= change
    refused(gltf.save(tmp_path), match)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"byteLength": 10**9}, "claims bytes"),
        ({"byteOffset": 10**9}, "claims bytes"),
        ({"buffer": 3}, r"buffers\[3\]"),
        ({"byteStride": 4}, "4 bytes apart"),
        ({"byteStride": 10**9}, "claims 4 elements"),
    ],
)
def test_lying_buffer_views(tmp_path, change, match):
    gltf = quad()
    position = gltf.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    gltf.json["bufferViews"][gltf.json["accessors"][position]["bufferView"]] |= change
    refused(gltf.save(tmp_path), match)


def test_accessors_without_a_view_are_bounded(tmp_path, monkeypatch):
    gltf = Gltf()
    position = gltf.add("accessors", componentType=5126, count=10**10, type="VEC3")
    gltf.node({"attributes": {"POSITION": position}})
    refused(gltf.save(tmp_path), "at most")
    gltf.json["accessors"][0]["count"] = accessors.MAX_UNSTORED + 1
    refused(gltf.save(tmp_path), f"no data; at most {accessors.MAX_UNSTORED}")
    gltf.json["accessors"][0]["count"] = 6
    refused(gltf.save(tmp_path), "no triangles")


def test_accessors_over_the_same_bytes_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(accessors, "MAX_DECODED_BYTES", 200)
    gltf = quad()
    assert read_gltf(gltf.save(tmp_path)).parts
    primitive = gltf.json["meshes"][0]["primitives"][0]
    first = gltf.json["accessors"][primitive["attributes"]["POSITION"]]
    for _ in range(3):
        copy = gltf.add("accessors", **first)
        gltf.node(primitive | {"attributes": {"POSITION": copy}})
    refused(gltf.save(tmp_path), "at most 200")


def test_lying_sparse_accessors(tmp_path):
    refused(sparse(at=(4,)).save(tmp_path), "not among 4")
    refused(sparse(count=9).save(tmp_path), "replaces 9 of 4")
    refused(sparse(count=2).save(tmp_path), "claims 2 elements")
    refused(sparse(indices={}).save(tmp_path), "componentType is missing")


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["POSITION", "NORMAL", "TEXCOORD_0"])
def test_values_that_are_not_finite(tmp_path, value, name):
    arrays = {"POSITION": QUAD, "NORMAL": np.tile([0, 0, 1], (4, 1)), "TEXCOORD_0": QUAD_UV}
    arrays = {key: array.astype(np.float32) for key, array in arrays.items()}
    arrays[name][1, 0] = value
    gltf = Gltf()
    gltf.node(gltf.primitive(arrays.pop("POSITION"), QUAD_FACES, **arrays))
    refused(gltf.save(tmp_path), "not finite")


def test_indices_that_do_not_fit(tmp_path):
    for faces, match in (([[0, 1, 4]], "uses vertex 4 of 4"), ([[0, 1, 65535]], "uses vertex")):
        gltf = Gltf()
        gltf.node(gltf.primitive(QUAD, np.array(faces, np.uint16)))
        refused(gltf.save(tmp_path), match)
    gltf = Gltf()
    gltf.node(gltf.primitive(QUAD, np.array([[0, 1, 2]], np.int16)))
    refused(gltf.save(tmp_path), "not unsigned")


def test_attributes_of_another_length(tmp_path):
    gltf = Gltf()
    gltf.node(gltf.primitive(QUAD, QUAD_FACES, TEXCOORD_0=QUAD_UV[:3]))
    refused(gltf.save(tmp_path), "4 vertices, but 3 of TEXCOORD_0")


def test_nodes_that_are_no_tree(tmp_path):
    def nodes(*children, roots=(0,)):
        gltf = quad()
        gltf.json["nodes"] = [{"children": list(entry)} if entry else {} for entry in children]
        gltf.json["nodes"][0]["mesh"] = 0
        gltf.json["scenes"][0]["nodes"] = list(roots)
        return gltf.save(tmp_path)

    refused(nodes([0]), "child of another")
    refused(nodes([1], [0]), "child of another")
    refused(nodes([1], [2], [1]), "another parent")
    refused(nodes([2], [2], []), "another parent")
    refused(nodes([1, 1], []), "another parent")
    refused(nodes([7]), r"nodes\[7\]")
    refused(nodes([], roots=(0, 0)), "twice")
    refused(nodes([1], [], roots=(0, 1)), "child of another")
    refused(nodes([-1]), "indices of at least 0")
    chain = [[i + 1] for i in range(1000)] + [[]]
    refused(nodes(*chain), "deep")


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"translation": [0, 0]}, "translation .*3 numbers"),
        ({"rotation": [0, 0, 0, 0]}, "no unit quaternion"),
        ({"scale": [1, 1, 10**400]}, "scale"),
        ({"matrix": [1] * 16}, "not affine"),
        ({"mesh": "first"}, "mesh is 'first'"),
    ],
)
def test_damaged_nodes(tmp_path, fields, match):
    gltf = quad()
    gltf.json["nodes"][0] |= fields
    refused(gltf.save(tmp_path), match)


def test_triangle_limit_counts_every_copy(tmp_path, monkeypatch):
    from lumitree.lamp.importers import gltf as reader

    monkeypatch.setattr(reader, "MAX_TRIANGLES", 10)
    gltf = quad()
    for _ in range(4):
        gltf.node(mesh=0)
    assert read_gltf(gltf.save(tmp_path)).parts
    gltf.node(mesh=0)
    refused(gltf.save(tmp_path), "12 triangles; at most 10")


def bomb(width, height):
    """A PNG that claims a size and holds almost nothing."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(
            ">I", zlib.crc32(kind + data)
        )  # fmt: skip

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 100))
    return b"\x89PNG\r\n\x1a\n" + body + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    "size",
    [(8193, 8193), (60000, 60000), (2**31 - 1, 1), (16385, 2)],
)
def test_decompression_bombs(tmp_path, size):
    (tmp_path / "bomb.png").write_bytes(bomb(*size))
    refused(textured("bomb.png").save(tmp_path), "pixels")


def test_images_that_are_only_large_together(tmp_path, monkeypatch):
    """A wide image and a high one: 6 pixels each, 36 combined."""
    monkeypatch.setattr(images, "MAX_TOTAL_BYTES", 500)
    gltf = Gltf()
    ramp = np.arange(18).reshape(6, 3) * 10
    high = np.dstack([ramp[:, None], ramp[:, :1]])
    glossy = {
        "diffuseTexture": gltf.texture(ramp[None]),
        "specularGlossinessTexture": gltf.texture(high),
    }
    gltf.quad(gltf.material(extensions={"KHR_materials_pbrSpecularGlossiness": glossy}))
    refused(gltf.save(tmp_path), "what is computed from them")
    monkeypatch.setattr(images, "MAX_TOTAL_BYTES", 5000)
    with pytest.warns(LumitreeWarning):
        surface = read_gltf(gltf.save(tmp_path)).materials[0].surface
    assert surface.base_color.pixels.shape == (6, 6, 3)


def test_damaged_images(tmp_path):
    stream = io.BytesIO()
    noise = np.random.default_rng(0).integers(0, 255, (32, 32, 3), np.uint8)
    Image.fromarray(noise).save(stream, "PNG")
    whole = stream.getvalue()
    tiff = io.BytesIO()
    Image.fromarray(noise).save(tiff, "TIFF")
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 255
    for data in (b"", b"no image", whole[:200], whole[:20], tiff.getvalue(), bytes(flipped)):
        (tmp_path / "image.png").write_bytes(data)
        refused(textured("image.png").save(tmp_path), r"images\[0\].*not a readable image")
    uri = "data:image/png;base64," + base64.b64encode(whole).decode()
    assert read_gltf(textured(uri).save(tmp_path)).parts
    with pytest.warns(LumitreeWarning, match="'none.png' is not in the model's folder"):
        assert read_gltf(textured("none.png").save(tmp_path)).parts


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"textures": []}, r"textures\[0\]"),
        ({"textures": [{}]}, "no PNG, JPEG or WebP"),
        ({"textures": [{"source": 9}]}, r"images\[9\]"),
        ({"textures": [{"source": 0, "sampler": 2}]}, r"samplers\[2\]"),
        ({"images": [{}]}, "names ''"),
    ],
)
def test_damaged_textures(tmp_path, change, match):
    gltf = textured()
    gltf.json |= change
    refused(gltf.save(tmp_path), match)


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"pbrMetallicRoughness": {"metallicFactor": 2}}, r"metallicFactor is 2.*\[0, 1\]"),
        ({"pbrMetallicRoughness": {"baseColorTexture": {}}}, "index is missing"),
        ({"emissiveFactor": [-1, 0, 0]}, "emissiveFactor"),
        ({"alphaMode": "GLASS"}, "alphaMode"),
        ({"extensions": {"KHR_materials_ior": {"ior": 0.5}}}, "ior is 0.5"),
        ({"extensions": {"KHR_materials_emissive_strength": 5}}, "JSON object"),
    ],
)
def test_damaged_materials(tmp_path, fields, match):
    gltf = Gltf()
    gltf.quad(gltf.material(**fields))
    refused(gltf.save(tmp_path), match)


def test_json_of_too_many_values_is_refused_before_it_is_parsed(tmp_path):
    text = '{"asset": {"version": "2.0"}, "extras": [' + "[]," * (container.MAX_VALUES // 2) + "0]}"
    refused_json(tmp_path, text, "has more than 5,000,000 values in its JSON text; export fewer")
