"""Checks of the mesh files of a scene, before Mitsuba reads them.

Mitsuba 3.9 does not check the vertices of faces in PLY and serialized files, nor the numbers of
elements that they state: a damaged file ends the process. Of OBJ files it does.

A PLY file has records of a fixed size: Mitsuba reads lists of three entries only.
"""

import math
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, shown

_MAX_BYTES = 1 << 32
# Numbers of vertices and of faces are 32 bits.
_MAX_COUNT = (1 << 32) - 1
_MAX_HEADER, _MAX_LINES = 1 << 16, 1000
_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2"},
    **{"ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"},
    **{"long": "i8", "ulong": "u8", "half": "f2", "float16": "f2", "float": "f4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_SERIALIZED, _VERSIONS = 0x041C, (3, 4)
_NORMALS, _TEXCOORDS, _COLOURS, _DOUBLE = 0x1, 0x2, 0x8, 0x2000
_MAX_NAME = 1 << 16


class _Element(NamedTuple):
    """An element of a PLY file: its name and number, and its fields with their NumPy types."""

    name: str
    number: int
    fields: list[tuple[str, str]]


def check_mesh_file(plugin: str, path: Path, index: int = 0) -> None:
    """Refuse a mesh file with which Mitsuba would end the process.

    Args:
        plugin: of the shape; only "ply" and "serialized" are checked.
        path: of the file; what is missing is left to Mitsuba.
        index: of the mesh in a serialized file.

    Raises:
        LumitreeError: the file is damaged.
    """
    check = _CHECKS.get(plugin)
    if check is None or not os.path.isfile(path):
        return
    try:
        check(read_bytes(path, "a mesh", _MAX_BYTES), index)
    except LumitreeError as error:
        raise LumitreeError(f"{shown(path, 300)} is a damaged mesh: {error}") from None


def _check_ply(content: bytes, _index: int) -> None:
    order, elements, start = _header(content)
    counts = {each.name: each.number for each in elements}
    if len(counts) < len(elements) or max(counts.values(), default=0) > _MAX_COUNT:
        raise LumitreeError("it repeats an element, or states more than 4 billion of them")
    vertices = counts.get("vertex", 0)
    if not order:
        _check_text(content[start:], elements, vertices)
        return
    for each in elements:
        kind = np.dtype([(f"{i}", order + code) for i, (_, code) in enumerate(each.fields)])
        if each.number * kind.itemsize > len(content) - start:
            raise LumitreeError(f"it is cut off: it states {each.number} {shown(each.name, 40)}")
        if each.name == "face" and kind.itemsize:
            records = np.frombuffer(content, kind, each.number, start)
            for i, (name, _) in enumerate(each.fields):
                if name == _ENTRY:
                    _check_faces(records[f"{i}"], vertices)
        start += each.number * kind.itemsize


def _check_text(text: bytes, elements: list[_Element], vertices: int) -> None:
    words = text.split()
    total = sum(each.number * len(each.fields) for each in elements)
    if total != len(words):
        raise LumitreeError(f"it has {len(words)} numbers, where it states {total}")
    start = 0
    for each in elements:
        width = len(each.fields)
        stop = start + each.number * width
        if each.name == "face":
            for i, (name, _) in enumerate(each.fields):
                if name == _ENTRY:
                    _check_faces(_integers(words[start + i : stop : width]), vertices)
        start = stop


def _integers(words: list[bytes]) -> NDArray[np.int64]:
    try:
        return np.array([int(word) for word in words], np.int64)
    except (ValueError, OverflowError):
        raise LumitreeError("the vertices of a face are no integers") from None


# Name of the three entries of a list.
_ENTRY = "[]"


def _header(content: bytes) -> tuple[str, list[_Element], int]:
    """Byte order, empty for text; the elements; and where they begin."""
    order, elements, start = None, list[_Element](), 0
    for _ in range(_MAX_LINES):
        end = content.find(b"\n", start, start + _MAX_HEADER)
        if end < 0:
            break
        words = content[start:end].decode("latin-1").split()
        start = end + 1
        try:
            match words:
                case ["format", kind, _]:
                    order = _FORMATS[kind]
                case ["element", name, count]:
                    elements.append(_Element(name, _count(count), []))
                case ["property", "list", kind, entry, _]:
                    elements[-1].fields.append(("", _TYPES[kind]))
                    elements[-1].fields.extend([(_ENTRY, _TYPES[entry])] * 3)
                case ["property", kind, name]:
                    elements[-1].fields.append((name, _TYPES[kind]))
                case ["end_header"] if order is not None:
                    return order, elements, start
                case [] | ["ply"] | ["comment", *_]:
                    pass
                case _:
                    break
        except (KeyError, IndexError):
            break
    raise LumitreeError("its header is no header of a PLY file")


def _count(word: str) -> int:
    if not (word.isascii() and word.isdigit() and len(word) < 20):
        raise LumitreeError(f"it states {shown(word, 40)!r} elements; expected a number")
    return int(word)


def _check_faces(indices: NDArray[Any], vertices: int) -> None:
    if indices.size and not ((indices >= 0) & (indices < vertices)).all():
        raise LumitreeError(f"a face has a vertex that is not among its {vertices}")


def _check_serialized(content: bytes, index: int) -> None:
    try:
        magic, version = struct.unpack_from("<HH", content)
        if magic != _SERIALIZED or version not in _VERSIONS or index < 0:
            # Mitsuba says what is wrong.
            return
        stream = _Stream(content[_start_of(content, version, index) + 4 :])
        (flags,) = struct.unpack("<I", stream.read(4))
        for _ in range(_MAX_NAME if version == 4 else 0):
            if stream.read(1) == b"\0":
                break
        vertices, faces = struct.unpack("<QQ", stream.read(16))
    except (struct.error, zlib.error) as error:
        raise LumitreeError(f"it cannot be decompressed ({type(error).__name__})") from None
    numbers = 3 + 3 * bool(flags & _NORMALS) + 2 * bool(flags & _TEXCOORDS)
    numbers += 3 * bool(flags & _COLOURS)
    size = vertices * numbers * (8 if flags & _DOUBLE else 4)
    if max(vertices, faces) > _MAX_COUNT or size + 12 * faces > _MAX_BYTES:
        raise LumitreeError(f"it states {vertices} vertices and {faces} faces")
    try:
        stream.skip(size)
        entries = np.frombuffer(stream.read(12 * faces), "<u4")
    except zlib.error as error:
        raise LumitreeError(f"it cannot be decompressed ({type(error).__name__})") from None
    _check_faces(entries, vertices)


def _start_of(content: bytes, version: int, index: int) -> int:
    """Where a mesh begins, by the list at the end of the file."""
    if index == 0:
        return 0
    (count,) = struct.unpack_from("<I", content, len(content) - 4)
    width, code = (8, "<Q") if version == 4 else (4, "<I")
    place = len(content) - 4 - width * (count - index)
    if not 0 < index < count or place < 0:
        raise LumitreeError(f"it has {count} meshes; number {index} is not among them")
    start = struct.unpack_from(code, content, place)[0]
    if start > len(content) - 4:
        raise LumitreeError("a mesh begins behind its end")
    return start


class _Stream:
    """A zlib stream that is read in parts."""

    def __init__(self, content: bytes) -> None:
        self._decompressor, self._rest = zlib.decompressobj(), content

    def read(self, size: int) -> bytes:
        """As many bytes.

        Raises:
            LumitreeError: there are fewer.
        """
        parts, left = [], size
        while left > 0:
            part = self._decompressor.decompress(self._rest, left)
            self._rest = self._decompressor.unconsumed_tail
            if not part:
                raise LumitreeError("it is cut off")
            parts.append(part)
            left -= len(part)
        return b"".join(parts)

    def skip(self, size: int) -> None:
        """Read as many bytes, and forget them."""
        for _ in range(math.ceil(size / _BLOCK)):
            self.read(min(_BLOCK, size))
            size -= _BLOCK


_BLOCK = 1 << 20
_CHECKS: dict[str, Callable[[bytes, int], None]] = {
    "ply": _check_ply,
    "serialized": _check_serialized,
}
