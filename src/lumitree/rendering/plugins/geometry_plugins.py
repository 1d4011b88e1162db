"""The emitter and the glass of a lamp's own shapes, where an image shows the geometry of an asset.

The light of a lamp reaches a scene from its light field. Its shapes therefore emit only
where a path shows the lamp, and next-event estimation of the scene does not sample them. Where a
path shows a rough surface of the lamp, next-event estimation of the lamp's own light does. The
integrator `lumitree_path` makes this distinction; others see shapes that do not emit.

Glass bends the rays of an image. Elsewhere light crosses it straight, with its Fresnel
transmittance: shadow rays, and rays after a vertex that is not specular. Else next-event estimation
could not find a light behind glass, and paths would find its caustics by chance.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.device import parameter
from lumitree.lamp.emitting_surfaces import EmittingSurfaces
from lumitree.rendering.plugins.delta_bsdf import delta_bsdf_class
from lumitree.rendering.plugins.geometry_materials import Radiance
from lumitree.rendering.plugins.objects import make_properties
from lumitree.rendering.sampling.self_lights import SelfLights

# Marks a BSDF that light crosses straight, in `flags()`; Mitsuba does not use this bit.
CROSSED_STRAIGHT = 1 << 24


@runtime_checkable
class GeometryEmitter(Protocol):
    """Emitter of a shape of a lamp's geometry, which `lumitree_path` evaluates."""

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
            Radiance towards `si.wi`; and density per steradian with which a point of the shape that
            `sample_self_emission` gave has this direction from `it`.
        """
        ...

    def sample_self_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Sample a direction from a vertex to the shape.

        Returns:
            The direction, whose `pdf` is the one of `eval_self_emission` but for the probability of
            the shape; and radiance over the density per steradian with which it was sampled.
        """
        ...


def geometry_emitter_class() -> type:
    """Class of the emitter for the variant of Mitsuba that is set, whose base class it extends."""

    class LumitreeGeometryEmitter(mi.Emitter):
        def __init__(
            self,
            lamp: Any,
            lights: SelfLights,
            radiance: Radiance | None = None,
            index: int = 0,
        ) -> None:
            """Emitter of shape `index` of `lights`; `lamp` is the emitter of the proxy."""
            super().__init__(make_properties("lumitree_geometry", {"sampling_weight": 0.0}))
            self._lamp, self._lights = lamp, lights
            self._gain = parameter(mi.Color3f, *lamp.placed.asset.gain)
            self._radiance, self._index = radiance, index
            self._surfaces: EmittingSurfaces | None = None
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def eval_self_emission(self, si, it, ds, active):
            if self._radiance is None:
                return mi.Spectrum(0), mi.Float(0)
            pdf = self.get_shape().pdf_direction(it, ds, active) * self._lights.pmf(self._index)
            return self._eval(si, active), pdf

        def complete(self, shape: mi.Shape) -> float:
            """Prepare sampling of the shape that has this emitter; returns its power, relative."""
            assert self._radiance is not None
            if self._radiance.constant is not None:
                mean, area = dr.mean(self._radiance.constant), shape.surface_area()
                return float(np.ravel(mean)[0] * np.ravel(area)[0])
            radiance = self._radiance
            self._surfaces = EmittingSurfaces([shape], lambda si, _: radiance(si, mi.Bool(True)))
            return self._surfaces.power

        def sample_self_direction(self, it, sample, active):
            if self._radiance is None:
                return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0)
            shape = self.get_shape()
            if self._surfaces is None:
                ds = shape.sample_direction(it, sample, active)
                si = mi.SurfaceInteraction3f(ds, it.wavelengths)
                si.wi, pdf = mi.Vector3f(0, 0, -dr.dot(ds.d, ds.n)), ds.pdf
            else:
                point = self._surfaces.sample(sample, active)
                (ds, pdf), si = point.towards(it), point.si
                ds.pdf = shape.pdf_direction(it, ds, active)
            return ds, dr.select(pdf > 0, self._eval(si, active) / pdf, 0)

        def _eval(self, si, active):
            assert self._radiance is not None
            front = active & (mi.Frame3f.cos_theta(si.wi) > 0)
            radiance = self._lamp.factor * self._gain * self._radiance(si, front)
            return dr.select(front, self._lamp.light_colour(radiance, si.wavelengths), 0)

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
