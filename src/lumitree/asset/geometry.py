"""The geometry of an asset: the luminaire itself, which images show in place of the field.

It is plain data. Meshes and images are arrays; shapes and materials are JSON objects whose members
are checked one by one (`asset.materials`). Nothing in it names a file or is executed.

Symbols
    V, F    vertices and faces of all meshes together
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.checks import expect, expect_arrays, naming, require
from lumitree.asset.geometry_media import MEDIA_SIDES, check_medium, described_medium, side_medium
from lumitree.asset.materials import check_material, check_radiance
from lumitree.asset.textures import (
    VERTEX_RANGE,
    ImageFacts,
    Json,
    check_coordinates,
    textures_of,
    uses_vertex_colours,
    within,
)
from lumitree.core.frames import LocalFrame, similarity
from lumitree.core.reading import Record
from lumitree.errors import LumitreeError, shown

_WHAT = "geometry"
_expect = functools.partial(expect, _WHAT)
MAX_SHAPES, MAX_MATERIALS, MAX_IMAGES = 5000, 5000, 1000
MAX_IMAGE_SIDE = 16384
# Bytes of all images together.
MAX_IMAGE_BYTES = 5 << 28
_MAX_COORDINATE = 1e15
# How far the geometry may be outside the luminaire's box, local units: rounding alone.
_OUTSIDE = 1e-4
# Shapes without a mesh: each is the plugin's unit shape, moved by `to_world`.
_ANALYTIC = ("sphere", "disk", "cylinder", "rectangle")
_MESH_KEYS = ("vertices", "faces", "normals", "texcoords", "colours")
_SHAPE_KEYS = ("type", "material", "flipped", "radiance")
NO_ORIGIN = (0.0, 0.0, 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class AssetGeometry:
    """Shapes, materials and images of a luminaire, in the axes and unit of its file.

    Attributes:
        vertices: float32 [V, 3] positions of all meshes, one mesh after the other.
        normals: float32 [Vn, 3] shading normals of the vertices of meshes that have them.
        texcoords: float32 [Vt, 2], likewise.
        colours: float32 [Vc, 3] linear colours of vertices, likewise.
        faces: uint32 [F, 3] indices of vertices, counted within each mesh.
        images: uint8 or float32 [H, W, C] with C = 1, 3 or 4; row 0 is at v = 0, as Mitsuba has it.
        shapes: JSON objects, in the order of their arrays. All have the keys `type`, `material`,
            an index; `flipped`, whether normals point to the other side; and `radiance`, None or
            a colour or a texture, W/(m² sr). A "mesh" has the counts `vertices` and `faces`, and
            `normals`, `texcoords` and `colours`, whether it has these. A "sphere", "disk",
            "cylinder" or "rectangle" has `to_world` [4][4]. A shape between media has `interior` or
            `exterior`, the medium behind or before it, see `asset.geometry_media`.
        materials: JSON objects, see `asset.materials`.
        origin: [3] origin of the coordinates of vertices and of `to_world`, in the frame of the
            luminaire's file; see `Luminaire.origin`.

    Raises:
        LumitreeError: a member has a wrong type, shape or range.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    texcoords: NDArray[np.float32]
    colours: NDArray[np.float32]
    faces: NDArray[np.uint32]
    images: tuple[NDArray[Any], ...]
    shapes: tuple[Json, ...]
    materials: tuple[Json, ...]
    origin: tuple[float, float, float] = NO_ORIGIN

    def __post_init__(self) -> None:
        """Refuse what a renderer could not use safely."""
        _check_images(self.images)
        facts = [ImageFacts.of(image) for image in self.images]
        _expect(0 < len(self.materials) <= MAX_MATERIALS, f"{len(self.materials)} materials")
        _expect(0 < len(self.shapes) <= MAX_SHAPES, f"{len(self.shapes)} shapes")
        for index, material in enumerate(self.materials):
            with naming(lambda index=index: f"invalid geometry: material {_used(index, self)}"):
                check_material(material, facts)
        for index, shape in enumerate(self.shapes):
            with naming(lambda index=index: f"invalid geometry: shape {index}"):
                _check_shape(shape, len(self.materials), facts)
        _check_arrays(self)
        for index, (shape, mesh) in enumerate(zip(self.shapes, self.meshes(), strict=True)):
            with naming(lambda index=index: f"invalid geometry: shape {index}"):
                check_surface(
                    self.materials[shape["material"]], shape["radiance"], mesh or {}, facts
                )
        _expect(
            len(self.origin) == 3 and all(abs(each) <= _MAX_COORDINATE for each in self.origin),
            f"origin {self.origin!r}, expected three numbers of at most {_MAX_COORDINATE:g}",
        )

    def __repr__(self) -> str:
        return (
            f"AssetGeometry({len(self.shapes):,} shapes, {self.num_triangles:,} triangles, "
            f"{len(self.materials):,} materials, {len(self.images):,} images, "
            f"{self.num_bytes:,} bytes)"
        )

    @property
    def file_from_geometry(self) -> NDArray[np.float64]:
        """[4, 4] translation from its coordinates to the frame of the luminaire's file."""
        return similarity(np.eye(3), 1.0, self.origin)

    def scaled(self, factor: float) -> "AssetGeometry":
        """The geometry with all lengths multiplied by a factor, in a smaller or larger unit."""
        x, y, z = (factor * each for each in self.origin)
        return dataclasses.replace(
            self,
            vertices=(factor * self.vertices).astype(np.float32),
            shapes=tuple(_scaled(shape, factor) for shape in self.shapes),
            origin=(x, y, z),
        )

    @property
    def num_bytes(self) -> int:
        """Bytes of all arrays and images."""
        return sum(array.nbytes for array in (*self.arrays.values(), *self.images))

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of the meshes by name."""
        return {name: getattr(self, name) for name in ARRAYS}

    @property
    def num_triangles(self) -> int:
        """Number of triangles of the meshes."""
        return len(self.faces)

    @property
    def has_media(self) -> bool:
        """Whether some shapes have media."""
        return any(side in shape for shape in self.shapes for side in MEDIA_SIDES)

    def meshes(self) -> "list[dict[str, NDArray[Any]] | None]":
        """Arrays of each shape by name, or None if it is not a mesh; the inverse of `join`."""
        taken = dict.fromkeys(ARRAYS, 0)
        found: list[dict[str, NDArray[Any]] | None] = []
        for shape in self.shapes:
            found.append(None)
            if shape["type"] == "mesh":
                found[-1] = mesh = {}
                for name, count in _counts(shape).items():
                    mesh[name] = getattr(self, name)[taken[name] : taken[name] + count]
                    taken[name] += count
        return found

    def check_inside(self, frame: LocalFrame) -> None:
        """Refuse geometry of which a part is outside the luminaire's box."""
        for index, (shape, mesh) in enumerate(zip(self.shapes, self.meshes(), strict=True)):
            points = _bounds(shape) if mesh is None else mesh["vertices"].astype(np.float64)
            # The differences of far points are taken first, as they are exact.
            local = (points - (frame.centre - self.origin)) @ frame.rotation / frame.scale
            outside = float((np.abs(local) - frame.half_extents).max())
            # Coordinates are rounded to single precision.
            _expect(
                outside <= _OUTSIDE + 1e-6 * np.abs(points).max() / frame.scale,
                f"shape {index} is {outside:.3g} local units outside the box",
            )


