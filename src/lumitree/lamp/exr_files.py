"""A check of OpenEXR images of a scene, before Mitsuba reads them.

Mitsuba 3.9 reads the chunks of an image in other threads, where an error ends the process: also of
a file that is cut off, as after an interrupted download. So all chunks have to be in the file, and
each has to be the one that the table of chunks promises. Of a tiled image with several levels these
are the chunks of the first level, which Mitsuba reads.
"""

import math
import os
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

from lumitree.errors import LumitreeError, shown

_MAGIC = b"v/1\x01"
_TILED, _DEEP, _PARTS = 0x200, 0x800, 0x1000
# Scan lines of a chunk, by compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB.
_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)
_MAX_HEADER, _MAX_CHUNKS, _MAX_PARTS = 1 << 24, 1 << 22, 1 << 10
_MAX_SIDE = 1 << 26
_Header = dict[bytes, bytes]


def check_exr_file(path: Path) -> None:
    """Refuse an OpenEXR image with which Mitsuba would end the process.

    Args:
        path: of a file; what is missing or no OpenEXR image is left to Mitsuba.

    Raises:
        LumitreeError: parts of the image are missing.
    """
    if not os.path.isfile(path):
        return
    try:
        with path.open("rb") as file:
            if file.read(4) == _MAGIC:
                _check(file, os.fstat(file.fileno()).st_size)
    except (struct.error, IndexError, KeyError, ZeroDivisionError):
        raise LumitreeError(f"{shown(path, 300)} is a damaged OpenEXR image") from None
    except LumitreeError as error:
        raise LumitreeError(f"{shown(path, 300)} is a damaged OpenEXR image: {error}") from None


def _check(file: BinaryIO, size: int) -> None:
    (version,) = struct.unpack("<I", file.read(4))
    if version & _DEEP:
        raise LumitreeError("it has deep data, which Mitsuba does not read")
    several = bool(version & _PARTS)
    headers = list(_headers(file, several))
    for part, header in enumerate(headers):
        tiled = header[b"type"].startswith(b"tiled") if several else bool(version & _TILED)
        places = _tiles(header) if tiled else _lines(header)
        first = len(places)
        # Required of several parts only, of which the tables follow each other.
        listed = first
        if b"chunkCount" in header:
            (listed,) = struct.unpack("<i", header[b"chunkCount"])
        _check_count(listed)
        if listed < first:
            raise LumitreeError(f"it states {listed} chunks, where it has {first}")
        table = struct.unpack(f"<{listed}Q", file.read(8 * listed))
        after = file.tell()
        # A chunk begins with its part, its place, and its size.
        numbers = several + (4 if tiled else 1) + 1
        for place, offset in zip(places, table[:first], strict=True):
            if not 0 < offset <= size - 4 * numbers:
                raise LumitreeError("it is cut off, or was not written to its end")
            file.seek(offset)
            *found, length = struct.unpack(f"<{numbers}i", file.read(4 * numbers))
            if found != [part] * several + list(place):
                raise LumitreeError("its chunks are mixed up")
            if not 0 <= length <= size - offset - 4 * numbers:
                raise LumitreeError("it is cut off")
        file.seek(after)


def _headers(file: BinaryIO, several: bool) -> Iterator[_Header]:
    """Values of the attributes of each part, by name."""
    for _ in range(_MAX_PARTS if several else 1):
        header: _Header = {}
        while name := _text(file):
            _text(file)
            (size,) = struct.unpack("<i", file.read(4))
            if not 0 <= size <= _MAX_HEADER:
                raise LumitreeError("its header is damaged")
            header[name] = file.read(size)
        # An empty header ends those of several parts.
        if several and not header:
            return
        yield header


def _text(file: BinaryIO) -> bytes:
    result = bytearray()
    while len(result) < 256:
        byte = file.read(1)
        if not byte:
            raise LumitreeError("it is cut off")
        if byte == b"\0":
            return bytes(result)
        result += byte
    raise LumitreeError("its header is damaged")


def _lines(header: _Header) -> Sequence[tuple[int]]:
    """First line of each chunk of a part with scan lines."""
    top, _, height = _window(header)
    lines = _LINES[header[b"compression"][0]]
    _check_count(math.ceil(height / lines))
    return [(top + line,) for line in range(0, height, lines)]


def _tiles(header: _Header) -> Sequence[tuple[int, int, int, int]]:
    """Column, row, and levels of each chunk of the first level of a tiled part."""
    across, down, _ = struct.unpack("<IIB", header[b"tiles"])
    _, width, height = _window(header)
    columns, rows = math.ceil(width / across), math.ceil(height / down)
    _check_count(columns * rows)
    return [(column, row, 0, 0) for row in range(rows) for column in range(columns)]


def _check_count(chunks: int) -> None:
    if chunks > _MAX_CHUNKS:
        raise LumitreeError(f"it states {chunks:,} chunks")


def _window(header: _Header) -> tuple[int, int, int]:
    """First line, width and height, pixels."""
    left, top, right, bottom = struct.unpack("<4i", header[b"dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if not (0 < width <= _MAX_SIDE and 0 < height <= _MAX_SIDE):
        raise LumitreeError(f"it has {width} x {height} pixels")
    return top, width, height
