"""The contents of a glTF file: its JSON, its binary chunk, and the files that it names.

trimesh has a glTF reader, but it supports none of the extensions that lamps need (transmission,
volume, emissive strength, variants, lights), and it uses the sizes and offsets that a file states
before it compares them with the file. Here everything is checked before it is used: nothing outside
the model's folder is opened, and memory is only allocated for data that the files hold.
"""

import base64
import binascii
import json
import os
import struct
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote, unquote_to_bytes

from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, shown, shown_names
from lumitree.lamp.importers.gltf.item import Item
from lumitree.lamp.importers.model_folder import ModelFolder

MAX_FILE_BYTES = 2**31
# Most values of the JSON text; each takes about 100 bytes of memory.
MAX_VALUES = 5_000_000
SUPPORTED_EXTENSIONS = frozenset(
    {
        "EXT_mesh_gpu_instancing",
        "EXT_texture_webp",
        "KHR_lights_punctual",
        "KHR_materials_anisotropy",
        "KHR_materials_clearcoat",
        "KHR_materials_diffuse_transmission",
        "KHR_materials_dispersion",
        "KHR_materials_emissive_strength",
        "KHR_materials_ior",
        "KHR_materials_iridescence",
        "KHR_materials_pbrSpecularGlossiness",
        "KHR_materials_sheen",
        "KHR_materials_specular",
        "KHR_materials_transmission",
        "KHR_materials_unlit",
        "KHR_materials_variants",
        "KHR_materials_volume",
        "KHR_mesh_quantization",
        "KHR_texture_transform",
    }
)
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942


class Document:
    """An opened glTF file.

    `unknown_extensions` are used but not required by the file, and not supported by lumitree.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        path = Path(path)
        self.name = shown(path.name)
        self._folder = ModelFolder(path)
        content = read_bytes(path, "a glTF file", MAX_FILE_BYTES)
        text, self._binary = _split(path, self.name, content)
        self.root = Item(_parse(text, self.name), f"{self.name}:")
        self._buffers: dict[int, bytes] = {}
        self._held = len(text) + len(self._binary or b"")
        self._check_version()
        required = set(self.root.strings("extensionsRequired"))
        if missing := sorted(required - SUPPORTED_EXTENSIONS):
            raise LumitreeError(
                f"{self.name} requires {shown_names(missing)}, which lumitree cannot read; "
                "export it without (no mesh compression, PNG or JPEG textures)"
            )
        self.unknown_extensions = sorted(
            set(self.root.strings("extensionsUsed")) - SUPPORTED_EXTENSIONS
        )
        self._lists: dict[str, list[Any]] = {}

    def entry(self, kind: str, index: int) -> Item:
        """Entry of one of the file's lists, such as `materials`."""
        if kind not in self._lists:
            entries = self.root.data.get(kind, [])
            if not isinstance(entries, list):
                raise self.root.error(f"{kind} is not a list; the file is damaged")
            self._lists[kind] = entries
        entries = self._lists[kind]
        if index >= len(entries):
            raise self.root.error(f"{kind}[{index}] is named, but there are {len(entries)}")
        return Item(entries[index], f"{self.name}: {kind}[{index}]")

    def view(self, index: int) -> tuple[memoryview, int | None]:
        """Bytes of a buffer view, and the distance between its elements where it is given."""
        item = self.entry("bufferViews", index)
        buffer = self._buffer(item.integer("buffer"))
        start, length = item.integer("byteOffset", 0), item.integer("byteLength", low=1)
        if start + length > len(buffer):
            raise item.error(
                f"claims bytes {start} to {start + length} of a buffer of {len(buffer)} bytes"
            )
        stride = item.integer("byteStride") if "byteStride" in item else None
        return memoryview(buffer)[start : start + length], stride

    def is_missing(self, item: Item) -> bool:
        """Whether an item's `uri` names a file that is not in the model's folder."""
        uri = item.string("uri", "data:")
        return not uri.startswith("data:") and self._file(uri, item) is None

    def resource(self, item: Item) -> bytes:
        """Content of an item's `uri`: a data URI, or a file in the model's folder."""
        uri = item.string("uri", "")
        if uri.startswith("data:"):
            return _data_uri(uri, item)
        path = self._file(uri, item)
        if path is None:
            raise item.error(f"names {shown(uri)!r}, which is not in the model's folder")
        data = read_bytes(path, "another file of the model", MAX_FILE_BYTES - self._held)
        self._held += len(data)
        return data

    def _file(self, uri: str, item: Item) -> Path | None:
        return self._folder.find(unquote(uri), item.where)

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            item = self.entry("buffers", index)
            length = item.integer("byteLength", low=1)
            if "uri" in item:
                data = self.resource(item)
            elif index == 0 and self._binary is not None:
                data = self._binary
            else:
                raise item.error("has no data: neither a uri nor a binary chunk")
            if length > len(data):
                raise item.error(f"claims {length} bytes, but only {len(data)} are there")
            self._buffers[index] = data[:length]
        return self._buffers[index]

    def _check_version(self) -> None:
        asset = self.root.item("asset")
        version = asset.string("minVersion", asset.string("version", "none"))
        if not version.startswith("2."):
            raise LumitreeError(f"{self.name} is glTF version {shown(version, 20)!r}; need 2.0")


def _split(path: Path, name: str, data: bytes) -> tuple[bytes, bytes | None]:
    """JSON and binary chunk of a file's bytes."""
    if data[:4] != b"glTF":
        if path.suffix.lower() == ".glb":
            raise LumitreeError(f"{name} is not a GLB file: it does not begin with 'glTF'")
        return data, None
    damaged = LumitreeError(
        f"{name} is a damaged GLB file: it is cut off, or its lengths are wrong"
    )
    if len(data) < 12:
        raise damaged
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise LumitreeError(f"{name} is GLB version {version}; need 2")
    if length > len(data):
        raise damaged
    chunks: dict[int, bytes] = {}
    at = 12
    while at < length:
        if at + 8 > length:
            raise damaged
        size, kind = struct.unpack_from("<II", data, at)
        at += 8
        if at + size > length:
            raise damaged
        chunks.setdefault(kind, data[at : at + size])
        at += size
    if _JSON_CHUNK not in chunks:
        raise LumitreeError(f"{name} is a GLB file without a JSON chunk; it is damaged")
    return chunks[_JSON_CHUNK], chunks.get(_BINARY_CHUNK)


def _parse(text: bytes, name: str) -> Any:
    if sum(map(text.count, b"[{,")) > MAX_VALUES:
        raise LumitreeError(
            f"{name} has more than {MAX_VALUES:,} values in its JSON text; export fewer objects"
        )
    try:
        return json.loads(text.decode("utf-8-sig"), parse_constant=_refuse_constant)
    except RecursionError:
        raise LumitreeError(f"{name} is nested too deeply to be a glTF file") from None
    except ValueError as error:
        raise LumitreeError(f"{name} is not valid JSON: {shown(error, 120)}") from None


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")


def _data_uri(uri: str, item: Item) -> bytes:
    head, comma, body = uri.partition(",")
    if not comma:
        raise item.error("holds a data URI without data")
    if not head.endswith(";base64"):
        return unquote_to_bytes(body)
    try:
        return base64.b64decode(unquote(body), validate=True)
    except (binascii.Error, ValueError) as error:
        raise item.error(f"holds a damaged data URI: {error}") from None
