"""OBJ and glTF models with their materials, images and overrides."""

import base64
import functools
import io
import json
import struct
import zlib

import numpy as np
from PIL import Image

from fuzz import json_trees, words
from fuzz.reader import MEBIBYTE, Reader
from fuzz.tables import changed_toml
from fuzz.values import chance, pick
from lumitree.lamp.read_source import read_model
from support.damage import damaged
from support.gltf_models import rich
from support.obj_files import obj_model

_OBJ_WORDS = (b"f", b"v", b"vt", b"vn", b"usemtl", b"mtllib", b"g", b"o", b"s", b"l", b"\\", b"vp")
_MTL_WORDS = (
    *(b"newmtl", b"Kd", b"Ks", b"Ke", b"Tf", b"Ni", b"Ns", b"d", b"Tr", b"illum", b"map_Kd", b"Pr"),
    *(b"map_Ke", b"map_d", b"map_Bump", b"norm", b"-s", b"-o", b"-bm", b"-clamp", b"refl", b"Pm"),
    *(b"spectral", b"xyz", b"glass", b"shade", b"bulb"),
)
_EXTENSIONS = (
    *("KHR_materials_volume", "KHR_materials_ior", "KHR_materials_unlit", "KHR_texture_basisu"),
    *("KHR_draco_mesh_compression", "EXT_mesh_gpu_instancing", "KHR_mesh_quantization", "sparse"),
    *("extensions", "extensionsRequired", "children", "mesh", "matrix", "indices", "byteStride"),
    *("normalized", "skin", "camera", "mode", "targets", "uri", "bufferView", "texCoord"),
)


@functools.cache
def images():
    """Small images of several formats by their name."""
    pixels = np.random.default_rng(0).integers(0, 255, (4, 6, 4), np.uint8)
    kinds = {
        "image.png": ("PNG", pixels, {}),
        "grey.png": ("PNG", pixels[..., 0].astype(np.uint16) * 200, {}),
        "palette.png": ("PNG", pixels[..., 0], {}),
        "image.jpg": ("JPEG", pixels[..., :3], {"quality": 90}),
        "image.bmp": ("BMP", pixels[..., :3], {}),
        "image.tga": ("TGA", pixels, {}),
        "image.tif": ("TIFF", pixels, {}),
        "image.webp": ("WEBP", pixels, {}),
        "image.gif": ("GIF", pixels[..., 0], {}),
    }
    result = {}
    for name, (kind, array, options) in kinds.items():
        stream, image = io.BytesIO(), Image.fromarray(array)
        image = image.convert("P") if name.startswith("palette") else image
        image.save(stream, kind, **options)
        result[name] = stream.getvalue()
    return result


def changed_image(rng, name, content):
    """Bytes of an image with other numbers in its chunks, whose checksums are right, or damaged."""
    if content.startswith(b"\x89PNG") and chance(rng, 0.7):
        return _changed_png(content, rng)
    if chance(rng, 0.1):
        return pick(rng, list(images().values()))
    return words.flipped(content, rng)


def _changed_png(content, rng):
    """A PNG image of the same chunks in part, with right sums."""
    chunks, at = [], 8
    while at + 12 <= len(content):
        size = struct.unpack(">I", content[at : at + 4])[0]
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + size]))
        at += 12 + size
    # An earlier change may have left none.
    for _ in range(int(rng.integers(1, 3)) if chunks else 0):
        index = int(rng.integers(len(chunks)))
        kind, data = chunks[index]
        match int(rng.integers(5)):
            case 0:
                chunks.insert(int(rng.integers(len(chunks) + 1)), chunks[index])
            case 1 if len(chunks) > 1:
                del chunks[index]
            case 2 if kind == b"IHDR":
                sides = [pick(rng, (0, 1, 4, 6, 9000, 16385, 65536, 2**31 - 1)) for _ in range(2)]
                rest = bytes(pick(rng, (0, 1, 2, 3, 4, 6, 8, 16, 255)) for _ in range(2))
                chunks[index] = (kind, struct.pack(">II", *sides) + rest + data[10:])
            case _:
                chunks[index] = (kind, words.flipped(data, rng))
    return content[:8] + b"".join(map(_png_chunk, chunks))


def _png_chunk(chunk):
    kind, data = chunk
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@functools.cache
def _obj_files():
    return obj_model() | images()


