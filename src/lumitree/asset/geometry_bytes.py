"""The geometry of an asset as tensors of its file, see docs/format.md.

Shapes, materials and the sizes of arrays and images are one JSON text. Arrays are one stream, in
planes (`array_stream`). Images follow each other as bytes, which are compressed: each byte of a row
minus the one a pixel before it, as PNG's filter "Sub", then by zlib.
"""

import json
import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.array_stream import Layout, compressed, decompressed, inflated
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

GEOMETRY_SHAPES = "geometry.shapes"
GEOMETRY_TENSORS = {GEOMETRY_SHAPES: "U8", "geometry.stream": "U8", "geometry.images": "U8"}
_MAX_ROWS = 1 << 28
# Largest JSON text; a shape takes about 200 bytes.
_MAX_TEXT = 1 << 24
_PIXELS: dict[str, Any] = {"uint8": np.uint8, "float32": np.dtype("<f4")}


def geometry_tensors(geometry: AssetGeometry) -> dict[str, NDArray[Any]]:
    """Tensors of an asset's geometry, by name."""
    arrays = geometry.arrays
    description = {
        "arrays": {name: len(array) for name, array in arrays.items()},
        "images": [{"shape": list(i.shape), "dtype": str(i.dtype)} for i in geometry.images],
        "materials": list(geometry.materials),
        "shapes": list(geometry.shapes),
        **({} if geometry.origin == NO_ORIGIN else {"origin": list(geometry.origin)}),
    }
    text = json.dumps(description, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return {
        GEOMETRY_SHAPES: np.frombuffer(text.encode(), np.uint8),
        "geometry.images": np.frombuffer(_compressed(geometry.images), np.uint8),
        "geometry.stream": compressed(arrays, _layouts({n: len(a) for n, a in arrays.items()})),
    }


def build_geometry(tensors: dict[str, NDArray[Any]]) -> AssetGeometry:
    """The geometry of a file's tensors, checked; the inverse of `geometry_tensors`."""
    text = tensors[GEOMETRY_SHAPES].tobytes()
    if len(text) > _MAX_TEXT:
        raise LumitreeError(f"the geometry's description has {len(text)} bytes (limit {_MAX_TEXT})")
    description = Record(parse_json(text), "the geometry")
    description.expect_keys("arrays", "images", "materials", "shapes", optional=("origin",))
    rows = description.record("arrays")
    rows.expect_keys(*ARRAYS)
    layouts = _layouts({name: rows.integer(name) for name in ARRAYS})
    has_origin = description.has("origin")
    x, y, z = description.array("origin", 3).tolist() if has_origin else NO_ORIGIN
    return AssetGeometry(
        **decompressed(tensors["geometry.stream"], layouts, "the geometry"),
        images=_images(description.items("images"), tensors["geometry.images"].tobytes()),
        shapes=tuple(description.items("shapes")[: MAX_SHAPES + 1]),
        materials=tuple(description.items("materials")),
        origin=(x, y, z),
    )


def _layouts(rows: dict[str, int]) -> list[Layout]:
    """Arrays of the stream, of these numbers of rows."""
    for name, count in rows.items():
        if not 0 <= count <= _MAX_ROWS:
            raise LumitreeError(f"the geometry has {count} {name} (limit {_MAX_ROWS})")
    return [
        Layout(name, dtype, (rows[name], width), planes=True)
        for name, (dtype, width) in ARRAYS.items()
    ]


def _compressed(images: tuple[NDArray[Any], ...]) -> bytes:
    """All images as bytes; none for no image."""
    compressor, parts = zlib.compressobj(6), []
    for image in images:
        content = image.astype(_PIXELS[str(image.dtype)])
        differences = _rows(content).copy()
        differences[:, 1:] -= _rows(content)[:, :-1]
        parts.append(compressor.compress(differences.tobytes()))
    return b"".join([*parts, compressor.flush()]) if images else b""


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
    content = inflated(content, total, "the images of the geometry") if layouts or content else b""
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
