"""The geometry of an asset as tensors of its file, see docs/format.md.

Shapes, materials and the sizes of arrays and images are one JSON text. Arrays are one stream, in
planes (`array_stream`). Images follow each other as bytes, which are compressed: each byte of a row
minus the one a pixel before it, as PNG's filter "Sub", then by zlib.
"""

import json
import math
import typing
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.array_stream import Arrays, Layout, compressed, decompressed, inflated
from lumitree.asset.geometry import (
    ARRAYS,
    MAX_IMAGE_BYTES,
    MAX_IMAGE_SIDE,
    MAX_IMAGES,
    MAX_SHAPES,
    NO_ORIGIN,
    UNIT_SHAPES,
    AssetGeometry,
    Medium,
    MeshShape,
    Shape,
    UnitShape,
)
from lumitree.asset.materials import (
    MAX_NESTING,
    Image,
    Material,
    Matrix,
    Parameter,
    Radiance,
    Texture,
    VertexColours,
    make_material,
)
from lumitree.core.mitsuba_meshes import VERTEX_COLOUR
from lumitree.core.photometry import RGB
from lumitree.core.reading import Record, parse_json
from lumitree.errors import LumitreeError, shown

GEOMETRY_SHAPES = "geometry.shapes"
GEOMETRY_TENSORS = {GEOMETRY_SHAPES: "U8", "geometry.stream": "U8", "geometry.images": "U8"}
_MAX_ROWS = 1 << 28
# Largest JSON text; a shape takes about 200 bytes.
_MAX_TEXT = 1 << 24
_PIXELS: dict[str, np.dtype[Any]] = {"uint8": np.dtype(np.uint8), "float32": np.dtype("<f4")}
_SIDES = ("interior", "exterior")
_MEDIUM_KEYS = ("absorption", "scattering", "anisotropy")
_FLAGS = ("normals", "texcoords", "colours")


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
        shapes=tuple(map(read_shape, description.items("shapes")[: MAX_SHAPES + 1])),
        materials=tuple(map(read_material, description.items("materials"))),
        origin=(x, y, z),
    )


def read_material(described: object, nesting: int = 1) -> Material:
    """A material of its JSON: plugin, parameters and nested materials, which are checked later.

    Raises:
        LumitreeError: it is not an object of these, or is nested too deeply.
    """
    record = Record(described, "a material")
    if nesting > MAX_NESTING:
        raise LumitreeError(f"materials are nested more than {MAX_NESTING} deep")
    plugin, members = record.text("type", 100), typing.cast(dict[str, object], described)
    nested = record.items("nested") if record.has("nested") else []
    parameters = {
        name: _read_parameter(f"{name} of {plugin}", value)
        for name, value in members.items()
        if name not in ("type", "nested")
    }
    return make_material(plugin, parameters, [read_material(each, nesting + 1) for each in nested])


def read_shape(described: object) -> Shape:
    """A shape of its JSON, whose ranges are checked later.

    Raises:
        LumitreeError: a member is missing, unknown, or of another type.
    """
    record = Record(described, "a shape")
    kind = record.choice("type", ("mesh", *UNIT_SHAPES))
    form = ("vertices", "faces", *_FLAGS) if kind == "mesh" else ("to_world",)
    record.expect_keys("type", "material", "flipped", "radiance", *form, optional=_SIDES)
    media = {side: _read_medium(record, side, kind) for side in _SIDES if record.has(side)}
    radiance: Radiance | None = None
    if not record.is_null("radiance"):
        members = typing.cast(dict[str, object], described)
        given = _read_parameter("radiance", members["radiance"])
        if isinstance(given, bool | str | VertexColours):
            raise LumitreeError(f"radiance is {shown(given, 60)}; expected a colour or an image")
        radiance = given
    common = {
        "material": record.integer("material"),
        "radiance": radiance,
        "flipped": record.choice("flipped", (True, False)),
        **media,
    }
    if kind == "mesh":
        return MeshShape(
            vertices=record.integer("vertices"),
            faces=record.integer("faces"),
            **{name: record.choice(name, (True, False)) for name in _FLAGS},
            **common,
        )
    return UnitShape(type=kind, to_world=_matrix(record, "to_world"), **common)


