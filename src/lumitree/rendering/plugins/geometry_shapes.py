"""The shapes of an asset's geometry in a scene."""

from __future__ import annotations

import weakref
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.geometry import AssetGeometry, Medium, MeshArrays, Shape, UnitShape
from lumitree.asset.materials import Dielectric, Material, is_specular
from lumitree.asset.materials import Radiance as ShapeRadiance
from lumitree.core.device import transforms_as_parameters
from lumitree.core.frames import LocalFrame, similarity_scale
from lumitree.core.mitsuba_meshes import make_mesh
from lumitree.rendering.plugins.geometry_materials import Materials, Radiance
from lumitree.rendering.plugins.geometry_plugins import geometry_emitter_class, geometry_glass_class
from lumitree.rendering.plugins.objects import make_object, make_properties
from lumitree.rendering.sampling.emitting_elements import EmittingSurface, emitting_surface
from lumitree.rendering.sampling.straight_light import StraightLight

_STRAIGHT: weakref.WeakKeyDictionary[Asset, dict[str, StraightLight]] = weakref.WeakKeyDictionary()
_SURFACES: weakref.WeakKeyDictionary[AssetGeometry, dict[str, _Surfaces]] = (
    weakref.WeakKeyDictionary()
)


def geometry_shapes(
    geometry: AssetGeometry, scene_from_world: NDArray[np.float64], lamp: Any
) -> list[mi.Shape]:
    """The shapes of an asset's geometry.

    Args:
        scene_from_world: [4, 4] similarity, from the frame of the luminaire's file to the scene.
        lamp: emitter `lumitree` of the proxy, whose gain applies to the shapes too.
    """
    builder = _Builder(geometry, scene_from_world, lamp)
    return [
        builder.shape(shape, mesh)
        for shape, mesh in zip(geometry.shapes, geometry.meshes(), strict=True)
    ]


def straight_light(asset: Asset) -> StraightLight | None:
    """The emitters of an asset's geometry, shared by all instances of a lamp; None without any."""
    geometry = asset.geometry
    assert geometry is not None
    lights, key = _STRAIGHT.setdefault(asset, {}), str(mi.variant())
    if key not in lights:
        surfaces = emitting_surfaces(geometry, asset.frame)
        if not surfaces:
            return None
        half_extents = asset.frame.half_extents
        light = StraightLight(surfaces, asset.light_field, half_extents, asset.light_factors)
        return lights.setdefault(key, light)
    return lights[key]


def emitting_surfaces(geometry: AssetGeometry, frame: LocalFrame) -> list[EmittingSurface]:
    """The shapes of a geometry that emit, in the local frame."""
    matrix = frame.local_from_world @ geometry.file_from_geometry
    found = []
    for shape, mesh in zip(geometry.shapes, geometry.meshes(), strict=True):
        if shape.radiance is not None:
            radiance = _surfaces(geometry).emitted(shape.radiance)
            source = radiance if radiance.constant is None else radiance.constant
            found.append(emitting_surface(shape, mesh, source, matrix))
    return found


class _Builder:
    def __init__(
        self, geometry: AssetGeometry, scene_from_world: NDArray[np.float64], lamp: Any
    ) -> None:
        self._geometry, self._lamp = geometry, lamp
        # From the geometry's coordinates, in double precision: they may be far from the file's.
        self._matrix = scene_from_world @ geometry.file_from_geometry
        straight = lamp.straight
        self._densities = iter([] if straight is None else straight.densities)
        # All shapes of one medium share an object.
        self._media: dict[Medium, mi.Medium] = {}
        self._scale = similarity_scale(scene_from_world, "to_world")
        self._emitter = geometry_emitter_class()
        self._surfaces = _surfaces(geometry)

    def shape(self, shape: Shape, mesh: MeshArrays | None) -> mi.Shape:
        """A shape of the geometry, with its BSDF and its emitter."""
        material = self._geometry.materials[shape.material]
        radiance = shape.radiance
        bsdf = self._surfaces.bsdf(shape)
        values = {"flip_normals": shape.flipped, "bsdf": bsdf}
        # A surface that shows other things needs no emitter: it neither emits nor scatters.
        emitted = None if radiance is None else self._surfaces.emitted(radiance)
        if radiance is not None or not is_specular(material):
            density = 0.0
            if emitted is not None:
                density = next(self._densities) / self._lamp.placed.numbers[0] ** 2
            values["emitter"] = self._emitter(self._lamp, emitted, density)
        values |= {side: self._medium(medium) for side, medium in shape.media.items()}
        if isinstance(shape, UnitShape):
            matrix = self._matrix @ np.array(shape.to_world, np.float64)
            values["to_world"] = mi.ScalarTransform4d(matrix)
            made = make_object(shape.type, values)
            transforms_as_parameters([made])
        else:
            assert mesh is not None
            made = self._mesh(mesh, make_properties("", values))
        return made

    def _mesh(self, mesh: MeshArrays, props: mi.Properties) -> mi.Mesh:
        rotation = self._matrix[:3, :3] / self._scale
        vertices = mesh["vertices"] @ self._matrix[:3, :3].T + self._matrix[:3, 3]
        placed = {**mesh, "vertices": vertices, "normals": mesh["normals"] @ rotation.T}
        return make_mesh("geometry", placed, props)

    def _medium(self, medium: Medium) -> mi.Medium:
        """A medium, whose coefficients are per unit of the file."""
        if medium not in self._media:
            absorption, scattering = np.array(medium.absorption), np.array(medium.scattering)
            extinction = absorption + scattering
            densest = max(*extinction, 1e-30)
            albedo = scattering / np.maximum(extinction, 1e-30)
            phase = make_object("hg", {"g": medium.anisotropy})
            self._media[medium] = make_object(
                "homogeneous",
                {
                    "sigma_t": mi.ScalarColor3d(extinction / densest),
                    "albedo": mi.ScalarColor3d(albedo),
                    "scale": densest / self._scale,
                    "phase": phase if medium.anisotropy else make_object("isotropic", {}),
                },
            )
        return self._media[medium]


def _surfaces(geometry: AssetGeometry) -> _Surfaces:
    """BSDFs and textures of an asset's geometry, made on first use."""
    known, variant = _SURFACES.setdefault(geometry, {}), str(mi.variant())
    if variant not in known:
        # Mitsuba creates plugins in parallel: of two, the first is kept.
        return known.setdefault(variant, _Surfaces(geometry))
    return known[variant]


class _Surfaces:
    """The BSDFs and textures of an asset's geometry, which its instances share."""

    def __init__(self, geometry: AssetGeometry) -> None:
        self._materials, self._glass = Materials(geometry.images), geometry_glass_class()
        self._bsdfs = [self._materials.bsdf(material) for material in geometry.materials]
        self._crossed = list(map(self._top, geometry.materials, self._bsdfs))

    def bsdf(self, shape: Shape) -> mi.BSDF:
        """The BSDF of a shape of the geometry.

        Glass around a medium that scatters is not crossed straight: light that scatters in it
        leaves it by refraction, or is reflected back totally.
        """
        straight = not shape.scatters
        return (self._crossed if straight else self._bsdfs)[shape.material]

    def emitted(self, radiance: ShapeRadiance) -> Radiance:
        """Radiance of a shape."""
        return self._materials.radiance(radiance)

    def _top(self, material: Material, bsdf: mi.BSDF) -> mi.BSDF:
        return self._glass(bsdf) if isinstance(material, Dielectric) else bsdf
