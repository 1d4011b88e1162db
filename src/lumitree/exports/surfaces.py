"""The surfaces of an asset for exporters: triangle meshes, materials, and images as PNG files.

Row 0 of an image of an asset is at v = 0; it is the first row of the file.
"""

import dataclasses
import hashlib
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from lumitree.asset.asset import Asset
from lumitree.asset.geometry import (
    ARRAYS,
    AssetGeometry,
    MeshArrays,
    MeshShape,
    Shape,
    UnitShape,
)
from lumitree.asset.materials import Image, Matrix, Texture, VertexColours, places_on_image
from lumitree.core.frames import similarity, similarity_scale
from lumitree.core.images import encode_png, linear_from_srgb, srgb_from_linear
from lumitree.core.photometry import LUMA, RGB
from lumitree.exports.pbr import Layer, PbrMaterial, shape_material
from lumitree.lamp.meshes import areas_on_image

LOST_GEOMETRY = "the asset has no geometry: the lamp itself is not shown"
# Lines that are true of every lamp with surfaces.
LOST_SHADOWS = "the lights illuminate the lamp's surfaces without its shadows"
LOST_GLOW = "surfaces that emit illuminate a second time where a path tracer shows them"
# Segments of a circle in place of an analytic shape.
_SEGMENTS = 96

# Part of a mesh from which on it is both mirrored and not.
_MIXED = 0.01
LOST_MIRRORED = "normal maps are wrong where texture coordinates are mirrored beside others"


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """A mesh and its material, with lengths in metres.

    Attributes:
        mesh: `vertices` [V, 3] and `faces` [F, 3]; `normals` [V, 3] of length 1 if it is smooth;
            `colours` [V, 3] if its material uses the colours of vertices.
        material: of the mesh.
        uv: [V, 2] coordinates for each map of `maps`; row 0 of an image is at v = 0.
        maps: the different maps of texture coordinates that the material has.
        thickness: m, twice the enclosed volume over the area, if light is refracted; else 0.
    """

    mesh: MeshArrays
    material: PbrMaterial
    uv: list[NDArray[np.float32]]
    maps: list[Matrix]
    thickness: float

    def uv_set(self, texture: Texture) -> int:
        """Number of the coordinates of a texture."""
        return self.maps.index(texture.to_uv)

    @property
    def tint(self) -> RGB:
        """Factor on light that crosses the surface, at normal incidence."""
        absorption = np.array(self.material.absorption or (0.0, 0.0, 0.0))
        colour = np.array(self.material.colour.factor) * np.exp(-absorption * self.thickness)
        red, green, blue = colour.tolist()
        return (red, green, blue)


def surfaces_of(asset: Asset, turn: NDArray[np.float64]) -> tuple[list[Surface], list[str]]:
    """The surfaces of an asset, and one line for each property that they lack.

    `turn` [3, 3] is the rotation from the frame of the luminaire's file to the program's.
    """
    from trimesh import Trimesh

    if asset.geometry is None:
        return [], [LOST_GEOMETRY]
    geometry, found, lost = asset.geometry, [], set[str]()
    meshes = geometry_meshes(geometry, similarity(turn))
    for shape, mesh in zip(geometry.shapes, meshes, strict=True):
        material = shape_material(geometry, shape, asset.light_factors)
        lost |= material.lost
        if material.normal is not None:
            share = mirrored_share(mesh)
            material = dataclasses.replace(material, normal_mirrored=share > 0.5)
            lost |= lost_by_mirroring(share)
        images = [each for each in material.textures if isinstance(each, Texture)]
        maps = list(dict.fromkeys(texture.to_uv for texture in images))
        if maps and "texcoords" not in mesh:
            lost.add("images on meshes without texture coordinates have one colour")
        texcoords = mesh.get("texcoords", np.full((len(mesh["vertices"]), 2), 0.5))
        arrays = {"vertices": mesh["vertices"], "faces": mesh["faces"]}
        if "normals" in mesh:
            arrays["normals"] = _unit(mesh["normals"])
        if VertexColours() in material.textures:
            arrays["colours"] = mesh["colours"]
        uv = [places_on_image(each, texcoords).astype(np.float32) for each in maps]
        closed = (
            material.emission.is_black or Trimesh(mesh["vertices"], mesh["faces"]).is_watertight
        )
        if not closed:
            lost.add("surfaces that emit and enclose nothing emit from their backs too")
        refracts = not (material.transmission.is_black or material.thin)
        thickness = _thickness(mesh) if refracts else 0.0
        found.append(Surface(arrays, material, uv, maps, thickness))
    return found, sorted(lost)


