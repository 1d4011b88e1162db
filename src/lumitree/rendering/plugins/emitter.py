"""The emitter `lumitree`: what a baked luminaire sends out."""

from __future__ import annotations

import functools

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.arguments import check_gain
from lumitree.core.photometry import LUMENS_PER_WATT, luminance
from lumitree.errors import LumitreeError
from lumitree.rendering.plugins.geometry_shapes import straight_light
from lumitree.rendering.plugins.lamp_light import LampLight
from lumitree.rendering.plugins.light_colour import light_colour
from lumitree.rendering.plugins.objects import complete_later
from lumitree.rendering.plugins.placed import Placed
from lumitree.rendering.sampling.divided_sampling import emitter_sampler, left_out_radius


def emitter_class() -> type:
    """Class of the emitter for the variant of Mitsuba that is set, whose base class it extends.

    It is a `DeferredEmitter`. The face where a line enters the proxy has the radiance of the whole
    line; on the face where it leaves, radiance is 0. `gain` [3] (R, G, B) multiplies all radiance
    and flux, but neither transmittance nor densities. It is a differentiable parameter of
    `mitsuba.traverse`.
    """

    class LumitreeEmitter(mi.Emitter):
        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.placed = Placed(props)
            # Its tables are made while the scene is loaded, and not by the first image.
            complete_later(lambda: (self.sampler, self.straight, self.light_colour))
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying
            self.gain = mi.Color3f(*check_gain(props.get("gain", 1.0)))
            self._accept_gain()

        @functools.cached_property
        def sampler(self):
            placed = self.placed
            bent = placed.traces_straight_light
            return emitter_sampler(
                placed.asset, placed.field, placed.proxy, placed.sampling, bent=bent
            )

        @functools.cached_property
        def straight(self):
            return straight_light(self.placed.asset) if self.placed.shows_geometry else None

        @functools.cached_property
        def light_colour(self):
            return light_colour(self.placed.asset)

        def light(self):
            return LampLight(
                self.placed, self.sampler, self.straight, self.light_colour, self.factor
            )

        @property
        def factor(self):
            """Factor on the radiance of the asset: `gain`, less for larger absolute light."""
            return self.gain * self.placed.dimming

        def light_inside(self):
            placed = self.placed
            if self.sampler.includes_mis:
                self.sampler.light_inside()
                placed.holds = True

        def axis_intensities(self):
            gain = np.array(dr.detach(self._accepted), np.float64).ravel()
            return self.placed.axis_intensities * float(luminance(gain) / LUMENS_PER_WATT)

        def sampled_alone_radius(self):
            placed = self.placed
            if placed.dims or not self.sampler.includes_mis or self.sampling_weight() <= 0:
                return 0.0
            return placed.numbers[0] * left_out_radius(placed.asset) * (1 + 1e-4)

        def is_summed(self, point, active):
            outside = ~self.placed.in_box(self.placed.local_point(point))
            return active & outside & self.sampler.includes_mis

        def irradiance(self, point, n, random, active):
            line = self.placed.local_line(point, n)
            return self.factor * self.sampler.irradiance(*line, random, active)

        def traverse(self, callback):
            super().traverse(callback)
            callback.put("gain", self.gain, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys=()):
            if not keys or "gain" in keys:
                self._set_gain()

        def _set_gain(self):
            """Accept the value of `gain`, or raise and return to the one before."""
            try:
                check_gain(dr.detach(self.gain))
            except LumitreeError:
                mi.set_property(self.gain, self._accepted)
                raise
            self._accept_gain()

        def _accept_gain(self):
            # Opaque: another gain does not compile new kernels.
            dr.make_opaque(self.gain)
            self._accepted = mi.Color3f(self.gain)

        def eval(self, si, active=True):
            line, entering = self.placed.entering_line(si, active)
            radiance = self.factor * self.sampler.look(*line, entering)[0]
            return self.light_colour(radiance, si.wavelengths) & entering

        def sample_target(self, it, sample, own, active):
            return self.light().sample_target(it, sample, own, active)

        def eval_target(self, it, sampled, bsdf_pdf, emitter_pmf, active):
            return self.light().eval_target(it, sampled, bsdf_pdf, emitter_pmf, active)

        def eval_entered(
            self, ray, distance, it, specular_chain, bsdf_pdf, emitter_pmf, end, active
        ):
            return self.light().eval_entered(
                ray, distance, it, specular_chain, bsdf_pdf, emitter_pmf, end, active
            )

        def transmittance(self, ray, distance, active):
            return self.light().transmittance(ray, distance, active)

        def sample_direction(self, it, sample, active=True):
            placed = self.placed
            x = placed.receiver(placed.local_point(it.p))
            direction, target = self.sampler.sample(x, sample, active)
            ds, active = self.light().towards(it, x, direction, active)
            ds.emitter = mi.EmitterPtr(self)
            # As a ray that is given by the scene has it, for `pdf_direction` to agree.
            direction, near = placed.local_direction(ds.d), ds.dist / placed.scale
            entry = x + near * direction
            # `eval` does not know whether it is for an image, so both are what an image shows.
            radiance, _, ds.pdf = self.sampler.eval(
                x, entry, direction, near, active, target, specular_chain=True
            )
            radiance = self.light_colour(self.factor * radiance, it.wavelengths)
            return ds, dr.select(ds.pdf > 0, radiance / ds.pdf, 0)

        def pdf_direction(self, it, ds, active=True):
            entry, direction = self.placed.local_line(ds.p, ds.d)
            distance = dr.norm(ds.p - it.p) / self.placed.scale
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            x = self.placed.local_point(it.p)
            return self.sampler.pdf(x, entry, direction, distance, facing)

        def eval_direction(self, it, ds, active=True):
            line = self.placed.local_line(it.p, ds.d)
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            radiance, _ = self.sampler.look(*line, facing)
            return self.light_colour(self.factor * radiance, it.wavelengths) & facing

        def sample_wavelengths(self, si, sample, active=True):
            return mi.Color0f(), self.eval(si, active)

        def sample_ray(self, time, sample1, sample2, sample3, active=True):
            if mi.is_spectral:
                raise LumitreeError(
                    "integrators that trace from the light need an RGB variant for the 'lumitree' "
                    "emitter"
                )
            placed = self.placed
            p, direction, flux = self.sampler.sample_ray(sample1, sample2, sample3, active)
            # Where the line leaves the proxy is where its reverse enters.
            distance, n, _ = placed.proxy.enter(p, -direction)
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.p = placed.scene_point(p - distance * direction)
            si.n = placed.scene_direction(n)
            si.time = time
            ray = si.spawn_ray(placed.scene_direction(direction))
            return ray, self.factor * flux * dr.square(placed.scale) & active

        def sample_position(self, time, sample, active=True):
            raise LumitreeError(
                "the 'lumitree' emitter cannot be connected to a camera; set hide_emitters of the "
                "integrator that traces from the light"
            )

        def to_string(self) -> str:
            return f"LumitreeEmitter[luminaire={self.placed.field.asset.luminaire}]"

    return LumitreeEmitter
