"""The emitter and the glass of a lamp's own shapes, where an image shows the model of an asset.

The light of a lamp reaches a scene from its exitant light field. Its shapes therefore emit only
where a path shows the lamp, and next-event estimation does not sample them. The integrator
`lumitree_path` makes this distinction; others see shapes that do not emit.

Glass bends the rays of an image. Elsewhere light crosses it straight, with its Fresnel
transmittance: shadow rays, and rays after a vertex that is not specular. Else next-event estimation
could not find a light behind glass, and paths would find its caustics by chance.
"""

from typing import Any, Protocol, runtime_checkable

import drjit as dr
import mitsuba as mi

# Marks a BSDF that light crosses straight, in `flags()`; Mitsuba does not use this bit.
CROSSED_STRAIGHT = 1 << 24


@runtime_checkable
class ModelEmitter(Protocol):
    """Emitter of a shape of a lamp's model."""

    def eval_own(self, si: Any, active: Any) -> tuple[Any, Any]:
        """Light of the lamp itself that leaves its surface.

        Args:
            si: mi.SurfaceInteraction3f on the shape.
            active: mi.Bool mask.

        Returns:
            mi.Color3f, radiance towards `si.wi`; and mi.Bool, whether it includes all light of the
            lamp that the surface reflects, so that the rest of the path adds none.
        """
        ...


def model_emitter_class() -> type:
    """Class of the emitter for the variant of Mitsuba that is set, whose base class it extends."""

    class LumitreeModelEmitter(mi.Emitter):
        def __init__(self, radiance: Any, reflected: Any = None) -> None:
            """Emitter of one shape.

            Args:
                radiance: mi.Texture, what the front of the surface emits; None for nothing.
                reflected: function that returns the light of the lamp that the surface reflects,
                    mi.Color3f, for an interaction and a mask; None if paths have to find it.
            """
            props = mi.Properties("lumitree_model")
            props["sampling_weight"] = 0.0
            super().__init__(props)
            self._radiance, self._reflected = radiance, reflected
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def eval_own(self, si, active):
            if self._radiance is not None:
                front = active & (mi.Frame3f.cos_theta(si.wi) > 0)
                emitted = mi.Color3f(self._radiance.eval(si, front))
                return dr.select(front, emitted, 0), mi.Bool(False)
            if self._reflected is not None:
                return self._reflected(si, active), mi.Bool(True)
            return mi.Color3f(0), mi.Bool(False)

        def eval(self, si, active=True):
            return mi.Color3f(0)

        def sample_direction(self, it, sample, active=True):
            return dr.zeros(mi.DirectionSample3f), mi.Color3f(0)

        def pdf_direction(self, it, ds, active=True):
            return mi.Float(0)

        def eval_direction(self, it, ds, active=True):
            return mi.Color3f(0)

        def to_string(self) -> str:
            return "LumitreeModelEmitter[]"

    return LumitreeModelEmitter


def model_glass_class() -> type:
    """Class of the glass for the variant of Mitsuba that is set, whose base class it extends."""

    class LumitreeModelGlass(mi.BSDF):
        def __init__(self, glass: Any) -> None:
            """A smooth dielectric that light may also cross straight.

            Args:
                glass: mi.BSDF, whose second component is a specular transmission.
            """
            super().__init__(mi.Properties("lumitree_glass"))
            self._glass = glass
            self.m_components = list(glass.m_components)
            # Null surfaces are asked for their transmittance in shadow rays.
            self.m_flags = int(glass.m_flags) | int(mi.BSDFFlags.Null) | CROSSED_STRAIGHT
            self._transmission = mi.BSDFContext()
            self._transmission.component = 1

        def sample(self, ctx, si, sample1, sample2, active=True):
            return self._glass.sample(ctx, si, sample1, sample2, active)

        def eval(self, ctx, si, wo, active=True):
            return mi.Color3f(0)

        def pdf(self, ctx, si, wo, active=True):
            return mi.Float(0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return mi.Color3f(0), mi.Float(0)

        def eval_null_transmission(self, si, active=True):
            # By the angle outside the glass on both sides: a ray that leaves a pane has the same
            # angle outside as where it entered. Seen from inside it would be totally reflected.
            outside = mi.SurfaceInteraction3f(si)
            outside.wi = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
            unused = mi.Float(0.5), mi.Point2f(0.5)
            bs, weight = self._glass.sample(self._transmission, outside, *unused, active)
            # Without the compression of radiance in a denser medium.
            return mi.Color3f(weight * dr.square(bs.eta)) & active

        def to_string(self) -> str:
            return f"LumitreeModelGlass[{self._glass}]"

    return LumitreeModelGlass
