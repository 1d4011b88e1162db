"""The geometry of an asset as tensors of its file, see docs/format.md.

Shapes, materials and the sizes of arrays and images are one JSON text. Arrays are one stream, in
planes (`array_stream`). Images follow each other as bytes, which are compressed: each byte of a row
minus the one a pixel before it, as PNG's filter "Sub", then by zlib.
"""

import dataclasses
import json
import math
import zlib
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.array_stream import Arrays, Layout, compressed, decompressed, inflated
from lumitree.asset.geometry import (
    ARRAYS,
    MAX_IMAGE_BYTES,
    MAX_IMAGE_SIDE,
    MAX_IMAGES,
    NO_ORIGIN,
    AssetGeometry,
    Medium,
    MeshShape,
    Shape,
    UnitShape,
)
from lumitree.asset.materials import (
    Image,
    Material,
    Texture,
    VertexColours,
)
from lumitree.core.reading import parse_json
from lumitree.core.tables import Range, converted
from lumitree.errors import LumitreeError

GEOMETRY_SHAPES = "geometry.shapes"
GEOMETRY_TENSORS = {GEOMETRY_SHAPES: "U8", "geometry.stream": "U8", "geometry.images": "U8"}
_MAX_ROWS = 1 << 28
# Largest JSON text; a shape takes about 200 bytes.
_MAX_TEXT = 1 << 24
_PIXELS: dict[str, np.dtype] = {
    "uint8": np.dtype(np.uint8),
    "float32": np.dtype("<f4"),
}
_SIDES = ("interior", "exterior")
_Count = Annotated[int, Range(0, _MAX_ROWS)]
_Side = Annotated[int, Range(1, MAX_IMAGE_SIDE)]


@dataclasses.dataclass(frozen=True)
class _Rows:
    vertices: _Count
    normals: _Count
    texcoords: _Count
    colours: _Count
    faces: _Count


@dataclasses.dataclass(frozen=True)
class _Image:
    shape: tuple[_Side, _Side, _Side]
    dtype: Literal["uint8", "float32"]


@dataclasses.dataclass(frozen=True)
class _Description:
    arrays: _Rows
    images: tuple[_Image, ...]
    materials: tuple[Material, ...]
    shapes: tuple[MeshShape | UnitShape, ...]
    origin: tuple[float, float, float] = NO_ORIGIN


def geometry_tensors(geometry: AssetGeometry) -> Arrays:
    """Tensors of an asset's geometry, by name."""
    arrays = geometry.arrays
    description = {
        "arrays": {name: len(array) for name, array in arrays.items()},
        "images": [{"shape": list(i.shape), "dtype": str(i.dtype)} for i in geometry.images],
        "materials": list(map(_written, geometry.materials)),
        "shapes": list(map(_written, geometry.shapes)),
        **({} if geometry.origin == NO_ORIGIN else {"origin": list(geometry.origin)}),
    }
    text = json.dumps(description, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return {
        GEOMETRY_SHAPES: np.frombuffer(text.encode(), np.uint8),
        "geometry.images": np.frombuffer(_compressed(geometry.images), np.uint8),
        "geometry.stream": compressed(arrays, _layouts({n: len(a) for n, a in arrays.items()})),
    }


def build_geometry(tensors: Arrays) -> AssetGeometry:
    """The geometry of a file's tensors, checked; the inverse of `geometry_tensors`."""
    text = tensors[GEOMETRY_SHAPES].tobytes()
    if len(text) > _MAX_TEXT:
        raise LumitreeError(f"the geometry's description has {len(text)} bytes (limit {_MAX_TEXT})")
    description = converted(parse_json(text), _Description, name="geometry")
    layouts = _layouts(vars(description.arrays))
    return AssetGeometry(
        **decompressed(tensors["geometry.stream"], layouts, "the geometry"),
        images=_images(description.images, tensors["geometry.images"].tobytes()),
        shapes=description.shapes,
        materials=description.materials,
        origin=description.origin,
    )


def _written(value: object) -> object:
    """A shape, a material or a part of one as JSON, of which `_Description` is made again."""
    match value:
        case Material():
            nested = {"nested": list(map(_written, value.nested))} if value.nested else {}
            parameters = {name: _written(each) for name, each in value.parameters.items()}
            return {"type": value.plugin, **parameters, **nested}
        case Medium(scattering=scattering) if not any(scattering):
            return list(value.absorption)
        case Shape() | Medium() | Texture() | VertexColours():
            return _members(value)
        case tuple():
            return list(map(_written, value))
        case _:
            return value


def _members(value: Shape | Medium | Texture | VertexColours) -> dict[str, object]:
    """Members of an object; shapes without a medium have no key of it."""
    found = {name: _written(each) for name, each in vars(value).items()}
    return {name: each for name, each in found.items() if each is not None or name not in _SIDES}


def _layouts(rows: dict[str, int]) -> list[Layout]:
    """Arrays of the stream, of these numbers of rows."""
    return [
        Layout(name, dtype, (rows[name], width), planes=True)
        for name, (dtype, width) in ARRAYS.items()
    ]


def _compressed(images: tuple[Image, ...]) -> bytes:
    """All images as bytes; none for no image."""
    compressor, parts = zlib.compressobj(6), []
    for image in images:
        content = image.astype(_PIXELS[str(image.dtype)])
        differences = _rows(content).copy()
        differences[:, 1:] -= _rows(content)[:, :-1]
        parts.append(compressor.compress(differences.tobytes()))
    return b"".join([*parts, compressor.flush()]) if images else b""


def _rows(image: Image) -> NDArray[np.uint8]:
    """Bytes [H, W, channels and bytes of each] of an image."""
    return image.view(np.uint8).reshape(*image.shape[:2], -1)


def _images(descriptions: tuple[_Image, ...], content: bytes) -> tuple[Image, ...]:
    if len(descriptions) > MAX_IMAGES:
        raise LumitreeError(f"the geometry has {len(descriptions)} images (limit {MAX_IMAGES})")
    layouts = [(each.shape, _PIXELS[each.dtype]) for each in descriptions]
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