def _read_parameter(what: str, value: object) -> Parameter:
    match value:
        case bool() | int() | float() | str():
            return value
        case [red, green, blue] if all(type(each) in (int, float) for each in value):
            return (red, green, blue)
        case {"attribute": _}:
            record = Record(value, "a texture")
            record.expect_keys("attribute")
            record.choice("attribute", (VERTEX_COLOUR,))
            return VertexColours()
        case dict():
            record = Record(value, "a texture")
            record.expect_keys("image", "raw", "filter_type", "wrap_mode", "to_uv")
            return Texture(
                image=record.integer("image"),
                raw=record.choice("raw", (True, False)),
                filter_type=record.choice("filter_type", ("bilinear", "nearest")),
                wrap_mode=record.choice("wrap_mode", ("repeat", "mirror", "clamp")),
                to_uv=_matrix(record, "to_uv"),
            )
        case _:
            raise LumitreeError(f"{what} is {shown(value, 60)}; expected a parameter of a material")


def _read_medium(record: Record, side: str, of: str) -> Medium:
    """A medium: its absorption, or an object if it scatters light."""
    if not record.is_object(side):
        return Medium(_rgb(record, side))
    medium = record.record(side)
    medium.expect_keys(*_MEDIUM_KEYS)
    absorption, scattering = (_rgb(medium, key) for key in _MEDIUM_KEYS[:2])
    if not any(scattering):
        raise LumitreeError(f"the {side} of a {of} scatters nothing; expected its absorption only")
    return Medium(absorption, scattering, medium.number("anisotropy"))


def _rgb(record: Record, key: str) -> RGB:
    red, green, blue = record.array(key, 3).tolist()
    return (red, green, blue)


def _matrix(record: Record, key: str) -> Matrix:
    return tuple(map(tuple, record.array(key, 4, 4).tolist()))


def _written(value: object) -> Any:
    """A shape, a material or a part of one as JSON; the inverse of `read_shape` and others."""
    match value:
        case Material():
            nested = {"nested": list(map(_written, value.nested))} if value.nested else {}
            parameters = {name: _written(each) for name, each in value.parameters.items()}
            return {"type": value.plugin, **parameters, **nested}
        case VertexColours():
            return {"attribute": VERTEX_COLOUR}
        case Medium(scattering=scattering) if not any(scattering):
            return list(value.absorption)
        case MeshShape():
            return {"type": "mesh", **_members(value)}
        case UnitShape() | Medium() | Texture():
            return _members(value)
        case tuple():
            return list(map(_written, value))
        case _:
            return value


def _members(value: Shape | Medium | Texture) -> dict[str, Any]:
    """Members of an object; shapes without a medium have no key of it."""
    found = {name: _written(each) for name, each in vars(value).items()}
    return {name: each for name, each in found.items() if each is not None or name not in _SIDES}


def _layouts(rows: dict[str, int]) -> list[Layout]:
    """Arrays of the stream, of these numbers of rows."""
    for name, count in rows.items():
        if not 0 <= count <= _MAX_ROWS:
            raise LumitreeError(f"the geometry has {count} {name} (limit {_MAX_ROWS})")
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


def _images(descriptions: list[object], content: bytes) -> tuple[Image, ...]:
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


def _layout(description: object) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an image."""
    record = Record(description, "an image")
    record.expect_keys("shape", "dtype")
    dtype = _PIXELS[record.choice("dtype", tuple(_PIXELS))]
    shape = tuple(record.integers("shape"))
    if len(shape) != 3 or not all(0 < side <= MAX_IMAGE_SIDE for side in shape):
        raise LumitreeError(f"an image of the geometry has the shape {str(shape)[:60]}")
    return shape, dtype
