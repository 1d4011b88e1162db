"""Straight-through opacity: what a luminaire hides of the light behind it (decision D7)."""

from typing import Any

import drjit as dr
import mitsuba as mi

# Light that leaves within this angle of the direction it came in counts as having passed.
COSINE_OF_CONE = 0.9659258262890683  # cos 15°


@dr.syntax
def straight_through(scene: Any, sampler: Any, ray: Any, path_depth: int) -> Any:
    """One-sample estimate of the throughput of `ray` by a chain of transmissions alone.

    Null, specular and rough transmission continue the chain, interior media attenuate it, a
    reflection or absorption ends it.

    Args:
        scene: mi.Scene of the luminaire.
        sampler: mi.Sampler, seeded for as many rays.
        ray: mi.Ray3f that starts outside.
        path_depth: longest chain.

    Returns:
        mi.Float, throughput averaged over R, G and B; 0 where the ray is stopped or bent.
    """
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.Transmission | mi.BSDFFlags.Null
    direction = mi.Vector3f(ray.d)
    ray = mi.Ray3f(ray)
    throughput = mi.Color3f(1)
    medium = dr.zeros(mi.MediumPtr)
    crossings = mi.UInt32(0)
    active = mi.Bool(True)
    passed = mi.Bool(False)

    while active:
        si = scene.ray_intersect(ray, active)
        inside = active & (medium != None)  # noqa: E711 (a vector comparison)
        here = dr.zeros(mi.MediumInteraction3f)
        here.p = ray.o
        _, _, extinction = medium.get_scattering_coefficients(here, inside)
        depth = dr.select(inside & si.is_valid(), extinction * si.t, 0)
        throughput *= dr.exp(-depth)

        passed |= active & ~si.is_valid()
        active &= si.is_valid()
        sample, weight = si.bsdf(ray).sample(
            context, si, sampler.next_1d(active), sampler.next_2d(active), active
        )
        active &= mi.has_flag(sample.sampled_type, mi.BSDFFlags.Transmission) | mi.has_flag(
            sample.sampled_type, mi.BSDFFlags.Null
        )
        throughput[active] = throughput * weight
        ray = dr.select(active, si.spawn_ray(si.to_world(sample.wo)), ray)
        changes = active & si.is_medium_transition()
        medium = dr.select(changes, si.target_medium(ray.d), medium)
        crossings += 1
        active &= (crossings < path_depth) & (dr.max(throughput) > 0)

    straight = passed & (dr.dot(ray.d, direction) >= COSINE_OF_CONE)
    return dr.select(straight, dr.mean(throughput), 0)
