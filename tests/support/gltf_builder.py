"""Small glTF files made in code."""

import base64
import io
import json
import struct

import numpy as np
from PIL import Image

from lumitree.lamp.meshes import lathe

_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
_COMPONENTS = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}

QUAD = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
QUAD_FACES = np.array([[0, 1, 2], [0, 2, 3]], np.uint16)
# v = 0 at the top of the quad, where an image has its first row.
QUAD_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)


class Gltf:
    """A glTF file with one buffer and one scene, grown call by call."""

    def __init__(self):
        self.json = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}
        self.data = bytearray()

    def add(self, kind, **fields):
        """An entry of one of the lists; returns its index."""
        self.json.setdefault(kind, []).append(fields)
        return len(self.json[kind]) - 1

    def view(self, data, **fields):
        self.data += b"\0" * (-len(self.data) % 4)
        at = len(self.data)
        self.data += data
        return self.add("bufferViews", buffer=0, byteOffset=at, byteLength=len(data), **fields)

    def accessor(self, values, **fields):
        values = np.asarray(values)
        length = 1 if values.ndim == 1 else values.shape[1]
        return self.add(
            "accessors",
            bufferView=self.view(values.tobytes()),
            componentType=_COMPONENTS[values.dtype.char],
            count=len(values),
            type=_TYPES[length],
            **fields,
        )

    def primitive(self, vertices, faces=None, *, material=None, **attributes):
        """JSON of a primitive; attributes are arrays, or indices of accessors."""
        attributes = {"POSITION": np.asarray(vertices, np.float32), **attributes}
        found = {
            name: value if isinstance(value, int) else self.accessor(value)
            for name, value in attributes.items()
        }
        primitive = {"attributes": found}
        if faces is not None:
            primitive["indices"] = self.accessor(np.ravel(faces))
        if material is not None:
            primitive["material"] = material
        return primitive

    def node(self, *primitives, **fields):
        """A root node with a mesh of these primitives."""
        if primitives:
            fields["mesh"] = self.add("meshes", primitives=list(primitives))
        index = self.add("nodes", **fields)
        self.json["scenes"][0]["nodes"].append(index)
        return index

    def quad(self, material=None, **fields):
        """A square of side 2 that faces +z, with texture coordinates."""
        attributes = {"TEXCOORD_0": QUAD_UV} | fields.pop("attributes", {})
        primitive = self.primitive(QUAD, QUAD_FACES, material=material, **attributes)
        return self.node(primitive, **fields)

    def sphere(self, material=None, *, radius=1.0, segments=48, inside_out=False, **fields):
        mesh = sphere(radius, segments)
        faces = mesh.faces[:, ::-1] if inside_out else mesh.faces
        normals = -mesh.normals if inside_out else mesh.normals
        primitive = self.primitive(
            mesh.vertices,
            faces.astype(np.uint32),
            material=material,
            NORMAL=normals.astype(np.float32),
        )
        return self.node(primitive, **fields)

    def material(self, **fields):
        return self.add("materials", **fields)

    def image(self, pixels, kind="PNG"):
        """An embedded image [H, W, C]; returns its index."""
        stream = io.BytesIO()
        Image.fromarray(np.asarray(pixels, np.uint8)).save(stream, kind)
        return self.add(
            "images", bufferView=self.view(stream.getvalue()), mimeType=f"image/{kind.lower()}"
        )

    def texture(self, pixels, **sampler):
        """Texture info of an image [H, W, C]."""
        texture = {"source": self.image(pixels)}
        if sampler:
            texture["sampler"] = self.add("samplers", **sampler)
        return {"index": self.add("textures", **texture)}

    def save(self, folder, name="lamp.gltf"):
        """Write `.gltf` with a data URI, or `.glb`; returns the path."""
        path = folder / name
        if name.endswith(".glb"):
            path.write_bytes(self.glb())
        else:
            path.write_text(json.dumps(self.with_buffer(self.uri())))
        return path

    def uri(self):
        return "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()

    def with_buffer(self, uri=None):
        buffer = {"byteLength": len(self.data)} | ({} if uri is None else {"uri": uri})
        return self.json | ({"buffers": [buffer]} if self.data else {})

    def glb(self):
        text = json.dumps(self.with_buffer()).encode()
        text += b" " * (-len(text) % 4)
        data = bytes(self.data) + b"\0" * (-len(self.data) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(data), 0x004E4942) + data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def sphere(radius=1.0, segments=48):
    angle = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
    profile = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    profile[[0, -1], 0] = 0.0
    return lathe(profile, segments)


def box(low, high):
    """Vertices and outward faces of a box."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    low, high = np.asarray(low, np.float32), np.asarray(high, np.float32)
    faces = [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]  # fmt: skip
    return low + corners * (high - low), np.array(faces, np.uint16)
