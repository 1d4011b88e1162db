"""The geometry of an asset: the luminaire itself, which images show in place of the field.

It is plain data: meshes and images are arrays, and shapes and materials (`asset.materials`) are
dataclasses. Nothing in it names a file or is executed.

Symbols
    V, F    vertices and faces of all meshes together
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.materials import (
    Image,
    ImageFacts,
    Material,
    Radiance,
    check_material,
    check_radiance,
    check_surface,
)
from lumitree.core.frames import LocalFrame, Matrix, rows_of, similarity
from lumitree.core.photometry import RGB
from lumitree.core.reading import Arrays, expect, expect_arrays, naming, require
from lumitree.core.tables import object_of
from lumitree.errors import LumitreeError, shown

_WHAT = "geometry"
_expect = functools.partial(expect, _WHAT)
MAX_SHAPES, MAX_MATERIALS, MAX_IMAGES = 5000, 5000, 1000
MAX_IMAGE_SIDE = 16384
# Bytes of all images together.
MAX_IMAGE_BYTES = 5 << 28
_MAX_COORDINATE = 1e15
# Coefficients of media, per unit of length.
_MAX_COEFFICIENT = 1e15
# Beyond it single precision has no values of the phase function.
MAX_ANISOTROPY = 0.999
# How far the geometry may be outside the luminaire's box, local units, by rounding.
_OUTSIDE = 1e-4
NO_ORIGIN = (0.0, 0.0, 0.0)
# Shapes without a mesh.
UnitShapeType = Literal["sphere", "disk", "cylinder", "rectangle"]
UNIT_SHAPES: tuple[UnitShapeType, ...] = get_args(UnitShapeType)
# The arrays of meshes: type and width.
ARRAYS: dict[str, tuple[type[np.generic], int]] = {
    "vertices": (np.float32, 3),
    "normals": (np.float32, 3),
    "texcoords": (np.float32, 2),
    "colours": (np.float32, 3),
    "faces": (np.uint32, 3),
}
# Arrays of a mesh by these names, [N, width] each.
MeshArrays = Arrays


@dataclasses.dataclass(frozen=True)
class Medium:
    """A homogeneous medium on one side of a surface.

    Attributes:
        absorption, scattering: R, G and B, at least 0, per unit of length of the luminaire's file.
        anisotropy: mean cosine of the scattering angle (Henyey-Greenstein).
    """

    absorption: RGB
    scattering: RGB = (0.0, 0.0, 0.0)
    anisotropy: float = 0.0

    @classmethod
    def of_table(cls, values: object, name: str) -> "Medium":
        """The medium of a file: its absorption, or a table if it scatters light."""
        members = {"absorption": values} if isinstance(values, list) else values
        found = object_of(members, Medium, name)
        if isinstance(values, dict) and not found.scatters:
            raise LumitreeError(f"{name} scatters nothing; expected its absorption only")
        return found

    @property
    def scatters(self) -> bool:
        """Whether it scatters light."""
        return any(self.scattering)

    def scaled(self, factor: float) -> "Medium":
        """The medium with all lengths multiplied by a factor."""
        absorption, scattering = (
            (red / factor, green / factor, blue / factor)
            for red, green, blue in (self.absorption, self.scattering)
        )
        return Medium(absorption, scattering, self.anisotropy)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Shape:
    """Properties of a shape besides its form.

    Attributes:
        material: index in the geometry.
        radiance: of its front, W/(m² sr); None if it does not emit.
        flipped: whether normals point to the other side.
        interior, exterior: the media behind its surface and before it.
    """

    material: int
    radiance: Radiance | None = None
    flipped: bool = False
    interior: Medium | None = None
    exterior: Medium | None = None

    @property
    def media(self) -> dict[str, Medium]:
        """The media at its surface, by the names "interior" and "exterior"."""
        sides = {"interior": self.interior, "exterior": self.exterior}
        return {side: medium for side, medium in sides.items() if medium is not None}

    @property
    def scatters(self) -> bool:
        """Whether a medium at its surface scatters light."""
        return any(medium.scatters for medium in self.media.values())


@dataclasses.dataclass(frozen=True, kw_only=True)
class MeshShape(Shape):
    """A mesh.

    Attributes:
        vertices, faces: numbers of its rows in the geometry's arrays, where meshes follow each
            other in the order of their shapes.
        normals, texcoords, colours: whether its vertices have them.
    """

    type: Literal["mesh"] = "mesh"
    vertices: int
    faces: int
    normals: bool = False
    texcoords: bool = False
    colours: bool = False

    @property
    def rows(self) -> dict[str, int]:
        """Numbers of its rows by array."""
        count = self.vertices
        optional = {
            name: count * getattr(self, name) for name in ("normals", "texcoords", "colours")
        }
        return {"vertices": count, **optional, "faces": self.faces}


@dataclasses.dataclass(frozen=True, kw_only=True)
class UnitShape(Shape):
    """A unit shape of Mitsuba, moved by `to_world` [4][4]."""

    type: UnitShapeType
    to_world: Matrix


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
        shapes: in the order of their arrays.
        materials: of the shapes.
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
    images: tuple[Image, ...]
    shapes: tuple[Shape, ...]
    materials: tuple[Material, ...]
    origin: tuple[float, float, float] = NO_ORIGIN

    def __post_init__(self) -> None:
        """Refuse what a renderer could not use safely."""
        _check_images(self.images)
        facts = [ImageFacts.of(image) for image in self.images]
        _expect(0 < len(self.materials) <= MAX_MATERIALS, f"{len(self.materials)} materials")
        _expect(0 < len(self.shapes) <= MAX_SHAPES, f"{len(self.shapes)} shapes")
        for index, material in enumerate(self.materials):
            with naming(lambda index=index: f"invalid geometry: {self._material_name(index)}"):
                check_material(material, facts)
        for index, shape in enumerate(self.shapes):
            with naming(lambda index=index: f"invalid geometry: shape {index}"):
                _check_shape(shape, len(self.materials), facts)
        _check_arrays(self)
        for index, (shape, mesh) in enumerate(zip(self.shapes, self.meshes(), strict=True)):
            with naming(lambda index=index: f"invalid geometry: shape {index}"):
                check_surface(self.materials[shape.material], shape.radiance, mesh or {}, facts)
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
    def arrays(self) -> MeshArrays:
        """The arrays of the meshes by name."""
        return {name: getattr(self, name) for name in ARRAYS}

    @property
    def num_triangles(self) -> int:
        """Number of triangles of the meshes."""
        return len(self.faces)

    @property
    def has_media(self) -> bool:
        """Whether some shapes have media."""
        return any(shape.media for shape in self.shapes)

    def meshes(self) -> list[MeshArrays | None]:
        """Arrays of each shape by name, or None if it is not a mesh."""
        first = dict.fromkeys(ARRAYS, 0)
        found: list[MeshArrays | None] = []
        for shape in self.shapes:
            found.append(None)
            if isinstance(shape, MeshShape):
                found[-1] = mesh = {}
                for name, count in shape.rows.items():
                    mesh[name] = getattr(self, name)[first[name] : first[name] + count]
                    first[name] += count
        return found

    def check_inside(self, frame: LocalFrame) -> None:
        """Refuse geometry of which a part is outside the luminaire's box."""
        for index, (shape, mesh) in enumerate(zip(self.shapes, self.meshes(), strict=True)):
            if isinstance(shape, UnitShape):
                points = _bounds(shape)
            else:
                assert mesh is not None
                points = mesh["vertices"].astype(np.float64)
            # The differences of far points are taken first, as they are exact.
            local = (points - (frame.centre - self.origin)) @ frame.rotation / frame.scale
            outside = float((np.abs(local) - frame.half_extents).max())
            # Coordinates are rounded to single precision.
            _expect(
                outside <= _OUTSIDE + 1e-6 * np.abs(points).max() / frame.scale,
                f"shape {index} is {outside:.3g} local units outside the box",
            )

    def _material_name(self, index: int) -> str:
        """A material by its index, its plugin and the first shape that has it, for messages."""
        having = (number for number, shape in enumerate(self.shapes) if shape.material == index)
        first = next(having, None)
        of = "of no shape" if first is None else f"of shape {first}"
        return f"material {index} ({self.materials[index].plugin}, {of})"


