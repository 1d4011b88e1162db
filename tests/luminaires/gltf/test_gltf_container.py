"""Damaged and hostile glTF files are refused with one clear line, and nothing else is read."""

import base64
import contextlib
import copy
import io
import json
import os
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from gltf_builder import QUAD, QUAD_FACES, QUAD_UV, Gltf
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.luminaires.gltf import accessors, container, images, read_gltf


def quad():
    gltf = Gltf()
    gltf.quad()
    return gltf


def textured(uri=None):
    gltf = Gltf()
    source = gltf.add("images", uri=uri) if uri else gltf.image(np.zeros((2, 2, 3)))
    texture = {"index": gltf.add("textures", source=source)}
    gltf.quad(gltf.material(pbrMetallicRoughness={"baseColorTexture": texture}))
    return gltf


def refused(path, match):
    with pytest.raises(LumitreeError, match=match) as caught:
        read_gltf(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def refused_json(folder, content, match):
    path = folder / "lamp.gltf"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    refused(path, match)


def test_gltf_and_glb_give_the_same(tmp_path):
    text, binary = read_gltf(quad().save(tmp_path)), read_gltf(quad().save(tmp_path, "lamp.glb"))
    for model in (text, binary):
        np.testing.assert_array_equal(model.parts[0].mesh.uv[:, 0] * 2 - 1,
                                      model.parts[0].mesh.vertices[:, 0])  # fmt: skip
    np.testing.assert_array_equal(text.parts[0].mesh.vertices, binary.parts[0].mesh.vertices)


def test_buffer_beside_the_file(tmp_path):
    gltf = quad()
    (tmp_path / "my data.bin").write_bytes(gltf.data)
    path = tmp_path / "lamp.gltf"
    path.write_text(json.dumps(gltf.with_buffer("my%20data.bin")))
    assert len(read_gltf(path).parts[0].mesh.faces) == 2


def test_missing_file(tmp_path):
    refused(tmp_path / "none.gltf", "does not exist")
    refused(tmp_path, "does not exist")


@pytest.mark.parametrize(
    "text",
    ["", "{", "[1]", '"x"', "{'a': 1}", '{"asset": NaN}', "\x00", '{"a": ' + "9" * 5000 + "}"],
)
def test_malformed_json(tmp_path, text):
    refused_json(tmp_path, text, r"lamp\.gltf.*(not valid JSON|expected a JSON object)")


def test_json_that_is_not_utf8(tmp_path):
    (tmp_path / "lamp.gltf").write_bytes(b'{"asset": "\xff"}')
    refused(tmp_path / "lamp.gltf", "not valid JSON")


def test_deeply_nested_json(tmp_path):
    refused_json(tmp_path, "[" * 200_000, "nested too deeply|not valid JSON")


@pytest.mark.parametrize("version", ["1.0", "3.0", "x"])
def test_other_versions(tmp_path, version):
    refused_json(tmp_path, {"asset": {"version": version}}, "version .*need 2.0")


def test_required_extensions(tmp_path):
    for name in ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu"):
        gltf = quad()
        gltf.json["extensionsRequired"] = [name]
        refused(gltf.save(tmp_path), f"requires {name}")


def test_unknown_extension_that_is_not_required_is_told(tmp_path):
    gltf = quad()
    gltf.json["extensionsUsed"] = ["VENDOR_magic", "KHR_materials_ior"]
    with pytest.warns(LumitreeWarning, match="ignored: extension VENDOR_magic$"):
        read_gltf(gltf.save(tmp_path))


def test_damaged_glb(tmp_path):
    good = quad().glb()
    path = tmp_path / "lamp.glb"

    def with_header(magic=b"glTF", version=2, length=None, rest=good[12:]):
        path.write_bytes(struct.pack("<4sII", magic, version, length or len(good)) + rest)
        return path

    assert read_gltf(with_header()).parts
    refused(with_header(magic=b"glTX"), "does not begin with 'glTF'")
    refused(with_header(version=1), "version 1; need 2")
    refused(with_header(length=len(good) + 1), "cut off")
    refused(with_header(length=16), "cut off")
    refused(with_header(rest=good[12:-8]), "cut off")
    refused(with_header(length=12, rest=b""), "without a JSON chunk")
    huge = struct.pack("<II", 2**32 - 1, 0x4E4F534A) + good[20:]
    refused(with_header(rest=huge), "cut off")
    path.write_bytes(b"glTF\2\0")
    refused(path, "cut off")


@pytest.mark.parametrize(
    "uri",
    [
        "../secret.bin",
        "sub/../../secret.bin",
        "%2e%2e/secret.bin",
        "..%2Fsecret.bin",
        "..\\secret.bin",
        "%2Fetc/passwd",
        "/etc/passwd",
        "file:///etc/passwd",
        "file:secret.bin",
        "http://example.org/a.bin",
        "C:/secret.bin",
        "link.bin",
        "linked/secret.bin",
        "a%00b",
        "",
        ".",
    ],
)
@pytest.mark.parametrize("kind", ["buffer", "image"])
def test_nothing_outside_the_folder_is_read(tmp_path, uri, kind):
    folder = tmp_path / "model"
    folder.mkdir()
    gltf = quad()
    (tmp_path / "secret.bin").write_bytes(bytes(gltf.data))
    os.symlink(tmp_path / "secret.bin", folder / "link.bin")
    os.symlink(tmp_path, folder / "linked")
    match = "model's folder"
    if kind == "buffer":
        refused_json(folder, gltf.with_buffer(uri), match)
    else:
        gltf = textured("placeholder.png")
        gltf.json["images"][0]["uri"] = uri
        refused(gltf.save(folder), match)


def test_links_inside_the_folder_are_followed(tmp_path):
    gltf = quad()
    (tmp_path / "data.bin").write_bytes(gltf.data)
    os.symlink("data.bin", tmp_path / "link.bin")
    path = tmp_path / "lamp.gltf"
    path.write_text(json.dumps(gltf.with_buffer("link.bin")))
    assert read_gltf(path).parts


def test_special_files_are_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.bin")
    refused_json(tmp_path, quad().with_buffer("pipe.bin"), "not in the model's folder")


def test_huge_files_are_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(container, "MAX_FILE_BYTES", 2000)
    with open(tmp_path / "data.bin", "wb") as file:
        file.truncate(10**9)
    refused_json(tmp_path, quad().with_buffer("data.bin"), "brings the model to .* at most 2000")
    with open(tmp_path / "big.glb", "wb") as file:
        file.truncate(10**9)
    refused(tmp_path / "big.glb", "larger than 2000")


def test_damaged_data_uris(tmp_path):
    for uri in ("data:;base64,%%%", "data:;base64,AAA", "data:nothing"):
        refused_json(tmp_path, quad().with_buffer(uri), "data URI")
    refused_json(tmp_path, quad().with_buffer("data:;base64,AAAA"), "only 3 are there")


def test_buffer_without_data(tmp_path):
    refused_json(tmp_path, quad().with_buffer(), "has no data")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"count": 10**12}, "claims"),
        ({"count": 5}, "claims 5 elements"),
        ({"count": -1}, "count is -1"),
        ({"count": 0}, "count is 0"),
        ({"count": 1.5}, "count is 1.5"),
        ({"count": True}, "count is True"),
        ({"byteOffset": 8}, "claims 4 elements"),
        ({"byteOffset": 10**18}, "claims 4 elements"),
        ({"bufferView": 99}, r"bufferViews\[99\]"),
        ({"bufferView": -1}, "bufferView is -1"),
        ({"componentType": 5124}, "componentType 5124"),
        ({"type": "MAT4"}, "type 'MAT4'"),
        ({"type": "SCALAR"}, "type 'SCALAR'"),
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


