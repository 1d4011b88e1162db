"""The emitter `lumitree`: what a baked luminaire sends out."""

from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.errors import LumitreeError
from lumitree.rendering.emitter_sampling import EmitterSampler
from lumitree.rendering.light_leaves import light_leaves
from lumitree.rendering.placed import Placed


def emitter_class() -> type:
    """Class of the emitter for the variant of Mitsuba that is set, whose base class it extends.

    It is a `DeferredEmitter`. Radiance is that of the whole line through the proxy, on the face
    where the line enters; on the face where it leaves it is 0.
    """

    class LumitreeEmitter(mi.Emitter):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.placed = placed = Placed(props)
            leaves = light_leaves(placed.field) if placed.sampling == "emission" else None
            self.sampler = EmitterSampler(placed.proxy, placed.field, leaves)
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def eval(self, si, active=True):
            line, entering = self.placed.entering_line(si, active)
            return self.placed.field.emission(*line, entering)[0] & entering

        def eval_with_transmittance(self, si, it, active):
            line, entering = self.placed.entering_line(si, active)
            distance = dr.norm(si.p - it.p) / self.placed.scale
            radiance, through, pdf = self.sampler.eval(*line, distance, entering)
            return radiance & entering, dr.select(entering, through, 1), pdf

        def sample_direction(self, it, sample, active=True):
            ds, distance = self.sample_target(it, sample, active)
            weight, ds.pdf = self.eval_target(it, ds, distance, active & (ds.pdf > 0))
            return ds, weight

        def sample_target(self, it, sample, active):
            placed = self.placed
            origin = placed.local_point(it.p)
            direction, target = self.sampler.sample(origin, sample, active)
            distance, n, enters = placed.proxy.enter(origin, direction)
            ds = dr.zeros(mi.DirectionSample3f)
            ds.p = placed.scene_point(origin + distance * direction)
            ds.n = placed.scene_direction(n)
            # Not from the difference of both points: far from the origin they are rounded.
            ds.d = placed.scene_direction(direction)
            ds.dist = distance * placed.scale
            ds.time = it.time
            ds.pdf = dr.select(active & enters, 1, 0)
            ds.delta = False
            ds.emitter = mi.EmitterPtr(self)
            return ds, target

        def eval_target(self, it, ds, distance, active):
            x, direction = self.placed.local_line(it.p, ds.d)
            near = ds.dist / self.placed.scale
            entry = x + near * direction
            radiance, _, pdf = self.sampler.eval(entry, direction, near, active, distance)
            return dr.select(pdf > 0, radiance / pdf, 0), pdf

        def pdf_direction(self, it, ds, active=True):
            entry, direction = self.placed.local_line(ds.p, ds.d)
            distance = dr.norm(ds.p - it.p) / self.placed.scale
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            return self.sampler.pdf(entry, direction, distance, facing)

        def eval_direction(self, it, ds, active=True):
            line = self.placed.local_line(it.p, ds.d)
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            radiance, _ = self.placed.field.emission(*line, facing)
            return radiance & facing

        def sample_wavelengths(self, si, sample, active=True):
            return mi.Color0f(), self.eval(si, active)

        def sample_ray(self, time, sample1, sample2, sample3, active=True):
            placed = self.placed
            p, direction, radiance, pdf = self.sampler.sample_line(
                sample1, sample2, sample3, active
            )
            # Where the line leaves the proxy is where its reverse enters.
            distance, n, _ = placed.proxy.enter(p, -direction)
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.p = placed.scene_point(p - distance * direction)
            si.n = placed.scene_direction(n)
            si.time = time
            ray = si.spawn_ray(placed.scene_direction(direction))
            weight = radiance * dr.square(placed.scale) / pdf
            return ray, weight & (active & (pdf > 0))

        def sample_position(self, time, sample, active=True):
            raise LumitreeError(
                "the 'lumitree' emitter cannot be connected to a camera; set hide_emitters of the "
                "integrator that traces from the light"
            )

        def to_string(self) -> str:
            return f"LumitreeEmitter[luminaire={self.placed.field.asset.luminaire}]"

    return LumitreeEmitter
