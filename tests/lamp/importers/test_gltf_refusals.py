"""Damaged and hostile glTF files are refused with one line, before memory is used for them."""

import base64
import copy
import io
import json
import os
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp.importers import gltf, gltf_document, gltf_scene, model_files
from lumitree.lamp.importers.gltf import read_gltf
from support import damage
from support.gltf_builder import QUAD, QUAD_FACES, QUAD_UV, Gltf
from support.gltf_models import instanced, lit, rich, sparse


def quad():
    made = Gltf()
    made.quad()
    return made


def textured(uri=None):
    made = Gltf()
    source = made.add("images", uri=uri) if uri else made.image(np.zeros((2, 2, 3)))
    texture = {"index": made.add("textures", source=source)}
    made.quad(made.material(pbrMetallicRoughness={"baseColorTexture": texture}))
    return made


def refused(path, word=""):
    with pytest.raises(LumitreeError, match=word) as caught:
        read_gltf(path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400


def written(folder, content):
    path = folder / "lamp.gltf"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def accessor(**change):
    """A quad whose positions have other properties."""
    made = quad()
    index = made.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    made.json["accessors"][index] |= change
    return made


def view(**change):
    made = quad()
    made.json["bufferViews"][0] |= change
    return made


def node(**fields):
    made = quad()
    made.json["nodes"][0] |= fields
    return made


def tree(*children, roots=(0,)):
    made = quad()
    made.json["nodes"] = [{"children": list(entry)} if entry else {} for entry in children]
    made.json["nodes"][0]["mesh"] = 0
    made.json["scenes"][0]["nodes"] = list(roots)
    return made


def faces(*rows, dtype=np.uint16, **attributes):
    made = Gltf()
    made.node(made.primitive(QUAD, np.array(rows, dtype), **attributes))
    return made


def not_finite(name, value):
    arrays = {"POSITION": QUAD, "NORMAL": np.tile([0, 0, 1], (4, 1)), "TEXCOORD_0": QUAD_UV}
    arrays = {key: array.astype(np.float32) for key, array in arrays.items()}
    arrays[name][1, 0] = value
    made = Gltf()
    made.node(made.primitive(arrays.pop("POSITION"), QUAD_FACES, **arrays))
    return made


def material(**fields):
    made = Gltf()
    made.quad(made.material(**fields))
    return made


def unstored(count):
    made = Gltf()
    position = made.add("accessors", componentType=5126, count=count, type="VEC3")
    made.node({"attributes": {"POSITION": position}})
    return made


def cone(inner, outer):
    spot = {"innerConeAngle": inner, "outerConeAngle": outer}
    return lit({"type": "spot", "spot": spot})


def second_light():
    made = lit({"type": "point"})
    made.json["nodes"][-1]["extensions"] = {"KHR_lights_punctual": {"light": 1}}
    return made


def root(made, **fields):
    made.json |= fields
    return made


REFUSED = [
    (accessor(count=10**12), "claims"),
    (accessor(count=5), "claims 5"),
    (accessor(count=0), "count"),
    (accessor(byteOffset=8), "claims 4"),
    (accessor(bufferView=99), r"bufferViews\[99\]"),
    (accessor(componentType=5124), "componentType"),
    (accessor(type="MAT4"), "MAT4"),
    (view(byteLength=10**9), "claims bytes"),
    (view(byteOffset=10**9), "claims bytes"),
    (view(buffer=3), r"buffers\[3\]"),
    (view(byteStride=4), "4 bytes apart"),
    (view(byteStride=10**9), "claims 4"),
    (unstored(10**10), "at most"),
    (unstored(gltf_scene.MAX_UNSTORED + 1), "no data"),
    (unstored(6), "no triangles"),
    (sparse(at=(4,)), "not among 4"),
    (sparse(count=9), "replaces 9 of 4"),
    (sparse(count=2), "claims 2"),
    (sparse(indices={}), "componentType"),
    *((not_finite(name, np.nan), "not finite") for name in ("POSITION", "NORMAL", "TEXCOORD_0")),
    (not_finite("POSITION", np.inf), "not finite"),
    (faces([0, 1, 4]), "vertex 4 of 4"),
    (faces([0, 1, 65535]), "vertex"),
    (faces([0, 1, 2], dtype=np.int16), "unsigned"),
    (faces([0, 1, 2], TEXCOORD_0=QUAD_UV[:3]), "TEXCOORD_0"),
    (tree([0]), "child of another"),
    (tree([1], [0]), "child of another"),
    (tree([1], [2], [1]), "another parent"),
    (tree([2], [2], []), "another parent"),
    (tree([1, 1], []), "another parent"),
    (tree([7]), r"nodes\[7\]"),
    (tree([], roots=(0, 0)), "twice"),
    (tree([1], [], roots=(0, 1)), "child of another"),
    (tree([-1]), "children"),
    (tree(*([i + 1] for i in range(1000)), []), "deep"),
    (node(translation=[0, 0]), "translation"),
    (node(rotation=[0, 0, 0, 0]), "quaternion"),
    (node(scale=[1, 1, 10**400]), "scale"),
    (node(matrix=[1] * 16), "affine"),
    (node(mesh="first"), "mesh"),
    (root(textured(), textures=[]), r"textures\[0\]"),
    (root(textured(), textures=[{}]), "WebP"),
    (root(textured(), textures=[{"source": 9}]), r"images\[9\]"),
    (root(textured(), textures=[{"source": 0, "sampler": 2}]), r"samplers\[2\]"),
    (root(textured(), images=[{}]), "names ''"),
    (material(pbrMetallicRoughness={"metallicFactor": 2}), "metallicFactor"),
    (material(pbrMetallicRoughness={"baseColorTexture": {}}), "index"),
    (material(emissiveFactor=[-1, 0, 0]), "emissiveFactor"),
    (material(alphaMode="GLASS"), "alphaMode"),
    (material(extensions={"KHR_materials_ior": {"ior": 0.5}}), "ior"),
    (material(extensions={"KHR_materials_emissive_strength": 5}), "JSON object"),
    (lit({"type": "area"}), "type 'area'"),
    (second_light(), "names light 1, but there are 1"),
    (cone(0.5, 0.4), "innerConeAngle 0.5 and outerConeAngle 0.4"),
    (cone(0, 0), "innerConeAngle 0 and outerConeAngle 0"),
    (cone(0, 1.6), "outerConeAngle is 1.6"),
    (cone(-0.1, 0.4), "innerConeAngle is -0.1"),
    (instanced(TRANSLATION=np.zeros((3, 3), np.float32), SCALE=QUAD[:2]), r"\[2, 3\] instances"),
    (instanced(ROTATION=np.zeros((2, 4), np.float32)), "no unit quaternion"),
    (instanced(ROTATION=QUAD), "expected .* components"),
    *(
        (root(quad(), extensionsRequired=[name]), name)
        for name in ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu")
    ),
]


@pytest.mark.parametrize(("made", "word"), REFUSED)
def test_what_is_damaged_is_named(tmp_path, made, word):
    refused(made.save(tmp_path), word)


TEXTS = [
    *(("", "{", "[1]", '"x"', "{'a': 1}", '{"asset": NaN}', "\x00", '{"a": ' + "9" * 5000 + "}")),
    "[" * 200_000,
    *({"asset": {"version": version}} for version in ("1.0", "3.0", "x")),
    # Its values are counted before they are parsed.
    '{"asset": {"version": "2.0"}, "extras": [' + "[]," * (gltf_document.MAX_VALUES // 2) + "0]}",
]


@pytest.mark.parametrize("text", TEXTS, ids=range(len(TEXTS)))
def test_json_that_is_no_gltf(tmp_path, text):
    refused(written(tmp_path, text), r"lamp\.gltf")


@pytest.mark.parametrize(
    "uri", ["data:;base64,%%%", "data:;base64,AAA", "data:nothing", "data:;base64,AAAA", None]
)
def test_buffers_without_their_data(tmp_path, uri):
    refused(written(tmp_path, quad().with_buffer(*([] if uri is None else [uri]))), "data|claims")


def test_gltf_and_glb_give_the_same(tmp_path):
    text, binary = (read_gltf(quad().save(tmp_path, *name)) for name in ((), ("lamp.glb",)))
    for model in (text, binary):
        mesh = model.parts[0].mesh
        np.testing.assert_array_equal(mesh.uv[:, 0] * 2 - 1, mesh.vertices[:, 0])
    np.testing.assert_array_equal(text.parts[0].mesh.vertices, binary.parts[0].mesh.vertices)


def test_damaged_glb(tmp_path):
    good, path = quad().glb(), tmp_path / "lamp.glb"

    def with_header(magic=b"glTF", version=2, length=None, rest=good[12:]):
        path.write_bytes(struct.pack("<4sII", magic, version, length or len(good)) + rest)
        return path

    assert read_gltf(with_header()).parts
    refused(with_header(magic=b"glTX"), "begin")
    refused(with_header(version=1), "version 1")
    refused(with_header(length=len(good) + 1), "cut off")
    refused(with_header(length=16), "cut off")
    refused(with_header(rest=good[12:-8]), "cut off")
    refused(with_header(length=12, rest=b""), "JSON chunk")
    huge = struct.pack("<II", 2**32 - 1, 0x4E4F534A) + good[20:]
    refused(with_header(rest=huge), "cut off")
    path.write_bytes(b"glTF\2\0")
    refused(path, "cut off")


def test_an_unknown_extension_that_is_not_required_is_reported(tmp_path):
    made = root(quad(), extensionsUsed=["VENDOR_magic", "KHR_materials_ior"])
    with pytest.warns(LumitreeWarning, match="ignored: extension VENDOR_magic$"):
        read_gltf(made.save(tmp_path))


@pytest.mark.parametrize("uri", ["%2e%2e/secret.bin", "linked/secret.bin", "", "\ud800.bin"])
def test_nothing_outside_the_folder_is_read(tmp_path, uri):
    folder, made = tmp_path / "model", quad()
    folder.mkdir()
    (tmp_path / "secret.bin").write_bytes(bytes(made.data))
    os.symlink(tmp_path, folder / "linked")
    refused(written(folder, made.with_buffer(uri)), "model's folder")
    made = textured("placeholder.png")
    made.json["images"][0]["uri"] = uri
    if uri.startswith("link"):
        refused(made.save(folder), "model's folder")
    else:
        with pytest.warns(LumitreeWarning, match="is not in the model's folder"):
            assert read_gltf(made.save(folder)).parts


def test_files_beside_the_model_are_taken(tmp_path):
    made = quad()
    (tmp_path / "my data.bin").write_bytes(bytes(made.data))
    assert read_gltf(written(tmp_path, made.with_buffer("my%20data.bin"))).parts
    with pytest.warns(LumitreeWarning, match="'my data.bin' in the model's folder"):
        assert read_gltf(written(tmp_path, made.with_buffer("C:%5Cwork%5Cmy data.bin"))).parts


def test_huge_files_are_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf_document, "MAX_FILE_BYTES", 2000)
    for name in ("data.bin", "big.glb"):
        with open(tmp_path / name, "wb") as file:
            file.truncate(10**9)
    refused(written(tmp_path, quad().with_buffer("data.bin")), "larger")
    refused(tmp_path / "big.glb", "larger")


def test_accessors_over_the_same_bytes_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf_scene, "MAX_DECODED_BYTES", 200)
    made = quad()
    assert read_gltf(made.save(tmp_path)).parts
    primitive = made.json["meshes"][0]["primitives"][0]
    first = made.json["accessors"][primitive["attributes"]["POSITION"]]
    for _ in range(3):
        position = made.add("accessors", **first)
        made.node(primitive | {"attributes": {"POSITION": position}})
    refused(made.save(tmp_path), "at most 200")


