"""Emission of a baked luminaire, where it stands: the calls of `DeferredEmitter` that cost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.rendering.plugins.deferred_emitter import EmitterSample
from lumitree.rendering.plugins.placed import Placed
from lumitree.rendering.sampling.emitter_sampling import STRAIGHT, DirectionSampler
from lumitree.rendering.sampling.samples import mis_weight
from lumitree.rendering.sampling.straight_light import StraightLight


class LampLight:
    """Light of a baked luminaire, or of many that differ only by where they stand and by `gain`.

    Its methods are the methods of `DeferredEmitter`.
    """

    def __init__(
        self,
        placed: Placed,
        sampler: DirectionSampler,
        straight: StraightLight | None,
        light_colour: Callable[..., Any],
        gain: mi.Color3f,
    ) -> None:
        self.placed, self.sampler, self.straight = placed, sampler, straight
        self.light_colour, self.gain = light_colour, gain

    def moved(
        self, scale: mi.Float, centre: mi.Point3f, rotation: mi.Matrix3f, gain: mi.Color3f
    ) -> LampLight:
        """The same light elsewhere; arguments as of `Placed`, one for each ray."""
        placed = self.placed.moved(scale, centre, rotation)
        return LampLight(placed, self.sampler, self.straight, self.light_colour, gain)

    def sample_target(self, it, sample, own, active):
        placed = self.placed
        at = placed.local_point(it.p)
        x = placed.receiver(at)
        inside = placed.in_box(x) if placed.holds else mi.Bool(False)
        direction, target = self.sampler.sample_target(x, sample, active & ~own, inside)
        straight = mi.Bool(False)
        if self.straight is not None:
            traced = active & (own | self.placed.traces_straight_light)
            target.total = dr.select(own, 0, target.total)
            self.straight.choose(at, sample, target, traced, inside | own)
            straight = traced & (target.place == STRAIGHT)
            found = self.straight.sample(at, target, sample, straight)
            direction = dr.select(straight, found, direction)
        ds, valid = self.towards(it, x, direction, active & ~own)
        # From where the light leaves the box it is there already.
        moved = mi.Bool(False) if placed.holds else placed.in_box(at)
        end, beyond = dr.select(moved, 0, ds.dist), mi.Float(0)
        point = target.distance * placed.scale
        if placed.holds:
            valid |= active & inside & ~own
            if placed.shows_geometry:
                # The lamp's own surfaces do not block what is stored.
                end = dr.select(inside, 0, end)
                beyond = dr.maximum(point - end, 0)
            else:
                end = point
        end, beyond = dr.select(straight, point, end), dr.select(straight, 0, beyond)
        ds.p = dr.select(ds.dist == end, ds.p, dr.fma(end, ds.d, it.p))
        ds.dist = end
        valid = dr.select(straight, dr.max(target.light) > 0, valid)
        includes_mis = mi.Bool(self.sampler.includes_mis) | straight
        return EmitterSample(ds, mi.Spectrum(1), valid, includes_mis, target, beyond)

    def eval_target(self, it, sampled, bsdf_pdf, emitter_pmf, active):
        x, direction = self.placed.local_line(it.p, sampled.ds.d)
        target = sampled.target
        share = mis_weight(target.density * emitter_pmf, bsdf_pdf)
        near = sampled.ds.dist / self.placed.scale
        if not self.placed.holds:
            # Rays of the BSDF of a receiver that touches the box may not enter it.
            bsdf_pdf = dr.select(self.placed.touches(x), 0, bsdf_pdf)
            x = self.placed.receiver(x)
        straight = active & (target.place == STRAIGHT)
        weight, density = self.sampler.eval_target(
            x, direction, near, target, bsdf_pdf, emitter_pmf, active & ~straight
        )
        weight = dr.select(straight, target.light * share, weight)
        density = dr.select(straight, 1, density)
        return self.light_colour(self.gain * weight, it.wavelengths), density

    def eval_entered(self, ray, distance, it, specular_chain, bsdf_pdf, emitter_pmf, end, active):
        placed = self.placed
        x, (entry, direction) = placed.local_point(it.p), placed.entry(ray, distance)
        if placed.shows_geometry:
            # Images show the geometry's own shapes, which also hide what is behind them.
            active &= ~specular_chain
        inside = mi.Bool(False)
        if placed.holds:
            inside = placed.in_box(x)
        else:
            # Next-event estimation alone finds the light for receivers that touch the box.
            active &= (emitter_pmf <= 0) | ~placed.touches(x)
        radiance, through, density = self.sampler.eval_hit(
            x,
            entry,
            direction,
            dr.norm(entry - x),
            specular_chain,
            bsdf_pdf,
            emitter_pmf,
            active,
            inside,
            (end - distance) / placed.scale,
        )
        if not placed.dims:
            through = mi.Float(1)
        radiance = self.light_colour(self.gain * radiance, ray.wavelengths)
        return radiance & active, dr.select(active, through, 1), density

    def transmittance(self, ray, distance, active):
        if not self.placed.dims:
            return mi.Float(1)
        placed = self.placed
        line = placed.entry(ray, distance)
        # Not of what is behind a receiver, or behind a light, in the box.
        span = mi.Float(0), (ray.maxt - distance) / placed.scale
        return dr.select(active, placed.shadow_field.transmittance(*line, active, span), 1)

    def towards(self, it, origin, direction, active):
        """Sample of a direction (local frame), without its density, and whether it is valid."""
        placed = self.placed
        distance, n, enters = placed.proxy.enter(origin, direction)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p = placed.scene_point(origin + distance * direction)
        ds.n = placed.scene_direction(n)
        # Not from the difference of both points: far from the origin they are rounded.
        ds.d = placed.scene_direction(direction)
        ds.dist = distance * placed.scale
        ds.time = it.time
        # Rays that start within a proxy do not meet it, so that next-event estimation alone finds
        # the lamp.
        ds.delta = placed.touches(placed.local_point(it.p))
        return ds, active & enters