def sparse(count=1, at=(2,), **change):
    gltf = Gltf()
    where = {"bufferView": gltf.view(np.array(at, np.uint16).tobytes()), "componentType": 5123}
    new = {"bufferView": gltf.view(np.full((len(at), 3), 7, np.float32).tobytes())}
    fields = {"count": count, "indices": where, "values": new} | change
    index = gltf.accessor(QUAD, sparse=fields)
    gltf.node(gltf.primitive(QUAD, QUAD_FACES) | {"attributes": {"POSITION": index}})
    return gltf


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
    refused(nodes([-1]), "children is -1")
    chain = [[i + 1] for i in range(1000)] + [[]]
    refused(nodes(*chain), "deep")


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"translation": [0, 0]}, "translation .*3 numbers"),
        ({"translation": "left"}, "translation"),
        ({"rotation": [0, 0, 0, 0]}, "no unit quaternion"),
        ({"scale": [1, 1, 10**400]}, "scale"),
        ({"matrix": [1] * 15}, "matrix"),
        ({"mesh": "first"}, "mesh is 'first'"),
        ({"mesh": 4}, r"meshes\[4\]"),
        ({"extensions": 3}, "extensions"),
    ],
)
def test_damaged_nodes(tmp_path, fields, match):
    gltf = quad()
    gltf.json["nodes"][0] |= fields
    refused(gltf.save(tmp_path), match)


