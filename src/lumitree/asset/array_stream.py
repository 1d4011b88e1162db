"""Arrays of a file as one zlib stream, see docs/format.md.

Arrays follow each other, little-endian and without gaps; their types and shapes are known from
elsewhere in the file. An array in *planes* is written column by column, of each column first the
lowest byte of all rows, then the next one. Integers in planes are replaced by the differences
between a row and the one before, as 2 d for d >= 0 and -2 d - 1 for d < 0. Neighbouring rows are
often alike, so that planes of high bytes are mostly zero.
"""

import math
import zlib
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lumitree.core.reading import Arrays
from lumitree.errors import LumitreeError

# For all arrays of a stream together.
MAX_BYTES = 1 << 31
_LEVEL = 6


class Layout(NamedTuple):
    """Name, type and shape of an array of a stream, and whether it is written in planes."""

    name: str
    dtype: DTypeLike
    shape: tuple[int, ...]
    planes: bool = False


def compressed(arrays: Arrays, layouts: Iterable[Layout]) -> NDArray[np.uint8]:
    """The stream [bytes] of arrays, in the order of their layouts."""
    compressor, parts = zlib.compressobj(_LEVEL), []
    for layout in layouts:
        array = np.ascontiguousarray(arrays[layout.name], np.dtype(layout.dtype).newbyteorder("<"))
        parts.append(compressor.compress(_planes(array) if layout.planes else array.tobytes()))
    return np.frombuffer(b"".join([*parts, compressor.flush()]), np.uint8)


def decompressed(stream: NDArray[np.uint8], layouts: Iterable[Layout], what: str) -> Arrays:
    """The arrays of a stream [bytes], by name; errors name the stream `what`."""
    layouts = list(layouts)
    sizes = [math.prod(each.shape) * np.dtype(each.dtype).itemsize for each in layouts]
    content = inflated(stream.tobytes(), sum(sizes), what)
    arrays, start = {}, 0
    for layout, size in zip(layouts, sizes, strict=True):
        dtype = np.dtype(layout.dtype).newbyteorder("<")
        if layout.planes:
            array = _of_planes(content[start : start + size], dtype, layout.shape)
        else:
            array = np.frombuffer(content, dtype, math.prod(layout.shape), start)
        # A copy: parts of the stream are not aligned.
        arrays[layout.name] = array.reshape(layout.shape).astype(dtype.newbyteorder("="))
        start += size
    return arrays


def inflated(content: bytes, size: int, what: str) -> bytes:
    """The `size` bytes of a zlib stream; refuses any other size."""
    if size > MAX_BYTES:
        raise LumitreeError(f"{what} has {size} bytes (limit {MAX_BYTES})")
    decompressor = zlib.decompressobj()
    try:
        # No more than is expected, however much the stream has.
        found = decompressor.decompress(content, size + 1)
    except zlib.error as error:
        raise LumitreeError(f"{what} cannot be decompressed: {error}") from None
    if len(found) != size or not decompressor.eof or decompressor.unused_data:
        raise LumitreeError(f"{what} does not decompress to {size} bytes")
    return found


def _planes(array: NDArray[np.generic]) -> bytes:
    """Bytes of an array [rows, ...] in planes."""
    if not array.size:
        return b""
    rows = array.reshape(len(array), -1)
    if np.issubdtype(rows.dtype, np.integer):
        bits = 8 * rows.dtype.itemsize
        signed = rows.view(f"<i{rows.dtype.itemsize}")
        difference = signed.copy()
        difference[1:] -= signed[:-1]
        rows = (difference << 1) ^ (difference >> (bits - 1))
    columns = np.ascontiguousarray(rows.T)
    return columns.view(np.uint8).reshape(*columns.shape, -1).transpose(0, 2, 1).tobytes()


def _of_planes(content: bytes, dtype: np.dtype, shape: tuple[int, ...]) -> NDArray[np.generic]:
    """The array of a type and shape; the inverse of `_planes`."""
    if not content:
        return np.zeros(shape, dtype)
    planes = np.frombuffer(content, np.uint8).reshape(-1, dtype.itemsize, shape[0])
    columns = np.ascontiguousarray(planes.transpose(0, 2, 1)).view(dtype)[..., 0]
    if np.issubdtype(dtype, np.integer):
        unsigned = columns.view(f"<u{dtype.itemsize}")
        difference = (unsigned >> 1) ^ (0 - (unsigned & 1))
        columns = np.cumsum(difference, axis=1, dtype=unsigned.dtype).view(dtype)
    return columns.T
