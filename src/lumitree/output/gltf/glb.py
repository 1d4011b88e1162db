"""Binary glTF files: a JSON object and the bytes that it refers to."""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.textures import Json
from lumitree.core.files import json_text

VERTICES, INDICES = 34962, 34963
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}
_COMPONENTS = {"float32": 5126, "uint16": 5123, "uint32": 5125}
_MAGIC, _VERSION, _JSON, _BINARY = b"glTF", 2, b"JSON", b"BIN\0"
_ALIGNMENT = 4


class Glb:
    """A file that grows call by call; `json` lacks `buffers` and `extensionsUsed`."""

    def __init__(self, generator: str) -> None:
        asset = {"version": "2.0", "generator": generator}
        self.json: Json = {"asset": asset, "scene": 0, "scenes": [{"nodes": []}]}
        self._data = bytearray()
        self._used: set[str] = set()

    def add(self, kind: str, item: Json) -> int:
        """Add an item to a list, such as "nodes"; returns its index."""
        items = self.json.setdefault(kind, [])
        items.append(item)
        return len(items) - 1

    def add_of_extension(self, extension: str, kind: str, item: Json) -> int:
        """Add an item to a list of an extension of the file; returns its index."""
        self._used.add(extension)
        items = self.json.setdefault("extensions", {}).setdefault(extension, {})
        items.setdefault(kind, []).append(item)
        return len(items[kind]) - 1

    def extend(self, item: Json, extension: str, values: Json) -> None:
        """Add an extension to an item."""
        self._used.add(extension)
        item.setdefault("extensions", {})[extension] = values

    def view(self, data: bytes, target: int | None = None) -> int:
        """Add bytes; returns the index of their buffer view."""
        self._data += b"\0" * (-len(self._data) % _ALIGNMENT)
        view: Json = {"buffer": 0, "byteOffset": len(self._data), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self._data += data
        return self.add("bufferViews", view)

    def accessor(self, array: NDArray[Any], target: int) -> int:
        """Add numbers [N] or [N, 2 or 3], with their bounds; returns the index of the accessor."""
        columns = array.reshape(len(array), -1)
        return self.add(
            "accessors",
            {
                "bufferView": self.view(np.ascontiguousarray(array).tobytes(), target),
                "componentType": _COMPONENTS[array.dtype.name],
                "count": len(array),
                "type": _TYPES[columns.shape[1]],
                "min": columns.min(axis=0).tolist(),
                "max": columns.max(axis=0).tolist(),
            },
        )

    def content(self) -> bytes:
        """The file."""
        self._data += b"\0" * (-len(self._data) % _ALIGNMENT)
        made = dict(self.json)
        if self._data:
            made["buffers"] = [{"byteLength": len(self._data)}]
        if self._used:
            made["extensionsUsed"] = sorted(self._used)
        text = json_text(made).encode()
        text += b" " * (-len(text) % _ALIGNMENT)
        chunks = struct.pack("<I4s", len(text), _JSON) + text
        if self._data:
            chunks += struct.pack("<I4s", len(self._data), _BINARY) + bytes(self._data)
        return struct.pack("<4sII", _MAGIC, _VERSION, 12 + len(chunks)) + chunks
