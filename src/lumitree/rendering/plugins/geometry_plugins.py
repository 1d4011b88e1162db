"""The emitter and the glass of a lamp's own shapes, where an image shows the geometry of an asset.

The bent light of a lamp reaches a scene from its light field, and its straight light from its
shapes. Mitsuba's emitter sampling does not find these, but emitter sampling of the lamp does
(`sampling.straight_light`). At vertices on the lamp, they emit only where the path shows the lamp.
The integrator `lumitree_path` makes this distinction; others see shapes that do not emit.

Glass bends the rays of an image. Elsewhere light crosses it straight, with its Fresnel
transmittance: shadow rays, and rays after a vertex that is not specular. Else next-event estimation
could not find a light behind glass, and paths would find its caustics by chance.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import drjit as dr
import mitsuba as mi

from lumitree.core.device import parameter
from lumitree.rendering.plugins.delta_bsdf import delta_bsdf_class
from lumitree.rendering.plugins.geometry_materials import Radiance
from lumitree.rendering.plugins.objects import make_properties

# Marks a BSDF that light crosses straight, in `flags()`; Mitsuba does not use this bit.
CROSSED_STRAIGHT = 1 << 24


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
            """Emitter of a shape of the lamp whose proxy has the emitter `lamp`.

            Args:
                radiance: of the shape; None if it is black.
                density: of `StraightLight.densities`, scene units.
            """
            super().__init__(make_properties("lumitree_geometry", {"sampling_weight": 0.0}))
            self._lamp, self._radiance = lamp, radiance
            self._gain = parameter(mi.Color3f, *lamp.placed.asset.light_factors)
            self._density = parameter(mi.Float, density)
            self.traced = lamp.placed.traces_straight_light
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def eval_self_emission(self, si, it, ds, active):
            if self._radiance is None:
                return mi.Spectrum(0), mi.Float(0)
            pdf = self._density * dr.square(ds.dist) / dr.abs(dr.dot(ds.d, si.n))
            front = active & (mi.Frame3f.cos_theta(si.wi) > 0)
            radiance = self._lamp.factor * self._gain * self._radiance(si, front)
            return dr.select(front, self._lamp.light_colour(radiance, si.wavelengths), 0), pdf

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
            # Null surfaces are asked for their transmittance in shadow rays.
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
