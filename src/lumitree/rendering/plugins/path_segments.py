"""The segments of a path of `lumitree_path`: media along a ray, and proxies that it enters."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from lumitree.rendering.plugins.emitter_calls import entered_light
from lumitree.rendering.plugins.path_scene import PathScene
from lumitree.rendering.plugins.path_state import FreeFlight, Hit, PathState
from lumitree.rendering.plugins.proxies import MAX_CROSSINGS, NONE
from lumitree.rendering.sampling.samples import mis_weight
from lumitree.trace import medium_paths
from lumitree.trace.spawning import spawn


def sample_free_flight(scene: PathScene, path: PathState, sampler: mi.Sampler) -> FreeFlight:
    """Where the medium scatters, if it does before the ray meets anything."""
    if not scene.has_scattering:
        return FreeFlight(mi.Float(dr.inf), mi.Bool(False))
    distance = medium_paths.free_flight(
        path.medium, path.channel, sampler, path.active, path.ray.wavelengths
    )
    return FreeFlight(distance, path.active & (distance < path.pi.t))


@dr.syntax
def skip_emitters(
    scene: PathScene, path: PathState, free_flight: FreeFlight, sampler: mi.Sampler
) -> None:
    """Let camera rays go on behind emitters, which the camera does not see."""
    # Not Mitsuba's `skip_area_emitters`, whose distance belongs to another ray.
    surfaces = scene.divided.surfaces
    skip = path.active & ~free_flight.collides & (path.depth == 0) & _emits(path.pi)
    while skip:
        if dr.hint(scene.has_media, mode="scalar"):
            _attenuate(path, path.pi.t, skip)
        si = path.pi.compute_surface_interaction(path.ray, mi.RayFlags.Minimal, skip)
        path.ray[skip] = spawn(si, path.ray.d, scene.extent)
        path.pi[skip] = surfaces.ray_intersect_preliminary(path.ray, coherent=True, active=skip)
        path.crossings[skip] += 1
        path.active &= path.crossings < MAX_CROSSINGS
        if dr.hint(scene.has_scattering, mode="scalar"):
            free_flight.distance[skip] = medium_paths.free_flight(
                path.medium, path.channel, sampler, skip, path.ray.wavelengths
            )
            free_flight.collides |= skip & (free_flight.distance < path.pi.t)
        skip &= path.active & ~free_flight.collides & _emits(path.pi)


def _emits(pi: mi.PreliminaryIntersection3f) -> mi.Bool:
    """Whether a preliminary intersection is with an emitter."""
    return pi.is_valid() & (pi.shape.emitter() != None)  # noqa: E711 (a vector comparison)


@dr.syntax
def add_entered_light(scene: PathScene, path: PathState, free_flight: FreeFlight) -> None:
    """Add light of the lamps whose proxies a ray enters before it ends, and attenuate it there."""
    divided, proxies = scene.divided, scene.divided.proxies
    active = mi.Bool(path.active)
    if dr.hint(scene.hide_emitters, mode="scalar"):
        active &= path.depth > 0
    end = dr.minimum(path.pi.t, free_flight.distance)
    # Emitter sampling finds no light of rays without a density, and none for images.
    alone = path.bsdf_delta_prev | path.specular_chain
    sampled = path.si_prev.p, dr.select(alone, dr.inf, path.bsdf_pdf_prev)
    distance, lamp = proxies.first(
        path.ray, end, active, path.specular_chain, path.skipped, sampled
    )
    active &= lamp != NONE
    # A lamp's light comes whole, whether or not the medium scatters the ray in its box.
    ahead = divided.owners.of(path.pi.shape, active & path.pi.is_valid())
    while active:
        far = divided.end(path.ray, path.pi.t, lamp, ahead, active)
        emitter = scene.emitter(lamp, active)
        emitter_pmf = scene.selection.pmf(emitter, path.si_prev, active)
        emitter_pmf = dr.select(path.bsdf_delta_prev, 0, emitter_pmf)
        light, through, emitter_pdf = scene.lamps.call(
            entered_light,
            emitter,
            path.ray,
            distance,
            path.si_prev,
            path.specular_chain,
            path.bsdf_pdf_prev,
            emitter_pmf,
            far,
            active,
        )
        light *= path.β * mis_weight(path.bsdf_pdf_prev, emitter_pdf * emitter_pmf)
        if dr.hint(scene.has_media, mode="scalar"):
            light *= medium_paths.segment_weight(
                path.medium, distance, path.ρ, active, path.ray.wavelengths
            )[0]
        path.add_light(scene, emitter, light, path.specular_chain, active)
        path.β[active] *= through
        path.valid_ray |= active & (dr.max(light) > 0)
        distance, lamp = proxies.next(
            path.ray, distance, lamp, end, active, path.specular_chain, path.skipped, sampled
        )
        active &= lamp != NONE


def end_segment(scene: PathScene, path: PathState, free_flight: FreeFlight) -> Hit:
    """The end of the ray; the medium before it attenuates the path."""
    si = path.pi.compute_surface_interaction(path.ray, mi.RayFlags.All, path.active)
    hit_surface, hit_medium = path.active & ~free_flight.collides, free_flight.collides
    if scene.has_media:
        _attenuate(path, si.t, hit_surface)
    if scene.has_scattering:
        weight, densities = medium_paths.scattering_weight(
            path.medium, free_flight.distance, path.ρ, hit_medium, path.ray.wavelengths
        )
        path.β[hit_medium] *= weight
        path.ρ[hit_medium] = densities
    # The lamp that the surface belongs to, and whether the path gets what its shapes emit.
    owner, shown, straight = mi.UInt32(NONE), mi.Bool(path.specular_chain), mi.Bool(False)
    if scene.shows_geometry:
        owners = scene.divided.owners
        owner = owners.of(si.shape, hit_surface & si.is_valid())
        if owners.scatter:
            owner = dr.select(hit_medium, owners.of_medium(path.medium, hit_medium), owner)
        shown |= (owner == path.self_emission) & (owner != NONE)
        straight = (owner != path.on_lamp) & ((path.bent_by & owners.bit(owner, hit_surface)) == 0)
    return Hit(si, si.bsdf(path.ray), hit_surface, hit_medium, owner, shown, straight)


def _attenuate(path: PathState, distance: mi.Float, active: mi.Bool) -> None:
    """Multiply a path by the weight of a segment of its medium."""
    weight, densities = medium_paths.segment_weight(
        path.medium, distance, path.ρ, active, path.ray.wavelengths
    )
    path.β[active] *= weight
    path.ρ[active] = densities
