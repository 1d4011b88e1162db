"""Results of following transmissions alone: straight-through opacity, emitters seen."""

from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.trace import medium_paths
from lumitree.trace.spawning import scene_extent, spawn

# Light that leaves within this angle of the direction it came in counts as having passed.
COSINE_OF_CONE = 0.9659258262890683  # cos 15°


def is_smooth(sampled_type: Any) -> Any:
    """Whether an interaction of this mi.BSDFFlags type lets light pass without spreading it."""
    return mi.has_flag(sampled_type, mi.BSDFFlags.DeltaTransmission) | mi.has_flag(
        sampled_type, mi.BSDFFlags.Null
    )


def is_transmitted(sampled_type: Any) -> Any:
    """Whether an interaction of this mi.BSDFFlags type lets light pass."""
    return mi.has_flag(sampled_type, mi.BSDFFlags.Transmission) | mi.has_flag(
        sampled_type, mi.BSDFFlags.Null
    )


@dr.syntax
def straight_through(scene: Any, sampler: Any, ray: Any, path_depth: int) -> tuple[Any, Any]:
    """Follow `ray` along a chain of transmissions: what passes, and which emitters it sees.

    Null, specular and rough transmission continue the chain, interior media attenuate it, a
    reflection or absorption ends it. Both are estimates of one sample, and exact where no
    transmission is rough.

    Args:
        scene: mi.Scene of the luminaire.
        sampler: mi.Sampler, seeded for as many rays.
        ray: mi.Ray3f that starts outside.
        path_depth: longest chain.

    Returns:
        mi.Float, throughput averaged over R, G and B, 0 where the ray is stopped or bent; and
        mi.Color3f, radiance of the emitters met before the first rough transmission.
    """
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.Transmission | mi.BSDFFlags.Null
    extent = scene_extent(scene)
    direction = mi.Vector3f(ray.d)
    ray = mi.Ray3f(ray)
    throughput, emitted = mi.Color3f(1), mi.Color3f(0)
    smooth = mi.Bool(True)
    medium = dr.zeros(mi.MediumPtr)
    crossings = mi.UInt32(0)
    active = mi.Bool(True)
    passed = mi.Bool(False)

    while active:
        si = scene.ray_intersect(ray, active)
        throughput *= medium_paths.transmittance(medium, si.t, active & si.is_valid())

        passed |= active & ~si.is_valid()
        active &= si.is_valid()
        light = si.emitter(scene, active).eval(si, active)
        emitted = dr.select(active & smooth, emitted + throughput * light, emitted)
        sample, weight = si.bsdf(ray).sample(
            context, si, sampler.next_1d(active), sampler.next_2d(active), active
        )
        active &= is_transmitted(sample.sampled_type)
        throughput[active] = throughput * weight
        smooth &= is_smooth(sample.sampled_type)
        ray = dr.select(active, spawn(si, si.to_world(sample.wo), extent), ray)
        medium = medium_paths.medium_after(si, ray.d, medium, active)
        crossings += 1
        active &= (crossings < path_depth) & (dr.max(throughput) > 0)

    straight = passed & (dr.dot(ray.d, direction) >= COSINE_OF_CONE)
    return dr.select(straight, dr.mean(throughput), 0), emitted
