"""The shapes of an asset's geometry in a scene: their BSDFs, their glass and their emitters.

The bent light of a lamp reaches a scene from its light field, and its straight light from its
shapes. Mitsuba's emitter sampling does not find these, but emitter sampling of the lamp does
(`straight_light`). At vertices on the lamp, they emit only where the path shows the lamp. The
integrator `lumitree_path` makes this distinction; others get shapes that do not emit.

Glass bends the rays of an image. Elsewhere light crosses it straight, with its Fresnel
transmittance: shadow rays, and rays after a vertex that is not specular. Otherwise next-event
estimation could not find a light behind glass, and paths would find its caustics rarely.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset import materials as asset_materials
from lumitree.asset.geometry import AssetGeometry, Medium, MeshArrays, Shape, UnitShape
from lumitree.asset.materials import (
    Dielectric,
    Image,
    Material,
    Parameter,
    Texture,
    VertexColours,
    is_specular,
)
from lumitree.core.device import parameter, transforms_as_parameters
from lumitree.core.frames import LocalFrame, similarity_scale
from lumitree.core.mitsuba_meshes import (
    VERTEX_COLOUR,
    change_mesh,
    hidden_mesh_class,
    keep_apart,
    make_mesh,
)
from lumitree.rendering.objects import load_ordered, make_object, make_properties, shape_of
from lumitree.rendering.straight_light import EmittingSurface, emitting_surface
from lumitree.trace.spawning import on_opposite_sides

# Marks a BSDF that light crosses straight, in `flags()`; Mitsuba does not use this bit.
CROSSED_STRAIGHT = 1 << 24
# Parts of a shape that are parameters of a scene; its arrays follow the lamp.
_SHOWN = ("bsdf", "interior_medium", "exterior_medium")


def geometry_shapes(scene_from_world: NDArray[np.float64], lamp: Any) -> list[mi.Shape]:
    """The shapes of the geometry of a lamp's asset.

    Args:
        scene_from_world: [4, 4] similarity, from the frame of the luminaire's file to the scene.
        lamp: the `PlacedLamp` at this place, whose factor applies to the shapes too.
    """
    geometry = lamp.asset.geometry
    assert geometry is not None
    surfaces, straight = lamp.device.surfaces, lamp.device.straight
    # From the geometry's coordinates, in double precision: they may be far from the file's.
    matrix = scene_from_world @ geometry.file_from_geometry
    scale, emitter = similarity_scale(scene_from_world, "to_world"), geometry_emitter_class()
    densities = iter([] if straight is None else straight.densities)
    # All shapes of one medium share an object.
    media: dict[Medium, mi.Medium] = {}
    made, mesh_class = [], hidden_mesh_class()
    for shape, mesh in zip(geometry.shapes, geometry.meshes(), strict=True):
        values: dict[str, object] = {
            "flip_normals": shape.flipped,
            "bsdf": surfaces.bsdf(shape),
        }
        # A surface that shows other things needs no emitter: it neither emits nor scatters.
        if shape.radiance is not None:
            radiance = surfaces.materials.radiance(shape.radiance)
            values["emitter"] = emitter(lamp, radiance, next(densities))
        elif not is_specular(geometry.materials[shape.material]):
            values["emitter"] = emitter(lamp)
        for side, medium in shape.media.items():
            if medium not in media:
                media[medium] = _medium(medium, scale)
            values[side] = media[medium]
        if isinstance(shape, UnitShape):
            to_world = matrix @ np.array(shape.to_world, np.float64)
            values["to_world"] = mi.ScalarTransform4d(to_world)
            made.append(make_object(shape.type, values))
            transforms_as_parameters(made[-1:])
        else:
            assert mesh is not None
            moved = mesh | _moved(mesh, matrix)
            properties = make_properties("", values)
            made.append(make_mesh("geometry", moved, properties, mesh_class))
            if "emitter" not in values:
                keep_apart(made[-1])
            made[-1].shown = _SHOWN
    return made


def move_geometry(lamp: Any) -> None:
    """Move the shapes of `geometry_shapes` to the pose of their lamp."""
    if not lamp.shape_numbers:
        return
    geometry, scene_from_world = lamp.asset.geometry, lamp.scene_from_world
    matrix = scene_from_world @ geometry.file_from_geometry
    scale = similarity_scale(scene_from_world, "to_world")
    shapes = map(shape_of, lamp.shape_numbers)
    for made, shape, mesh in zip(shapes, geometry.shapes, geometry.meshes(), strict=True):
        if isinstance(shape, UnitShape):
            parameters = mi.traverse(made)
            parameters["to_world"] = mi.Transform4f(matrix @ np.array(shape.to_world, np.float64))
            parameters.update()
            transforms_as_parameters([made])
        elif isinstance(made, mi.Mesh):
            change_mesh(made, _moved(mesh, matrix))
        for side, medium in shape.media.items():
            parameters = mi.traverse(getattr(made, side)())
            parameters["scale"] = _densest(medium) / scale
            parameters.update()


def _moved(mesh: MeshArrays, matrix: NDArray[np.float64]) -> MeshArrays:
    """Vertices and normals of a mesh, moved by a similarity."""
    rotation = matrix[:3, :3] / similarity_scale(matrix)
    vertices = mesh["vertices"] @ matrix[:3, :3].T + matrix[:3, 3]
    normals = {"normals": mesh["normals"] @ rotation.T} if len(mesh["normals"]) else {}
    return {"vertices": vertices, **normals}


def _densest(medium: Medium) -> float:
    """The largest extinction of a medium, per unit of the file."""
    return max(*(np.array(medium.absorption) + medium.scattering).tolist(), 1e-30)


def _medium(medium: Medium, scale: float) -> mi.Medium:
    """A medium, whose coefficients are per unit of the file."""
    absorption, scattering = np.array(medium.absorption), np.array(medium.scattering)
    extinction, densest = absorption + scattering, _densest(medium)
    albedo = scattering / np.maximum(extinction, 1e-30)
    phase = make_object("hg", {"g": medium.anisotropy})
    values = {
        "sigma_t": mi.ScalarColor3d(extinction / densest),
        "albedo": mi.ScalarColor3d(albedo),
        "scale": densest / scale,
        "phase": phase if medium.anisotropy else make_object("isotropic", {}),
    }
    return make_object("homogeneous", values)


class Surfaces:
    """The BSDFs and textures of an asset's geometry, which its instances share."""

    def __init__(self, geometry: AssetGeometry) -> None:
        self._geometry, self.materials = geometry, Materials(geometry.images)
        glass = geometry_glass_class()
        self._bsdfs = [self.materials.bsdf(material) for material in geometry.materials]
        self._crossed = [
            glass(bsdf) if isinstance(material, Dielectric) else bsdf
            for material, bsdf in zip(geometry.materials, self._bsdfs, strict=True)
        ]

    def bsdf(self, shape: Shape) -> mi.BSDF:
        """The BSDF of a shape of the geometry.

        Glass around a medium that scatters is not crossed straight: light that scatters in it
        leaves it by refraction, or is reflected back totally.
        """
        straight = not shape.scatters
        return (self._crossed if straight else self._bsdfs)[shape.material]

    def emitting(self, frame: LocalFrame) -> list[EmittingSurface]:
        """The shapes that emit, in the local frame."""
        geometry, found = self._geometry, []
        matrix = frame.local_from_world @ geometry.file_from_geometry
        for shape, mesh in zip(geometry.shapes, geometry.meshes(), strict=True):
            if shape.radiance is not None:
                radiance = self.materials.radiance(shape.radiance)
                source = radiance if radiance.constant is None else radiance.constant
                found.append(emitting_surface(shape, mesh, source, matrix))
        return found