def test_the_limit_of_triangles_counts_every_copy(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf, "MAX_TRIANGLES", 10)
    made = quad()
    for _ in range(4):
        made.node(mesh=0)
    assert read_gltf(made.save(tmp_path)).parts
    made.node(mesh=0)
    refused(made.save(tmp_path), "12 triangles")


def bomb(width, height):
    """A PNG that claims a size and holds almost nothing."""

    def chunk(kind, data):
        crc = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + crc

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 100))
    return b"\x89PNG\r\n\x1a\n" + body + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(8193, 8193), (60000, 60000), (2**31 - 1, 1), (16385, 2)])
def test_decompression_bombs(tmp_path, size):
    (tmp_path / "bomb.png").write_bytes(bomb(*size))
    refused(textured("bomb.png").save(tmp_path), "pixels")


def test_images_that_are_only_large_together(tmp_path, monkeypatch):
    """A wide image and a high one: 6 pixels each, 36 combined."""
    monkeypatch.setattr(model_files, "MAX_TOTAL_BYTES", 500)
    made = Gltf()
    ramp = np.arange(18).reshape(6, 3) * 10
    glossy = {
        "diffuseTexture": made.texture(ramp[None]),
        "specularGlossinessTexture": made.texture(np.dstack([ramp[:, None], ramp[:, :1]])),
    }
    made.quad(made.material(extensions={"KHR_materials_pbrSpecularGlossiness": glossy}))
    refused(made.save(tmp_path), "computed")
    monkeypatch.setattr(model_files, "MAX_TOTAL_BYTES", 5000)
    with pytest.warns(LumitreeWarning):
        model = read_gltf(made.save(tmp_path))
    colour = model.materials[0].surface.base_color
    assert model.images[colour.image].shape == (6, 6, 3)


