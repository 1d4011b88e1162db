"""The vertices of the paths of `lumitree_path`: what scatters there, and in which direction."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from lumitree.rendering.plugins.geometry_plugins import CROSSED_STRAIGHT
from lumitree.rendering.plugins.path_scene import PathScene
from lumitree.rendering.plugins.path_state import (
    FreeFlight,
    Hit,
    PathState,
    Scattering,
    Vertex,
)
from lumitree.rendering.plugins.proxies import MAX_CROSSINGS, NONE
from lumitree.trace import medium_paths
from lumitree.trace.spawning import is_opaque, on_opposite_sides, spawn


def find_vertex(
    scene: PathScene,
    path: PathState,
    hit: Hit,
    free_flight: FreeFlight,
    max_depth: mi.UInt32,
) -> Vertex:
    """The vertex where a ray has ended."""
    si, bsdf = hit.si, hit.bsdf
    active = path.active & (si.is_valid() | hit.hit_medium)
    # Null interactions do not count, so light may come through them.
    last = path.depth - path.depth_freed + 1 >= max_depth
    if scene.has_null_surfaces:
        passes = hit.hit_surface & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
        active &= ~last | passes
    else:
        active &= ~last
    if scene.has_scattering:
        si[hit.hit_medium] = medium_paths.scattering_point(path.ray, free_flight.distance)
    active_surface, active_medium = active & ~hit.hit_medium, active & hit.hit_medium

    straight, behind = mi.Bool(False), mi.Bool(False)
    if scene.shows_geometry:
        # Glass that light crosses straight is seen from outside on both sides.
        straight = active_surface & ~path.specular_chain & ((bsdf.flags() & CROSSED_STRAIGHT) != 0)
        behind = straight & (si.wi.z < 0)
        si.wi.z = dr.select(behind, -si.wi.z, si.wi.z)
    opaque = active_surface & is_opaque(bsdf)
    return Vertex(
        si,
        bsdf,
        hit.owner,
        hit.shown,
        active_surface,
        active_medium,
        last,
        opaque,
        straight,
        behind,
    )


def sample_scattering(
    scene: PathScene, path: PathState, vertex: Vertex, d_em: mi.Vector3f, sampler: mi.Sampler
) -> Scattering:
    """Evaluate the BSDF or phase function for the emitter's direction, and sample another one."""
    si, active_medium = vertex.si, vertex.active_medium
    wo = si.to_local(d_em)
    value, pdf, bs, weight = vertex.bsdf.eval_pdf_sample(
        scene.bsdf_ctx, si, wo, sampler.next_1d(), sampler.next_2d(), vertex.active_surface
    )
    phase_wo = mi.Vector3f(0)
    if scene.has_scattering:
        phase = medium_paths.eval_phase(path.medium, path.ray, d_em, active_medium)
        value[active_medium], pdf[active_medium] = phase
        phase_wo, *phase = medium_paths.sample_phase(path.medium, path.ray, sampler, active_medium)
        weight[active_medium], bs.pdf[active_medium] = phase
    return Scattering(value, pdf, bs, weight, phase_wo)


def scatter(scene: PathScene, path: PathState, vertex: Vertex, scattering: Scattering) -> mi.Bool:
    """Update paths for the sampled direction.

    Returns:
        Whether the vertex counts as a bounce: whether it is not a null interaction.
    """
    si, bs, owners = vertex.si, scattering.bs, scene.divided.owners
    active = vertex.active_surface | vertex.active_medium
    null = vertex.active_surface & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
    if scene.shows_geometry:
        crossed = vertex.straight & mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaTransmission)
        null |= crossed
        # Radiance is not compressed, as it would be in a denser medium.
        path.β[crossed] *= dr.square(bs.eta)
        bs.wo.z = dr.select(vertex.behind, -bs.wo.z, bs.wo.z)
        path.bent_by[crossed] |= owners.bit(vertex.owner, active)
    bounces = active & ~null
    path.β[active] *= scattering.weight
    path.η[bounces & vertex.active_surface] *= bs.eta

    # Information about the current vertex needed by the next iteration
    path.si_prev[bounces] = mi.Interaction3f(si)
    path.bsdf_pdf_prev[bounces] = bs.pdf
    delta = vertex.active_surface & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
    path.bsdf_delta_prev[bounces] = delta
    path.specular_chain &= ~bounces | path.bsdf_delta_prev
    # A ray that goes on behind a surface of a lamp has the lamp's light already.
    path.skipped[bounces] = 0
    if scene.shows_geometry:
        path.self_emission[bounces] = dr.select(vertex.shown, vertex.owner, NONE)
        path.on_lamp[bounces] = vertex.owner
        path.bent_by[bounces] = 0
        path.skipped[bounces | null] |= owners.bit(vertex.owner, active)
    path.depth[bounces] += 1
    path.crossings[null] += 1
    if owners.scatter:
        # Light that scatters in a lamp is shown whatever the largest depth: as the light that the
        # lamp sends elsewhere.
        freed = bounces & vertex.shown & owners.scatters(vertex.owner, bounces)
        path.depth_freed[freed & (path.depth_freed < MAX_CROSSINGS)] += 1
    path.valid_ray |= bounces
    path.active = _next_ray(scene, path, vertex, scattering, null) & ~(bounces & vertex.last)
    return bounces


def _next_ray(
    scene: PathScene, path: PathState, vertex: Vertex, scattering: Scattering, null: mi.Bool
) -> mi.Bool:
    """Set the ray that leaves a vertex, and its medium; returns whether there is one."""
    si, arriving = vertex.si, path.ray.d
    # A null ray keeps its direction to the last bit.
    direction = dr.select(null, arriving, si.to_world(scattering.bs.wo))
    if scene.has_scattering:
        direction[vertex.active_medium] = scattering.phase_wo
    leaks = vertex.opaque & ~null & on_opposite_sides(si, arriving, direction)
    path.ray = spawn(si, direction, scene.extent)
    if scene.has_media:
        path.medium = medium_paths.medium_after(si, path.ray.d, path.medium, vertex.active_surface)
    return (vertex.active_surface | vertex.active_medium) & ~leaks


def roulette(path: PathState, bounces: mi.Bool, rr_depth: int, sampler: mi.Sampler) -> None:
    """End paths with a probability that depends on their throughput, as `path` does."""
    β_max = dr.max(path.β)
    rr_prob = dr.minimum(β_max * dr.square(path.η), 0.95)
    rr_active = bounces & (path.depth >= rr_depth)
    path.active &= ~rr_active | (sampler.next_1d() < rr_prob)
    path.β[rr_active] *= dr.rcp(rr_prob)
    path.active &= (β_max != 0) & (path.crossings < MAX_CROSSINGS)
