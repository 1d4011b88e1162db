"""The geometry of an asset as tensors of its file, see docs/format.md.

Shapes, materials and the sizes of images are one JSON text. Images follow each other as bytes,
which are compressed: each byte of a row minus the one a pixel before it, as PNG's filter "Sub",
then by zlib.
"""

import json
import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.geometry import (
    ARRAYS,
    MAX_IMAGE_BYTES,
    MAX_IMAGE_SIDE,
    MAX_IMAGES,
    MAX_SHAPES,
    NO_ORIGIN,
    AssetGeometry,
)
from lumitree.asset.textures import Json
from lumitree.core.reading import Record, parse_json
from lumitree.errors import LumitreeError

_DTYPES = {np.float32: "F32", np.uint32: "U32"}
GEOMETRY_SHAPES = "geometry.shapes"
GEOMETRY_TENSORS = {
    GEOMETRY_SHAPES: "U8",
    "geometry.images": "U8",
    **{f"geometry.{name}": _DTYPES[dtype] for name, (dtype, _) in ARRAYS.items()},  # type: ignore[index]
}
# Largest JSON text; a shape takes about 200 bytes.
_MAX_TEXT = 1 << 24
_PIXELS: dict[str, Any] = {"uint8": np.uint8, "float32": np.dtype("<f4")}


def geometry_tensors(geometry: AssetGeometry) -> dict[str, NDArray[Any]]:
    """Tensors of an asset's geometry, by name."""
    description = {
        "images": [{"shape": list(i.shape), "dtype": str(i.dtype)} for i in geometry.images],
        "materials": list(geometry.materials),
        "shapes": list(geometry.shapes),
        **({} if geometry.origin == NO_ORIGIN else {"origin": list(geometry.origin)}),
    }
    text = json.dumps(description, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return {
        GEOMETRY_SHAPES: np.frombuffer(text.encode(), np.uint8),
        "geometry.images": np.frombuffer(_compressed(geometry.images), np.uint8),
        **{f"geometry.{name}": array for name, array in geometry.arrays.items()},
    }


def build_geometry(tensors: dict[str, NDArray[Any]]) -> AssetGeometry:
    """The geometry of a file's tensors; the inverse of `geometry_tensors`.

    Raises:
        LumitreeError: the geometry is invalid.
    """
    text = tensors[GEOMETRY_SHAPES].tobytes()
    if len(text) > _MAX_TEXT:
        raise LumitreeError(f"the geometry's description has {len(text)} bytes (limit {_MAX_TEXT})")
    description = Record(parse_json(text), "the geometry")
    description.expect_keys("images", "materials", "shapes", optional=("origin",))
    has_origin = description.has("origin")
    x, y, z = description.array("origin", 3).tolist() if has_origin else NO_ORIGIN
    return AssetGeometry(
        **{name: tensors[f"geometry.{name}"] for name in ARRAYS},
        images=_images(description.items("images"), tensors["geometry.images"].tobytes()),
        shapes=tuple(description.items("shapes")[: MAX_SHAPES + 1]),
        materials=tuple(description.items("materials")),
        origin=(x, y, z),
    )


def _compressed(images: tuple[NDArray[Any], ...]) -> bytes:
    """All images as bytes; none for no image."""
    compressor, parts = zlib.compressobj(6), []
    for image in images:
        content = image.astype(_PIXELS[str(image.dtype)])
        differences = _rows(content).copy()
        differences[:, 1:] -= _rows(content)[:, :-1]
        parts.append(compressor.compress(differences.tobytes()))
    return b"".join([*parts, compressor.flush()]) if images else b""


def _decompressed(content: bytes, size: int) -> bytes:
    """The bytes of all images, of which there are `size`."""
    if not size and not content:
        return b""
    decompressor = zlib.decompressobj()
    try:
        # No more than is expected, whatever the stream holds.
        found = decompressor.decompress(content, size + 1)
    except zlib.error as error:
        raise LumitreeError(f"the images of the geometry cannot be decompressed: {error}") from None
    if len(found) != size or not decompressor.eof or decompressor.unused_data:
        raise LumitreeError(f"the images of the geometry do not decompress to {size} bytes")
    return found


def _rows(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Bytes [H, W, channels and bytes of each] of an image."""
    return image.view(np.uint8).reshape(*image.shape[:2], -1)


def _images(descriptions: list[Json], content: bytes) -> tuple[NDArray[Any], ...]:
    if len(descriptions) > MAX_IMAGES:
        raise LumitreeError(f"the geometry has {len(descriptions)} images (limit {MAX_IMAGES})")
    layouts = [_layout(each) for each in descriptions]
    sizes = [math.prod(shape) * dtype.itemsize for shape, dtype in layouts]
    if (total := sum(sizes)) > MAX_IMAGE_BYTES:
        raise LumitreeError(f"images of the geometry have {total} bytes (limit {MAX_IMAGE_BYTES})")
    content = _decompressed(content, total)
    images, start = [], 0
    for (shape, dtype), size in zip(layouts, sizes, strict=True):
        differences = np.frombuffer(content, dtype, math.prod(shape), start).reshape(shape)
        rows = np.cumsum(_rows(differences), axis=1, dtype=np.uint8)
        pixels = rows.view(dtype).reshape(shape)
        images.append(pixels.astype(dtype.newbyteorder("="), copy=False))
        start += size
    return tuple(images)


def _layout(description: Json) -> tuple[tuple[int, ...], Any]:
    """Shape and type of an image."""
    record = Record(description, "an image")
    record.expect_keys("shape", "dtype")
    dtype = np.dtype(_PIXELS[record.choice("dtype", tuple(_PIXELS))])
    shape = tuple(record.integers("shape"))
    if len(shape) != 3 or not all(0 < side <= MAX_IMAGE_SIDE for side in shape):
        raise LumitreeError(f"an image of the geometry has the shape {str(shape)[:60]}")
    return shape, dtype