# The arrays of meshes: type and width.
ARRAYS: dict[str, tuple[type[np.generic], int]] = {
    "vertices": (np.float32, 3),
    "normals": (np.float32, 3),
    "texcoords": (np.float32, 2),
    "colours": (np.float32, 3),
    "faces": (np.uint32, 3),
}


def _counts(shape: Json) -> dict[str, int]:
    """Rows of each array that belong to a mesh."""
    count = shape["vertices"]
    flags = {name: count * shape[name] for name in ("normals", "texcoords", "colours")}
    return {"vertices": count, **flags, "faces": shape["faces"]}


def check_surface(
    material: Json, radiance: Any, mesh: "dict[str, NDArray[Any]]", images: Sequence[ImageFacts]
) -> None:
    """Refuse a shape whose textures its texture coordinates or colours of vertices do not fit.

    Args:
        material, radiance: that `asset.materials` accepts.
        mesh: arrays of the shape by the names of `ARRAYS`, without those that it lacks.
        images: of the geometry.
    """
    used = [material, radiance]
    if uses_vertex_colours(used):
        colours = mesh.get("colours", np.zeros(0))
        if not len(colours):
            raise LumitreeError("it has no colours of vertices, which its material uses")
        values = float(colours.min()), float(colours.max())
        if not within(values, VERTEX_RANGE):
            raise LumitreeError(
                f"its colours of vertices are {values[0]:.4g} to {values[1]:.4g}; expected 0 to 1"
            )
    found = [texture for texture in textures_of(used) if "image" in texture]
    coordinates = mesh.get("texcoords", np.zeros((0, 2)))
    # A shape without coordinates of its own has Mitsuba's, from 0 to 1.
    largest = np.abs(coordinates).max(axis=0) if found and len(coordinates) else np.ones(2)
    for texture in found:
        check_coordinates(texture, images, largest)


def _used(index: int, geometry: AssetGeometry) -> str:
    """A material by its index, its plugin and the first shape that has it, for messages."""
    material = geometry.materials[index]
    kind = material.get("type") if isinstance(material, dict) else None
    found = (
        number
        for number, shape in enumerate(geometry.shapes)
        if isinstance(shape, dict) and shape.get("material") == index
    )
    first = next(found, None)
    of = "of no shape" if first is None else f"of shape {first}"
    return f"{index} ({shown(kind, 60)}, {of})"