def _obj(rng):
    """An OBJ model, one or two of whose files are changed."""
    files = dict(_obj_files())
    if chance(rng, 0.3):
        # Another image in place of that of the materials.
        other = pick(rng, list(images()))
        files["lamp.mtl"] = files["lamp.mtl"].replace(b"image.png", other.encode())
    for _ in range(pick(rng, (1, 1, 2))):
        name = pick(rng, ("lamp.obj", "lamp.obj", "lamp.mtl", "lamp.mtl", "lamp.toml", "image"))
        if name == "image":
            # An earlier change may have left none.
            used = [each for each in images() if each.encode() in files["lamp.mtl"]]
            name = pick(rng, used or ["lamp.obj"])
        content = files[name]
        if name in images():
            files[name] = changed_image(rng, name, content)
        elif name == "lamp.toml":
            files[name] = changed_toml(content, rng)
        else:
            keys = _OBJ_WORDS if name == "lamp.obj" else _MTL_WORDS
            separators = (b" ", b" ", b"/") if name == "lamp.obj" else (b" ",)
            files[name] = damaged(content, rng, separators, keys)
    used = [name for name in images() if name.encode() in files["lamp.mtl"]]
    return {name: files[name] for name in ("lamp.obj", "lamp.mtl", "lamp.toml", *used)}


@functools.cache
def _gltf():
    gltf = rich()
    return json.dumps(gltf.with_buffer()), bytes(gltf.data)


def _changed_gltf(rng):
    """A glTF model whose JSON, buffer or container is changed; the others fit."""
    text, data = _gltf()
    tree = json_trees.tree_of(json.loads(text))
    name = pick(rng, ("lamp.glb", "lamp.gltf"))
    if chance(rng, 0.25):
        data = _changed_buffer(data, json.loads(text), rng)
    else:
        tree = json_trees.changed(json.loads(text), rng, keys=_EXTENSIONS)
    if name == "lamp.gltf":
        return _with_uri(tree, data, rng)
    text = json_trees.written(tree)
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = [(0x4E4F534A, text), (0x004E4942, data)]
    if chance(rng, 0.05):
        chunks = pick(rng, (chunks[::-1], chunks[:1], chunks + chunks[1:], [(1, b"abcd"), *chunks]))
    body = b"".join(struct.pack("<II", len(part), kind) + part for kind, part in chunks)
    version = pick(rng, (2,) * 200 + (1, 0, 2**31))
    content = struct.pack("<4sII", b"glTF", version, 12 + len(body)) + body
    return {name: words.flipped(content, rng) if chance(rng, 0.1) else content}


def _with_uri(tree, data, rng):
    """A `.gltf` file with its buffer in the text or beside it."""
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    files = {}
    if chance(rng, 0.3):
        uri = pick(rng, ("lamp.bin", "LAMP.BIN", "./lamp.bin", "lamp%2ebin"))
        files["lamp.bin"] = data
    if chance(rng, 0.05):
        uri = words.flipped(uri.encode(), rng).decode("latin-1")
    for key, value in tree:
        if key == "buffers" and isinstance(value, list) and value:
            first = value[0]
            if isinstance(first, json_trees.Members):
                first.append(["uri", uri])
    content = json_trees.written(tree)
    return {"lamp.gltf": damaged(content, rng) if chance(rng, 0.1) else content} | files


def _changed_buffer(data, model, rng):
    """The buffer with other numbers in one of the views, by the type of its accessor."""
    kinds = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
    accessor = pick(rng, model["accessors"])
    view = model["bufferViews"][accessor.get("bufferView", 0)]
    start, size = view.get("byteOffset", 0), view["byteLength"]
    if chance(rng, 0.3):
        view = model["bufferViews"][pick(rng, [i["bufferView"] for i in model["images"]])]
        start, size = view.get("byteOffset", 0), view["byteLength"]
        image = changed_image(rng, "image.png", data[start : start + size])
        return data[:start] + image[:size].ljust(size, b"\0") + data[start + size :]
    kind = np.dtype(kinds[accessor["componentType"]])
    size -= size % kind.itemsize
    values = words.changed_array(np.frombuffer(data, kind, size // kind.itemsize, start), rng)
    return data[:start] + values.tobytes() + data[start + size :]


def _read_model(folder):
    model = next(each for each in sorted(folder.iterdir()) if each.suffix in _SUFFIXES)
    return model, read_model(model)


_SUFFIXES = (".obj", ".gltf", ".glb")


def _sound_model(found):
    _, geometry = found
    names = {material.name for material in geometry.materials}
    assert geometry.parts
    for part in geometry.parts:
        mesh = part.mesh
        assert part.material in names
        assert np.isfinite(mesh.vertices).all()
        assert len(mesh.faces) > 0
        assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
        assert mesh.normals is None or mesh.normals.shape == mesh.vertices.shape


def _use_model(found):
    """Loaded by Mitsuba, stored as the geometry of an asset, and shown."""
    from fuzz.rendering import assert_lamp_renders

    assert_lamp_renders(found[0])


_LIMITS = {"memory": 2048 * MEBIBYTE, "in_suite": 120, "full_share": 1 / 100}
READERS = (
    Reader("obj", _obj, _read_model, _sound_model, _use_model, **_LIMITS),
    Reader("gltf", _changed_gltf, _read_model, _sound_model, _use_model, **_LIMITS),
)
