"""The contents of a glTF file: its JSON, its binary chunk, and the files that it names.

trimesh has a glTF reader, but it supports none of the extensions that lamps need (transmission,
volume, emissive strength, variants, lights), and it uses the sizes and offsets that a file states
before it compares them with the file. Here everything is checked before it is used: nothing outside
the model's folder is opened, and memory is only allocated for data that the files hold.
"""

import base64
import binascii
import json
import math
import os
import reprlib
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote, unquote_to_bytes

from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, shown, shown_names
from lumitree.lamp.importers.model_files import ModelFolder

MAX_FILE_BYTES = 2**31
# Most values of the JSON text; each takes about 100 bytes of memory.
MAX_VALUES = 5_000_000
_MATERIALS = ("anisotropy", "clearcoat", "diffuse_transmission", "dispersion", "emissive_strength")
_MATERIALS += ("ior", "iridescence", "pbrSpecularGlossiness", "sheen", "specular", "transmission")
_MATERIALS += ("unlit", "variants", "volume")
SUPPORTED_EXTENSIONS = {
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    *(f"KHR_materials_{name}" for name in _MATERIALS),
}
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
# Larger lengths, factors and offsets are refused: the file is damaged. Products of two values are
# still in the range of single precision.
MAX_MAGNITUDE = 1e15


class Item:
    """A JSON object; every reader checks the type and the range of its result.

    `where` is its place in the file, for messages, such as `lamp.gltf: materials[3]`.
    """

    def __init__(self, data: Any, where: str) -> None:
        self.where = where
        if not isinstance(data, dict):
            raise self.error(f"is {_shown(data)}; expected a JSON object")
        self.data: dict[str, Any] = data

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def error(self, message: str) -> LumitreeError:
        """The error to raise: the place of the object in the file, and the message."""
        return LumitreeError(f"{self.where} {message}")

    def number(
        self, key: str, default: float, low: float = -math.inf, high: float = math.inf
    ) -> float:
        """A number in [low, high], and of at most MAX_MAGNITUDE."""
        value = self.data.get(key, default)
        if not _is_number(value, low, high):
            raise self._wrong(key, value, f"a number{_range(low, high)}")
        return float(value)

    def numbers(
        self, key: str, default: tuple[float, ...], low: float = -math.inf, high: float = math.inf
    ) -> tuple[float, ...]:
        """As many finite numbers in [low, high] as there are defaults."""
        value = self.data.get(key, default)
        listed = isinstance(value, list | tuple) and len(value) == len(default)
        if not (listed and all(_is_number(entry, low, high) for entry in value)):
            raise self._wrong(key, value, f"{len(default)} numbers{_range(low, high)}")
        return tuple(float(entry) for entry in value)

    def integer(self, key: str, default: int | None = None, low: int = 0) -> int:
        """An integer that is at least `low`; an error where it is missing without a default."""
        value = self.data.get(key, default)
        if type(value) is not int or value < low:
            raise self._wrong(key, value, f"an integer of at least {low}")
        return value

    def index(self, key: str) -> int | None:
        """An index into one of the file's lists; None where it is missing."""
        return self.integer(key) if key in self.data else None

    def indices(self, key: str) -> list[int]:
        """A list of indices; empty where it is missing."""
        value = self._list(key)
        if not all(type(entry) is int and entry >= 0 for entry in value):
            raise self._wrong(key, value, "indices of at least 0")
        return value

    def string(self, key: str, default: str) -> str:
        value = self.data.get(key, default)
        if not isinstance(value, str):
            raise self._wrong(key, value, "a string")
        return value

    def flag(self, key: str) -> bool:
        """True or false; false where it is missing."""
        value = self.data.get(key, False)
        if not isinstance(value, bool):
            raise self._wrong(key, value, "true or false")
        return value

    def item(self, key: str) -> "Item":
        """An object; an empty one where it is missing."""
        return Item(self.data.get(key, {}), f"{self.where}.{key}")

    def items(self, key: str) -> list["Item"]:
        """A list of objects; empty where it is missing."""
        return [Item(each, f"{self.where}.{key}[{i}]") for i, each in enumerate(self._list(key))]

    def strings(self, key: str) -> list[str]:
        """A list of strings; empty where it is missing."""
        value = self._list(key)
        if not all(isinstance(entry, str) for entry in value):
            raise self._wrong(key, value, "a list of strings")
        return value

    def extension(self, name: str) -> "Item | None":
        """An extension's object; None where the extension is not used here."""
        extensions = self.item("extensions")
        return extensions.item(name) if name in extensions else None

    def _list(self, key: str) -> list[Any]:
        value = self.data.get(key, [])
        if not isinstance(value, list):
            raise self._wrong(key, value, "a list")
        return value

    def _wrong(self, key: str, value: Any, expected: str) -> LumitreeError:
        found = "is missing" if value is None else f"is {_shown(value)}"
        return self.error(f"is damaged: {key} {found}; expected {expected}")