def _scaled(shape: Json, factor: float) -> Json:
    changed: Json = {}
    if "to_world" in shape:
        matrix = similarity(np.eye(3), factor) @ np.array(shape["to_world"])
        changed["to_world"] = matrix.tolist()
    for side in MEDIA_SIDES:
        if side in shape:
            medium = side_medium(shape[side])
            thinner = medium._replace(
                absorption=medium.absorption / factor, scattering=medium.scattering / factor
            )
            changed[side] = described_medium(thinner)
    return {**shape, **changed}


def _check_shape(shape: Json, num_materials: int, images: Sequence[ImageFacts]) -> None:
    record = Record(shape, "a shape")
    kind = record.choice("type", ("mesh", *_ANALYTIC))
    sides = [side for side in MEDIA_SIDES if record.has(side)]
    record.expect_keys(*_SHAPE_KEYS, *(_MESH_KEYS if kind == "mesh" else ("to_world",)), *sides)
    for side in sides:
        check_medium(record, side, kind)
    index = record.integer("material")
    if not 0 <= index < num_materials:
        raise LumitreeError(f"it has the material {index} of {num_materials}")
    flags = ["flipped"]
    if kind == "mesh":
        flags += ["normals", "texcoords", "colours"]
        for name in ("vertices", "faces"):
            require(record.integer(name) > 0, f"a mesh has {record.integer(name)} {name}")
    else:
        matrix = record.array("to_world", 4, 4)
        bounded = np.abs(matrix).max() <= _MAX_COORDINATE and (matrix[3] == [0, 0, 0, 1]).all()
        require(
            bounded and np.linalg.det(matrix[:3, :3]) != 0, f"to_world of a {kind} is not affine"
        )
        if kind == "sphere":
            scale = np.linalg.norm(matrix[:3, :3], axis=0)
            require(np.ptp(scale) <= 1e-4 * scale.max(), "a sphere is scaled non-uniformly")
    for name in flags:
        require(isinstance(shape[name], bool), f"{name} of a {kind} is not true or false")
    radiance = shape["radiance"]
    if radiance is not None:
        check_radiance(radiance, images)


def _check_images(images: tuple[NDArray[Any], ...]) -> None:
    _expect(len(images) <= MAX_IMAGES, f"{len(images)} images, expected at most {MAX_IMAGES}")
    total = sum(image.nbytes for image in images)
    _expect(total <= MAX_IMAGE_BYTES, f"images of {total} bytes, at most {MAX_IMAGE_BYTES}")
    for index, image in enumerate(images):
        sides, channels = image.shape[:2], image.shape[2:]
        _expect(
            len(sides) == 2 and all(0 < side <= MAX_IMAGE_SIDE for side in sides),
            f"image {index} is {image.shape}, expected [height, width, channels]",
        )
        _expect(channels in ((1,), (3,), (4,)), f"image {index} has {channels} channels")
        _expect(
            image.dtype in (np.uint8, np.float32) and np.isfinite(image).all(),
            f"image {index} is {image.dtype}, expected uint8 or finite float32",
        )


def _check_arrays(geometry: AssetGeometry) -> None:
    counts = dict.fromkeys(ARRAYS, 0)
    for shape in geometry.shapes:
        if shape["type"] == "mesh":
            for name, count in _counts(shape).items():
                counts[name] += count
    expect_arrays(
        _WHAT,
        {
            name: (getattr(geometry, name), dtype, (counts[name], width))
            for name, (dtype, width) in ARRAYS.items()
        },
    )
    for name in ("vertices", "normals", "texcoords", "colours"):
        _expect(
            (np.abs(getattr(geometry, name)) <= _MAX_COORDINATE).all(),
            f"{name} hold NaN or values above {_MAX_COORDINATE:g}",
        )
    for index, (shape, mesh) in enumerate(zip(geometry.shapes, geometry.meshes(), strict=True)):
        if mesh is not None:
            known = mesh["faces"].max() < shape["vertices"]
            _expect(known, f"shape {index}: a face has an unknown vertex")


def _bounds(shape: Json) -> NDArray[np.float64]:
    """Two corners [2, 3] of the bounding box of a shape without a mesh."""
    matrix = np.array(shape["to_world"], np.float64)
    linear, centre = matrix[:3, :3], matrix[:3, 3]
    if shape["type"] == "sphere":
        extent = np.linalg.norm(linear, axis=1)
    elif shape["type"] == "rectangle":
        extent = np.abs(linear[:, :2]).sum(axis=1)
    else:
        extent = np.linalg.norm(linear[:, :2], axis=1)
    lower, upper = centre - extent, centre + extent
    if shape["type"] == "cylinder":
        lower = np.minimum(lower, lower + linear[:, 2])
        upper = np.maximum(upper, upper + linear[:, 2])
    return np.stack([lower, upper])
