"""The shapes of an asset's geometry as meshes with materials, as glTF and USD share them."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.textures import Json, texture_map, textures_of
from lumitree.core.frames import similarity
from lumitree.core.photometry import RGB
from lumitree.output.geometry_meshes import (
    MIRRORED_PARTLY,
    MIXED,
    Arrays,
    geometry_meshes,
    mirrored_share,
)
from lumitree.output.pbr import Layer, PbrMaterial, PbrMaterials

# Lines that are true of every lamp with surfaces.
LOST_SHADOWS = "the lights illuminate the lamp's own surfaces without its shadows"
LOST_GLOW = "surfaces that emit illuminate a second time where a path tracer shows them"


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """A mesh and its material, with lengths in metres.

    Attributes:
        mesh: `vertices` [V, 3] and `faces` [F, 3]; `normals` [V, 3] of length 1 if it is smooth;
            `colours` [V, 3] if its material has those of its vertices.
        material: of the mesh.
        uv: [V, 2] coordinates for each map of `maps`; row 0 of an image is at v = 0.
        maps: the different maps of texture coordinates that the material has.
        thickness: m, twice the enclosed volume over the area, if light is refracted; else 0.
    """

    mesh: Arrays
    material: PbrMaterial
    uv: list[NDArray[np.float32]]
    maps: list[Any]
    thickness: float

    def uv_set(self, texture: Json) -> int:
        """Number of the coordinates of a texture."""
        return self.maps.index(texture["to_uv"])

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
    geometry = asset.geometry
    if geometry is None:
        return [], ["the asset has no geometry: the lamp itself is not shown"]
    materials, found = PbrMaterials(geometry, asset.gain), []
    meshes = geometry_meshes(geometry, similarity(turn))
    for shape, mesh in zip(geometry.shapes, meshes, strict=True):
        material = materials.of(shape)
        if material.normal is not None:
            share = mirrored_share(mesh)
            material = dataclasses.replace(material, normal_mirrored=share > 0.5)
            if MIXED < share < 1 - MIXED:
                materials.lost.add(MIRRORED_PARTLY)
        used = textures_used(material)
        maps: list[Any] = []
        for texture in used:
            if "image" in texture and texture["to_uv"] not in maps:
                maps.append(texture["to_uv"])
        if maps and "texcoords" not in mesh:
            materials.lost.add("images on meshes without texture coordinates have one colour")
        texcoords = mesh.get("texcoords", np.full((len(mesh["vertices"]), 2), 0.5))
        arrays: Arrays = {"vertices": mesh["vertices"], "faces": mesh["faces"]}
        if "normals" in mesh:
            arrays["normals"] = _unit(mesh["normals"])
        if any("attribute" in texture for texture in used):
            arrays["colours"] = mesh["colours"]
        uv = [texture_map(each, texcoords).astype(np.float32) for each in maps]
        if not (material.emission.is_black or _is_closed(mesh)):
            materials.lost.add("surfaces that emit and enclose nothing emit from their backs too")
        refracts = not (material.transmission.is_black or material.thin)
        thickness = _thickness(mesh) if refracts else 0.0
        found.append(Surface(arrays, material, uv, maps, thickness))
    return found, sorted(materials.lost)


def textures_used(material: PbrMaterial) -> list[Json]:
    """The textures of a material."""
    values = (getattr(material, field.name) for field in dataclasses.fields(material))
    found = [each.texture if isinstance(each, Layer) else each for each in values]
    return list(textures_of([each for each in found if isinstance(each, dict)]))


def _unit(normals: NDArray[np.floating]) -> NDArray[np.float32]:
    """Normals of length 1; normals of length 0 become upward normals."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    safe = np.where(length > 0, normals / np.maximum(length, 1e-30), [0.0, 1.0, 0.0])
    return safe.astype(np.float32)


def _is_closed(mesh: Arrays) -> bool:
    """Whether a mesh encloses a volume, so that nobody sees its back."""
    from trimesh import Trimesh

    return Trimesh(mesh["vertices"], mesh["faces"]).is_watertight


def _thickness(mesh: Arrays) -> float:
    """Twice the enclosed volume over the area: for a shell, the thickness of its wall."""
    first, second, third = np.moveaxis(mesh["vertices"][mesh["faces"]].astype(np.float64), 1, 0)
    middle = mesh["vertices"].mean(axis=0, dtype=np.float64)
    cross = np.cross(second - first, third - first)
    area = np.linalg.norm(cross, axis=1).sum() / 2
    volume = abs(((first - middle) * cross).sum()) / 6
    return float(2 * volume / area) if area > 0 else 0.0