def _unit(normals: NDArray[np.floating]) -> NDArray[np.float32]:
    """Normals of length 1; normals of length 0 become upward normals."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    safe = np.where(length > 0, normals / np.maximum(length, 1e-30), [0.0, 1.0, 0.0])
    return safe.astype(np.float32)


def _thickness(mesh: MeshArrays) -> float:
    """Twice the enclosed volume over the area: for a shell, the thickness of its wall."""
    first, second, third = np.moveaxis(mesh["vertices"][mesh["faces"]].astype(np.float64), 1, 0)
    middle = mesh["vertices"].mean(axis=0, dtype=np.float64)
    cross = np.cross(second - first, third - first)
    area = np.linalg.norm(cross, axis=1).sum() / 2
    volume = abs(((first - middle) * cross).sum()) / 6
    return float(2 * volume / area) if area > 0 else 0.0


def geometry_meshes(geometry: AssetGeometry, to_frame: NDArray[np.float64]) -> list[MeshArrays]:
    """Arrays of each shape: `vertices`, `faces`, and `normals`, `texcoords` and `colours` if any.

    `to_frame` [4, 4] is a similarity from the frame of the luminaire's file to another one.
    """
    # From the geometry's coordinates, in double precision: they may be far from the file's.
    matrix = to_frame @ geometry.file_from_geometry
    rotation = matrix[:3, :3] / similarity_scale(to_frame, "to_frame")
    found = []
    for shape, mesh in zip(geometry.shapes, _triangulated(geometry), strict=True):
        faces = mesh["faces"]
        placed = {"vertices": mesh["vertices"] @ matrix[:3, :3].T + matrix[:3, 3]}
        placed["faces"] = faces[:, ::-1] if shape.flipped else faces
        if len(mesh["normals"]):
            placed["normals"] = (-1 if shape.flipped else 1) * mesh["normals"] @ rotation.T
        placed |= {name: mesh[name] for name in ("texcoords", "colours") if len(mesh[name])}
        found.append(
            {
                name: np.ascontiguousarray(values, np.uint32 if name == "faces" else np.float32)
                for name, values in placed.items()
            }
        )
    return found


def meshed(geometry: AssetGeometry) -> AssetGeometry:
    """The geometry with meshes in place of its unit shapes."""
    shapes, meshes = [], _triangulated(geometry)
    for shape, mesh in zip(geometry.shapes, meshes, strict=True):
        if isinstance(shape, UnitShape):
            common = {field.name: getattr(shape, field.name) for field in dataclasses.fields(Shape)}
            count, faces = len(mesh["vertices"]), len(mesh["faces"])
            shape = MeshShape(vertices=count, faces=faces, normals=True, texcoords=True, **common)
        shapes.append(shape)
    joined = {
        name: np.concatenate([mesh[name] for mesh in meshes]).astype(kind)
        for name, (kind, _) in ARRAYS.items()
    }
    return dataclasses.replace(geometry, shapes=tuple(shapes), **joined)


def mirrored_share(mesh: MeshArrays) -> float:
    """Part of a mesh whose texture coordinates are mirrored, by their area; 0 without any.

    There the second axis of normal maps is turned round in other programs, but not in Mitsuba,
    which has the product of the normal and the first axis.
    """
    if "texcoords" not in mesh:
        return 0.0
    area = areas_on_image(mesh["texcoords"].astype(np.float64), mesh["faces"])
    return float(area[area > 0].sum() / max(np.abs(area).sum(), 1e-300))


def lost_by_mirroring(share: float) -> set[str]:
    """The line about a mesh with a normal map that is mirrored in part (`mirrored_share`)."""
    return {LOST_MIRRORED} if _MIXED < share < 1 - _MIXED else set()


def _triangulated(geometry: AssetGeometry) -> list[MeshArrays]:
    """Arrays of each shape by all names of `ARRAYS`, in the geometry's coordinates."""
    return [
        _unit_shape(shape) if isinstance(shape, UnitShape) else mesh or {}
        for shape, mesh in zip(geometry.shapes, geometry.meshes(), strict=True)
    ]