def test_infinite_numbers(tmp_path):
    gltf = quad()
    gltf.json["nodes"][0]["scale"] = ["HUGE"] * 3
    text = gltf.save(tmp_path).read_text().replace('"HUGE"', "1e999")
    refused_json(tmp_path, text, "scale is")


def test_damaged_structure(tmp_path):
    for key in ("scenes", "nodes", "meshes", "accessors", "bufferViews"):
        for wrong in ({"a": 1}, [None], "x"):
            refused_json(tmp_path, quad().with_buffer() | {key: wrong}, "lamp.gltf")


def test_triangle_limit_counts_every_copy(tmp_path, monkeypatch):
    from lumitree.luminaires.gltf import reader

    monkeypatch.setattr(reader, "MAX_TRIANGLES", 10)
    gltf = quad()
    for _ in range(4):
        gltf.node(mesh=0)
    assert read_gltf(gltf.save(tmp_path)).parts
    gltf.node(mesh=0)
    refused(gltf.save(tmp_path), "12 triangles; at most 10")


def test_scene_without_triangles(tmp_path):
    refused_json(tmp_path, {"asset": {"version": "2.0"}}, "no triangles")


def bomb(width, height):
    """A PNG that claims a size and holds almost nothing."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(
            ">I", zlib.crc32(kind + data)
        )  # fmt: skip

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 100))
    return b"\x89PNG\r\n\x1a\n" + body + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(8193, 8193), (10000, 10000), (60000, 60000), (2**31 - 1, 1)])
def test_decompression_bombs(tmp_path, size):
    (tmp_path / "bomb.png").write_bytes(bomb(*size))
    refused(textured("bomb.png").save(tmp_path), "pixels")


def test_total_of_pixels(tmp_path, monkeypatch):
    monkeypatch.setattr(images, "MAX_TOTAL_PIXELS", 7)
    gltf = Gltf()
    pixels = np.random.default_rng(0).integers(0, 255, (2, 2, 3))
    core = {"baseColorTexture": gltf.texture(pixels)}
    gltf.quad(gltf.material(pbrMetallicRoughness=core, emissiveTexture=core["baseColorTexture"]))
    assert read_gltf(gltf.save(tmp_path)).parts
    gltf.json["materials"][0]["emissiveTexture"] = gltf.texture(pixels)
    gltf.json["materials"][0]["emissiveFactor"] = [1, 1, 1]
    refused(gltf.save(tmp_path), "8 pixels; at most 7")


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
        refused(textured("image.png").save(tmp_path), r"images\[0\].*can be read")
    uri = "data:image/png;base64," + base64.b64encode(whole).decode()
    assert read_gltf(textured(uri).save(tmp_path)).parts
    refused(textured("none.png").save(tmp_path), "not in the model's folder")


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
        ({"pbrMetallicRoughness": {"baseColorFactor": [1, 1]}}, "baseColorFactor"),
        ({"pbrMetallicRoughness": {"metallicFactor": 2}}, r"metallicFactor is 2.*\[0, 1\]"),
        ({"pbrMetallicRoughness": {"roughnessFactor": None}}, "roughnessFactor is missing"),
        ({"pbrMetallicRoughness": {"baseColorTexture": {}}}, "index is missing"),
        ({"emissiveFactor": [-1, 0, 0]}, "emissiveFactor"),
        ({"alphaMode": "GLASS"}, "alphaMode"),
        ({"doubleSided": 1}, "doubleSided"),
        ({"name": 3}, "name is 3"),
        ({"extensions": {"KHR_materials_ior": {"ior": 0.5}}}, "ior is 0.5"),
        ({"extensions": {"KHR_materials_volume": {"attenuationDistance": 0}}}, "Distance is 0"),
        ({"extensions": {"KHR_materials_emissive_strength": 5}}, "JSON object"),
    ],
)
def test_damaged_materials(tmp_path, fields, match):
    gltf = Gltf()
    gltf.quad(gltf.material(**fields))
    refused(gltf.save(tmp_path), match)


def test_names_cannot_leave_the_folder_or_the_xml(tmp_path):
    gltf = Gltf()
    name = '../../etc/$passwd"><evil/>'
    gltf.quad(gltf.material(name=name), name=name)
    gltf.quad(gltf.material(name=name), name=name)
    gltf.quad(name="é" * 500)
    model = read_gltf(gltf.save(tmp_path))
    names = [part.name for part in model.parts] + [entry.name for entry in model.materials]
    assert all(entry.replace("_", "").isalnum() and entry.isascii() for entry in names)
    assert all(len(entry) < 64 for entry in names)
    assert len({part.name for part in model.parts}) == 3
    assert len({entry.name for entry in model.materials}) == 3


def rich():
    """A small file that uses everything."""
    gltf = Gltf()
    pixels = np.random.default_rng(1).integers(0, 255, (2, 2, 4))
    info = gltf.texture(pixels, wrapS=33071, magFilter=9728)
    info["extensions"] = {"KHR_texture_transform": {"offset": [0, 1], "rotation": 1.0}}
    extensions = {
        "transmission": {"transmissionFactor": 0.5, "transmissionTexture": info},
        "volume": {"thicknessFactor": 1, "attenuationColor": [1, 0, 1], "attenuationDistance": 1},
        "clearcoat": {"clearcoatFactor": 1, "clearcoatNormalTexture": info},
        "anisotropy": {"anisotropyStrength": 1, "anisotropyTexture": info},
        "sheen": {"sheenColorFactor": [1, 1, 1]},
        "specular": {"specularFactor": 0.5, "specularColorTexture": info},
        "ior": {"ior": 1.3},
        "emissive_strength": {"emissiveStrength": 3},
        "iridescence": {"iridescenceFactor": 1},
    }
    first = gltf.material(
        pbrMetallicRoughness={"baseColorTexture": info, "metallicRoughnessTexture": info},
        normalTexture=info | {"scale": 0.5},
        emissiveFactor=[1, 1, 1],
        emissiveTexture=info,
        alphaMode="MASK",
        extensions={f"KHR_materials_{name}": value for name, value in extensions.items()},
    )
    glossy = {"diffuseTexture": info, "specularGlossinessTexture": info, "glossinessFactor": 0.5}
    second = gltf.material(extensions={"KHR_materials_pbrSpecularGlossiness": glossy})
    gltf.quad(first, rotation=[0, 0, 0, 1], scale=[1, 2, 1], translation=[0, 0, 1])
    mappings = {"KHR_materials_variants": {"mappings": [{"material": second, "variants": [0]}]}}
    gltf.json["meshes"][0]["primitives"][0]["extensions"] = mappings
    gltf.node(mesh=0, matrix=np.eye(4).ravel().tolist())
    gltf.node(children=[])
    gltf.node(extensions={"KHR_lights_punctual": {"light": 0}})
    sparse_quad = sparse().json["accessors"][0]["sparse"]
    sparse_quad["indices"]["bufferView"] = gltf.view(np.array([2], np.uint16).tobytes())
    sparse_quad["values"]["bufferView"] = gltf.view(np.zeros(3, np.float32).tobytes())
    gltf.json["accessors"][0]["sparse"] = sparse_quad
    gltf.json["extensions"] = {
        "KHR_lights_punctual": {"lights": [{"type": "spot", "color": [1, 1, 1], "intensity": 2}]},
        "KHR_materials_variants": {"variants": [{"name": "v"}]},
    }
    return gltf


def places(value, path=()):
    """Paths of every value in a JSON document."""
    yield path
    if isinstance(value, dict | list):
        for key, entry in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(entry, (*path, key))


WRONG = (None, -1, 10**30, 1e308, True, "x", [], [[]], {}, {"a": 1})


@pytest.mark.filterwarnings("ignore::lumitree.errors.LumitreeWarning")
def test_any_wrong_value_is_refused_or_read(tmp_path):
    """Whatever stands anywhere in the JSON, no other exception escapes."""
    gltf = rich()
    whole = gltf.with_buffer(gltf.uri())
    path = tmp_path / "lamp.gltf"
    generator = np.random.default_rng(5)
    refusals = []
    for place in places(whole):
        for pick in generator.choice(len(WRONG), 3, replace=False) if place else ():
            damaged = copy.deepcopy(whole)
            parent = damaged
            for key in place[:-1]:
                parent = parent[key]
            parent[place[-1]] = WRONG[pick]
            path.write_text(json.dumps(damaged))
            try:
                read_gltf(path, variant=("v", None)[pick % 2])
            except LumitreeError as error:
                refusals.append(str(error))
    assert len(refusals) > 300
    assert not any("\n" in text for text in refusals)


@pytest.mark.filterwarnings("ignore::lumitree.errors.LumitreeWarning")
def test_flipped_bytes_are_refused_or_read(tmp_path):
    whole = rich().glb()
    assert len(read_gltf(rich().save(tmp_path), variant="v").parts) == 3
    path = tmp_path / "lamp.glb"
    generator = np.random.default_rng(2)
    for _ in range(300):
        damaged = bytearray(whole)
        for at in generator.integers(0, len(whole), 3):
            damaged[at] = generator.integers(0, 256)
        path.write_bytes(damaged[: generator.integers(1, 2 * len(whole))])
        with contextlib.suppress(LumitreeError):
            read_gltf(path)