def test_damaged_images(tmp_path):
    def saved(kind):
        stream = io.BytesIO()
        Image.fromarray(noise).save(stream, kind)
        return stream.getvalue()

    noise = np.random.default_rng(0).integers(0, 255, (32, 32, 3), np.uint8)
    whole = saved("PNG")
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 255
    for data in (b"", b"no image", whole[:200], whole[:20], saved("TIFF"), bytes(flipped)):
        (tmp_path / "image.png").write_bytes(data)
        refused(textured("image.png").save(tmp_path), r"images\[0\]")
    uri = "data:image/png;base64," + base64.b64encode(whole).decode()
    assert read_gltf(textured(uri).save(tmp_path)).parts


def places(value, path=()):
    """Paths of every value in a JSON document."""
    yield path
    if isinstance(value, dict | list):
        for key, entry in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(entry, (*path, key))


WRONG = (None, -1, 10**30, 1e308, True, "x", "\ud800", "\x1b" * 3000, [], [[]], {}, {"a": 1})


def test_any_wrong_value_is_refused_or_read(tmp_path):
    """At a random place of all."""
    made = rich()
    whole = made.with_buffer(made.uri())
    generator, refusals = np.random.default_rng(5), 0
    for place in list(places(whole))[::2]:
        if place:
            model, pick = copy.deepcopy(whole), generator.integers(len(WRONG))
            inner = model
            for key in place[:-1]:
                inner = inner[key]
            inner[place[-1]] = WRONG[pick]
            path, variant = written(tmp_path, model), ("v", None)[pick % 2]
            refusals += damage.refused(lambda p=path, v=variant: read_gltf(p, variant=v))
    assert refusals > 50