class Radiance:
    """RGB radiance of the front of a surface.

    Args:
        source: a texture that has it, or R, G and B.

    Attributes:
        constant: the radiance if it is everywhere the same, else None.
    """

    def __init__(self, source: mi.Texture | Sequence[float]) -> None:
        self.constant: NDArray[np.float64] | None = None
        if isinstance(source, mi.Texture):
            self._texture = source
        else:
            self.constant = np.array(source, np.float64)
            self._colour = parameter(mi.Color3f, *source)

    def __call__(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Color3f:
        if self.constant is not None:
            return self._colour
        if mi.is_spectral:
            return self._texture.eval_3(si, active)
        return mi.Color3f(self._texture.eval(si, active))


class Materials:
    """Makes BSDFs; equal textures are made once."""

    def __init__(self, images: Sequence[Image]) -> None:
        """Materials whose textures are of these images, see `AssetGeometry.images`."""
        self._images = images
        self._textures: dict[Texture | VertexColours, mi.Texture] = {}

    def bsdf(self, material: Material) -> mi.BSDF:
        """The BSDF of a material."""
        values = {f"nested_{i}": self.bsdf(nested) for i, nested in enumerate(material.nested)}
        values |= {name: self._value(value) for name, value in material.parameters.items()}
        return make_object(material.plugin, values)

    def _value(self, value: Parameter) -> Any:
        if isinstance(value, tuple):
            return mi.ScalarColor3d(list(value))
        if isinstance(value, Texture | VertexColours):
            return self._texture(value)
        # JSON writes 1.0 as 1, too; Mitsuba refuses an integer as an index of refraction.
        return float(value) if type(value) is int else value

    def radiance(self, radiance: asset_materials.Radiance) -> Radiance:
        """Emission of a shape."""
        if not isinstance(radiance, Texture):
            return Radiance(np.broadcast_to(radiance, 3).tolist())
        if not mi.is_spectral:
            values = {"radiance": self._value(radiance)}
            return Radiance(make_properties("", values).get_emissive_texture("radiance"))
        description = self._description(radiance)
        pixels = mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False
        description["bitmap"] = description["bitmap"].convert(*pixels)
        return Radiance(load_ordered(description | {"raw": True}))

    def _texture(self, texture: Texture | VertexColours) -> mi.Texture:
        if texture not in self._textures:
            self._textures[texture] = load_ordered(self._description(texture))
        return self._textures[texture]

    def _description(self, texture: Texture | VertexColours) -> dict[str, Any]:
        if isinstance(texture, VertexColours):
            return {"type": "mesh_attribute", "name": VERTEX_COLOUR}
        image = self._images[texture.image]
        bitmap = mi.Bitmap(np.ascontiguousarray(image))
        bitmap.set_srgb_gamma(image.dtype == np.uint8 and not texture.raw)
        return {
            "type": "bitmap",
            "bitmap": bitmap,
            "raw": texture.raw,
            "filter_type": texture.filter_type,
            "wrap_mode": texture.wrap_mode,
            "to_uv": mi.ScalarTransform4f(np.array(texture.to_uv)),
        }


@runtime_checkable
class GeometryEmitter(Protocol):
    """Emitter of a shape of a lamp's geometry, which `lumitree_path` evaluates.

    Attributes:
        traced: whether the lamp's straight light comes from its shapes.
    """

    traced: bool

    def eval_self_emission(
        self,
        si: mi.SurfaceInteraction3f,
        it: mi.Interaction3f,
        ds: mi.DirectionSample3f,
        active: mi.Bool,
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Radiance of a point that a ray has hit.

        Args:
            si: the point, on the shape.
            it: the vertex that the ray comes from.
            ds: from `it` to the point.

        Returns:
            Radiance towards `si.wi`; and the density per steradian that multiple importance
            sampling takes for emitter sampling of the lamp (`Target.density`).
        """
        ...


def geometry_emitter_class() -> type:
    """Class of the emitter for the variant of Mitsuba that is set, whose base class it extends."""

    class LumitreeGeometryEmitter(mi.Emitter):
        def __init__(
            self, lamp: Any, radiance: Radiance | None = None, density: float = 0.0
        ) -> None:
            """Emitter of a shape of a `PlacedLamp`.

            Args:
                radiance: of the shape; None if it is black.
                density: of `StraightLight.densities`.
            """
            super().__init__(make_properties("lumitree_geometry", {"sampling_weight": 0.0}))
            self._lamp, self._radiance = lamp, radiance
            self._factors = parameter(mi.Color3f, *lamp.asset.light_factors)
            self._density = parameter(mi.Float, density)
            self.traced = lamp.traces_straight_light
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def traverse(self, callback):
            """It has no parameters: not even its weight, 0, has an effect."""

        def eval_self_emission(self, si, it, ds, active):
            if self._radiance is None:
                return mi.Spectrum(0), mi.Float(0)
            density = self._density / dr.square(self._lamp.scale)
            pdf = density * dr.square(ds.dist) / dr.abs(dr.dot(ds.d, si.n))
            # As light paths do: on the side of the true normal, too.
            arriving, facing = -si.to_world(si.wi), mi.Vector3f(si.sh_frame.n)
            behind = on_opposite_sides(si, arriving, facing)
            front = active & (mi.Frame3f.cos_theta(si.wi) > 0) & ~behind
            radiance = self._lamp.factor * self._factors * self._radiance(si, front)
            return dr.select(front, self._lamp.colour(radiance, si.wavelengths), 0), pdf

        def eval(self, si, active=True):
            return mi.Spectrum(0)

        def sample_direction(self, it, sample, active=True):
            return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0)

        def pdf_direction(self, it, ds, active=True):
            return mi.Float(0)

        def eval_direction(self, it, ds, active=True):
            return mi.Spectrum(0)

        def sample_ray(self, time, sample1, sample2, sample3, active=True):
            # `ptracer` compiles this for the emitters of every scene in the process.
            return dr.zeros(mi.Ray3f), mi.Spectrum(0)

        def to_string(self) -> str:
            return "LumitreeGeometryEmitter[]"

    return LumitreeGeometryEmitter


def geometry_glass_class() -> type:
    """Class of the glass for the variant of Mitsuba that is set, whose base class it extends."""

    class LumitreeGeometryGlass(delta_bsdf_class()):
        def __init__(self, glass: mi.BSDF) -> None:
            """The second component of `glass` is a specular transmission."""
            super().__init__(make_properties("lumitree_glass", {}))
            self._glass = glass
            self.m_components = list(glass.m_components)
            # Shadow rays get the transmittance of null surfaces.
            self.m_flags = int(glass.m_flags) | int(mi.BSDFFlags.Null) | CROSSED_STRAIGHT
            self._transmission = mi.BSDFContext()
            self._transmission.component = 1

        def sample(self, ctx, si, sample1, sample2, active=True):
            return self._glass.sample(ctx, si, sample1, sample2, active)

        def eval_null_transmission(self, si, active=True):
            # By the angle outside the glass on both sides: a ray that leaves a pane has the same
            # angle outside as where it entered. Seen from inside it would be totally reflected.
            outside = mi.SurfaceInteraction3f(si)
            outside.wi = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
            unused = mi.Float(0.5), mi.Point2f(0.5)
            bs, weight = self._glass.sample(self._transmission, outside, *unused, active)
            # Without the compression of radiance in a denser medium.
            return mi.Spectrum(weight * dr.square(bs.eta)) & active

        def to_string(self) -> str:
            return f"LumitreeGeometryGlass[{self._glass}]"

    return LumitreeGeometryGlass


def delta_bsdf_class() -> type:
    """Base class for the variant of Mitsuba that is set: a BSDF that is 0 for given directions."""

    class DeltaBSDF(mi.BSDF):
        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(0)

        def pdf(self, ctx, si, wo, active=True):
            return mi.Float(0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return mi.Spectrum(0), mi.Float(0)

    return DeltaBSDF
