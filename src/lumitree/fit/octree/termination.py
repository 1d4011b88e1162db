"""Where the straight-through part of a ray ends.

The termination point of a ray is where its light is reflected, scattered or absorbed: at a surface
or in a medium, or the orthogonal projection of that place onto the ray. Behind thick glass, which
deflects paths, it is at the first surface with probability ½.
"""

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.trace import medium_paths
from lumitree.trace.light_paths import termination_point
from lumitree.trace.spawning import scene_box, scene_extent, spawn
from lumitree.trace.straight_through import (
    COSINE_OF_CONE,
    is_smooth,
    is_transmitted,
)
from lumitree.trace.tracing import PATH_DEPTH


@dataclasses.dataclass
class TerminatedRays:
    """Rays with their termination points.

    Attributes:
        origin, direction: the ray, local frame.
        point: mi.Point3f, local frame; without meaning where `terminated` (mi.Bool) is false.
        radiance: mi.Color3f, of the emitters seen through smooth transmission.
    """

    origin: Any
    direction: Any
    point: Any
    terminated: Any
    radiance: Any


@dr.syntax
def trace_to_termination(scene, sampler, ray):
    """Follow rays by transmissions alone, each chosen at random, until they terminate or leave.

    Returns:
        Termination point (mi.Point3f, frame of the scene), whether there is one (mi.Bool), and
        radiance of the emitters seen through smooth transmission (mi.Color3f).
    """
    context = mi.BSDFContext()
    straight = mi.Vector3f(ray.d)
    ray = mi.Ray3f(ray)
    throughput = mi.Color3f(1)
    radiance = mi.Color3f(0)
    first = dr.zeros(mi.Point3f)
    point = dr.zeros(mi.Point3f)
    terminated = mi.Bool(False)
    smooth = mi.Bool(True)
    medium = dr.zeros(mi.MediumPtr)
    extent, box = scene_extent(scene), scene_box(scene)
    crossings = mi.UInt32(0)
    at_first = sampler.next_1d() < 0.5
    active = mi.Bool(True)
    while active:
        si = scene.ray_intersect(ray, active)
        inside = active & (medium != None)  # noqa: E711 (a vector comparison)
        _, extinction = medium_paths.coefficients(medium, active)
        mean = dr.mean(extinction)
        flight = dr.select(inside & (mean > 0), -dr.log(1 - sampler.next_1d(active)) / mean, dr.inf)
        collides = inside & (flight < dr.select(si.is_valid(), si.t, dr.inf))
        travelled = dr.select(collides, flight, dr.select(si.is_valid(), si.t, 0))
        tilt = dr.select(inside, dr.exp(-(extinction - mean) * travelled), 1)
        throughput[active] = throughput * tilt

        hits = active & ~collides & si.is_valid()
        first = dr.select(hits & (crossings == 0), si.p, first)
        light = si.emitter(scene, hits).eval(si, hits)
        radiance[hits & smooth] = radiance + throughput * light
        sample, weight = si.bsdf(ray).sample(
            context, si, sampler.next_1d(hits), sampler.next_2d(hits), hits
        )
        transmits = hits & is_transmitted(sample.sampled_type)
        throughput[hits] = throughput * weight
        smooth &= is_smooth(sample.sampled_type)
        onwards = spawn(si, si.to_world(sample.wo), extent)

        bent = dr.dot(ray.d, straight) < COSINE_OF_CONE
        # Light leaving in another direction is not behind the luminaire: it was deflected inside.
        deflected = active & ~collides & ~si.is_valid() & bent & (crossings > 0)
        ends = deflected | collides | (hits & (~transmits | (dr.max(throughput) <= 0)))
        last = dr.select(collides, ray(flight), dr.select(deflected, ray.o, si.p))
        end = termination_point(box, straight, first, last, bent & at_first)
        point = dr.select(ends, end, point)
        terminated |= ends

        medium = medium_paths.medium_after(si, onwards.d, medium, transmits)
        ray = dr.select(transmits, onwards, ray)
        crossings += 1
        active = transmits & (crossings < PATH_DEPTH) & (dr.max(throughput) > 0)

    return point, terminated, radiance
