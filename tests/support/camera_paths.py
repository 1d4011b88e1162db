"""Reference: camera paths that only sample BSDFs, without media; import after `load_mitsuba`."""

import drjit as dr
import mitsuba as mi
import numpy as np

from support.traced_lamps import stream


def frame(luminaire):
    """Scale and centre of a luminaire's local frame."""
    matrix = luminaire.frame.world_from_local
    return float(matrix[0, 0]), matrix[:3, 3].tolist()


def trace_to_termination(rays, count, step):
    """Radiance and termination points of camera paths along `count` random rays.

    Returns:
        Radiance [N, 3], termination points [N, 3] in the local frame, whether there is one [N],
        and directions [N, 3]. A termination point is the orthogonal projection onto the ray of the
        first event that does not transmit, or of the last surface, if that is further along and
        within the box. Otherwise, and with probability ½ where the path has been deflected by more
        than 15° until there, it is at the first surface.
    """
    origin, direction = rays.random_rays(count, stream(step))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1000 + step, count)
    scale, centre = frame(rays.luminaire)
    outside = mi.Point3f(origin - 5 * direction)
    ray = mi.Ray3f(outside * scale + mi.Vector3f(centre), direction)
    radiance, point, terminated = follow(rays.luminaire.scene, sampler, ray)
    points = (np.array(point).T - centre) / scale
    return np.array(radiance, np.float64).T, points, np.array(terminated), np.array(direction).T


@dr.syntax
def follow(scene, sampler, ray):
    ray = mi.Ray3f(ray)
    straight = mi.Vector3f(ray.d)
    throughput, radiance = mi.Color3f(1), mi.Color3f(0)
    point, first = dr.zeros(mi.Point3f), dr.zeros(mi.Point3f)
    at_first, box = sampler.next_1d() < 0.5, scene.bbox()
    terminated, active = mi.Bool(False), mi.Bool(True)
    events = mi.UInt32(0)
    while active:
        si = scene.ray_intersect(ray, active)
        hits = active & si.is_valid()
        first = dr.select(hits & (events == 0), si.p, first)
        bent = dr.dot(ray.d, straight) < np.cos(np.deg2rad(15))
        leaves = active & ~hits & ~terminated & bent
        radiance[hits] = radiance + throughput * si.emitter(scene, hits).eval(si, hits)
        sample, weight = si.bsdf().sample(
            mi.BSDFContext(), si, sampler.next_1d(hits), sampler.next_2d(hits), hits
        )
        throughput[hits] = throughput * weight
        transmits = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Transmission)
        ends = hits & ~terminated & ~(transmits & (dr.max(throughput) > 0))
        last = dr.select(ends, si.p, ray.o)
        moved = first + straight * dr.dot(last - first, straight)
        further = dr.dot(last - first, straight) > 0
        fits = (at_first | ~bent) & further & dr.all((moved >= box.min) & (moved <= box.max))
        moved = dr.select(fits, moved, first)
        point = dr.select(ends | leaves, moved, point)
        terminated |= ends | leaves
        ray = dr.select(hits, si.spawn_ray(si.to_world(sample.wo)), ray)
        events += 1
        active = hits & (dr.max(throughput) > 0) & (events < 128)
    return radiance, point, terminated