def _unit_shape(shape: UnitShape) -> MeshArrays:
    """Mesh of a sphere, disk, cylinder or rectangle, in the geometry's coordinates."""
    if shape.type == "rectangle":
        corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        mesh: MeshArrays = {
            "vertices": corners,
            "normals": np.tile([0.0, 0, 1], (4, 1)),
            "texcoords": (corners[:, :2] + 1) / 2,
            "faces": np.array([[0, 1, 2], [0, 2, 3]]),
        }
    else:
        mesh = _curved(shape.type)
    matrix = np.array(shape.to_world, np.float64)
    linear = matrix[:3, :3]
    mesh["vertices"] = mesh["vertices"] @ linear.T + matrix[:3, 3]
    if np.linalg.det(linear) < 0:
        mesh["faces"] = mesh["faces"][:, ::-1]
    normals = mesh["normals"] @ np.linalg.inv(linear)
    mesh["normals"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return {**mesh, "colours": np.zeros((0, 3))}


def _curved(kind: Literal["sphere", "cylinder", "disk"]) -> MeshArrays:
    """Mesh of a grid of azimuth and a parameter; the seam is double."""
    azimuth = np.linspace(0, 2 * np.pi, _SEGMENTS + 1)[:, None]
    steps = _SEGMENTS // 2 if kind == "sphere" else 1
    t = np.linspace(0, 1, steps + 1)[None]
    azimuth, t = np.broadcast_arrays(azimuth, t)
    x, y, turn = np.cos(azimuth), np.sin(azimuth), azimuth / (2 * np.pi)
    match kind:
        case "sphere":
            flat = np.sin(np.pi * t)
            points = np.stack([flat * x, flat * y, np.cos(np.pi * t)], axis=-1)
            normals, texcoords = points, np.stack([turn, t], axis=-1)
        case "cylinder":
            points, normals = np.stack([x, y, t], axis=-1), np.stack([x, y, 0 * t], axis=-1)
            texcoords = np.stack([turn, t], axis=-1)
        case "disk":
            points = np.stack([t * x, t * y, 0 * t], axis=-1)
            normals = np.broadcast_to([0.0, 0, 1], points.shape)
            texcoords = np.stack([t, turn], axis=-1)
    index = np.arange(t.size).reshape(t.shape)
    first, second, third, fourth = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack([[first, second, third], [first, third, fourth]]).transpose(0, 2, 3, 1)
    faces, vertices, normals = faces.reshape(-1, 3), points.reshape(-1, 3), normals.reshape(-1, 3)
    corners = vertices[faces]
    geometric = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # At a pole and at a disk's centre one of the two triangles of a cell is flat.
    area = np.linalg.norm(geometric, axis=1)
    faces, geometric = faces[area > 1e-9], geometric[area > 1e-9]
    outwards = (geometric * normals[faces].sum(axis=1)).sum(axis=1) > 0
    faces = np.where(outwards[:, None], faces, faces[:, ::-1])
    return {
        "vertices": vertices,
        "normals": normals,
        "texcoords": texcoords.reshape(-1, 2),
        "faces": faces,
    }


Pixels = NDArray[np.uint8]


class PbrImages:
    """PNG files of the images of an asset's geometry, each made once.

    `files` has their content by a name without suffix, in the order in which they were made.
    """

    def __init__(self, images: Sequence[Image]) -> None:
        self._images = images
        self._names: dict[str, str] = {}
        self.files: dict[str, bytes] = {}

    def colours(self, layer: Layer) -> tuple[str, float]:
        """Name of the file of a layer's colours, and the factor that its linear values need."""
        pixels, factor = self.colour_pixels(layer)
        return self.add(pixels), factor

    def colour_pixels(self, layer: Layer) -> tuple[Pixels, float]:
        """Pixels [H, W, 3] of a layer's colours, encoded by sRGB, and a factor on linear values."""
        assert layer.image is not None
        image = self._images[layer.image.image]
        if image.dtype == np.uint8 and not layer.image.raw and layer.exponent == 1:
            pixels = np.broadcast_to(image[..., :3], (*image.shape[:2], 3))
            return np.ascontiguousarray(pixels, np.uint8), 1.0
        values = self._linear(layer)
        largest = max(float(values.max()), 1e-30)
        factor = largest if largest > 1 or image.dtype != np.uint8 else 1.0
        encoded = np.broadcast_to(srgb_from_linear(values / factor), (*values.shape[:2], 3))
        return np.rint(255 * encoded).astype(np.uint8), factor

    def number_pixels(self, layer: Layer) -> Pixels:
        """Pixels [H, W] of a layer that has one number: its values in 255ths, clipped to 1."""
        values = self._linear(layer)
        weights = np.array(LUMA if values.shape[2] == 3 else [1.0])
        return np.rint(255 * np.clip(values @ weights, 0, 1)).astype(np.uint8)

    def data(self, layer: Layer) -> str:
        """Name of the file of a layer that has one number."""
        return self.add(self.number_pixels(layer))

    def normals(self, texture: Texture, mirrored: bool) -> str:
        """Name of the file of a normal map; `mirrored`: with its second axis turned round."""
        values = self._linear(Layer(texture=texture))
        if mirrored:
            values[..., 1] = 1 - values[..., 1]
        return self.add(np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8))

    def add(self, pixels: Pixels) -> str:
        """Name of the file of pixels [H, W] or [H, W, C]; equal ones are one file."""
        key = hashlib.sha256(pixels.tobytes() + repr(pixels.shape).encode()).hexdigest()
        if key not in self._names:
            self._names[key] = name = f"image{len(self.files)}"
            self.files[name] = encode_png(pixels)
        return self._names[key]

    def _linear(self, layer: Layer) -> NDArray[np.float64]:
        """Linear values [H, W, C] of a layer's image, with C = 1 or 3."""
        assert layer.image is not None
        image = self._images[layer.image.image]
        values = image[..., :3].astype(np.float64)
        if image.dtype == np.uint8:
            values = values / 255
            if not layer.image.raw:
                values = np.asarray(linear_from_srgb(values), np.float64)
        return np.maximum(values, 0) ** layer.exponent


def resized(pixels: Pixels, height: int, width: int) -> Pixels:
    """Pixels [H, W] in another size, interpolated linearly."""
    if pixels.shape == (height, width):
        return pixels
    return np.asarray(
        PillowImage.fromarray(pixels).resize((width, height), PillowImage.Resampling.BILINEAR)
    )