def _scaled(shape: Shape, factor: float) -> Shape:
    changed = {side: medium.scaled(factor) for side, medium in shape.media.items()}
    shape = dataclasses.replace(shape, **changed)
    if isinstance(shape, UnitShape):
        matrix = similarity(np.eye(3), factor) @ np.array(shape.to_world)
        shape = dataclasses.replace(shape, to_world=rows_of(matrix))
    return shape


def _check_shape(shape: Shape, num_materials: int, images: Sequence[ImageFacts]) -> None:
    if not 0 <= shape.material < num_materials:
        raise LumitreeError(f"it has the material {shape.material} of {num_materials}")
    for side, medium in shape.media.items():
        for what in ("absorption", "scattering"):
            values = getattr(medium, what)
            require(
                len(values) == 3 and all(0 <= each <= _MAX_COEFFICIENT for each in values),
                f"{what} of its {side} is {shown(values, 60)}, expected 0 to {_MAX_COEFFICIENT:g}",
            )
        require(
            abs(medium.anisotropy) <= MAX_ANISOTROPY,
            f"anisotropy of its {side} is {medium.anisotropy:g}, expected -{MAX_ANISOTROPY:g} to "
            f"{MAX_ANISOTROPY:g}",
        )
    if isinstance(shape, MeshShape):
        for name in ("vertices", "faces"):
            require(getattr(shape, name) > 0, f"it has {getattr(shape, name)} {name}")
    elif isinstance(shape, UnitShape):
        matrix = np.array(shape.to_world)
        bounded = np.abs(matrix).max() <= _MAX_COORDINATE and (matrix[3] == [0, 0, 0, 1]).all()
        require(bounded and np.linalg.det(matrix[:3, :3]) != 0, "its to_world is not affine")
        if shape.type == "sphere":
            scale = np.linalg.norm(matrix[:3, :3], axis=0)
            require(np.ptp(scale) <= 1e-4 * scale.max(), "a sphere is scaled non-uniformly")
    if shape.radiance is not None:
        check_radiance(shape.radiance, images)


def _check_images(images: tuple[Image, ...]) -> None:
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
        if isinstance(shape, MeshShape):
            for name, count in shape.rows.items():
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
        if isinstance(shape, MeshShape) and mesh is not None:
            known = mesh["faces"].max() < shape.vertices
            _expect(known, f"shape {index}: a face has an unknown vertex")


def _bounds(shape: UnitShape) -> NDArray[np.float64]:
    """Two corners [2, 3] of the bounding box of a shape without a mesh."""
    matrix = np.array(shape.to_world, np.float64)
    linear, centre = matrix[:3, :3], matrix[:3, 3]
    if shape.type == "sphere":
        extent = np.linalg.norm(linear, axis=1)
    elif shape.type == "rectangle":
        extent = np.abs(linear[:, :2]).sum(axis=1)
    else:
        extent = np.linalg.norm(linear[:, :2], axis=1)
    lower, upper = centre - extent, centre + extent
    if shape.type == "cylinder":
        lower = np.minimum(lower, lower + linear[:, 2])
        upper = np.maximum(upper, upper + linear[:, 2])
    return np.stack([lower, upper])