def _is_number(value: Any, low: float, high: float) -> bool:
    # bool is a kind of int; not a number compares false.
    return type(value) in (int, float) and abs(value) <= MAX_MAGNITUDE and low <= value <= high


def _range(low: float, high: float) -> str:
    return "" if low == -math.inf and high == math.inf else f" in [{low:g}, {high:g}]"


def _shown(value: Any) -> str:
    # A list of any length or depth.
    return shown(reprlib.repr(value), 40)


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
        asset = self.root.item("asset")
        version = asset.string("minVersion", asset.string("version", "none"))
        if not version.startswith("2."):
            raise LumitreeError(f"{self.name} is glTF version {shown(version, 20)!r}; need 2.0")
        required = set(self.root.strings("extensionsRequired"))
        if missing := sorted(required - SUPPORTED_EXTENSIONS):
            raise LumitreeError(
                f"{self.name} requires {shown_names(missing)}, which lumitree cannot read; "
                "export it without (no mesh compression, PNG or JPEG textures)"
            )
        self.unknown_extensions = sorted(
            set(self.root.strings("extensionsUsed")) - SUPPORTED_EXTENSIONS
        )

    def entry(self, kind: str, index: int) -> Item:
        """Entry of one of the file's lists, such as `materials`."""
        entries = self.root.data.get(kind, [])
        if not isinstance(entries, list):
            raise self.root.error(f"{kind} is not a list; the file is damaged")
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


def _split(path: Path, name: str, data: bytes) -> tuple[bytes, bytes | None]:
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
        if at + 8 + size > length:
            raise damaged
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if _JSON_CHUNK not in chunks:
        raise LumitreeError(f"{name} is a GLB file without a JSON chunk; it is damaged")
    return chunks[_JSON_CHUNK], chunks.get(_BINARY_CHUNK)


def _parse(text: bytes, name: str) -> Any:
    if sum(map(text.count, b"[{,")) > MAX_VALUES:
        raise LumitreeError(
            f"{name} has more than {MAX_VALUES:,} values in its JSON text; export fewer objects"
        )

    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is not a JSON number")

    try:
        return json.loads(text.decode("utf-8-sig"), parse_constant=refuse)
    except RecursionError:
        raise LumitreeError(f"{name} is nested too deeply to be a glTF file") from None
    except ValueError as error:
        raise LumitreeError(f"{name} is not valid JSON: {shown(error, 120)}") from None


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


class Notes:
    """Collects remarks about a file and about each of its materials."""

    def __init__(self, name: str) -> None:
        self._name = name
        # Dictionaries, because sets do not keep their order.
        self._file: dict[str, None] = {}
        self._materials: dict[str, dict[str, None]] = {}

    def file(self, text: str) -> None:
        """Note something in the file that is ignored."""
        self._file[text] = None

    def material(self, name: str, text: str) -> None:
        """Note a property of a material that is approximated."""
        self._materials.setdefault(name, {})[text] = None

    def lines(self) -> Iterator[str]:
        """One line for the file and one for each material, for which there are notes."""
        if self._file:
            yield f"{self._name}: ignored: {'; '.join(self._file)}"
        for name, texts in self._materials.items():
            yield f"{self._name}: material {shown(name)!r} is approximated: {'; '.join(texts)}"
