"""Light that paths of `lumitree_path` get: of emitters that are hit, and by emitter sampling."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from lumitree.rendering.plugins.emitter_calls import (
    eval_target,
    hit_light,
    sample_self_direction,
    sample_self_emission,
    sample_target,
)
from lumitree.rendering.plugins.path_scene import PathScene
from lumitree.rendering.plugins.path_segments import mis_weight
from lumitree.rendering.plugins.path_state import EmitterChoice, Hit, PathState, Scattering, Vertex
from lumitree.rendering.plugins.proxies import NONE
from lumitree.rendering.plugins.shadow_rays import visible
from lumitree.trace import medium_paths
from lumitree.trace.geometric_normals import on_opposite_sides


def add_emission(scene: PathScene, path: PathState, hit: Hit) -> mi.Bool:
    """Add light of the emitter that the ray has hit.

    Returns:
        Whether that is a proxy, which has then attenuated the path.
    """
    seen = mi.Bool(hit.hit_surface)
    if scene.hide_emitters:
        seen &= path.depth > 0
    ds = mi.DirectionSample3f(scene.whole, hit.si, path.si_prev)
    emitter_pmf = scene.selection.pmf(ds.emitter, path.si_prev, seen)
    emitter_pmf = dr.select(path.bsdf_delta_prev, 0, emitter_pmf)
    light, through, emitter_pdf, on_proxy, on_geometry = scene.lamps.call(
        hit_light,
        ds.emitter,
        hit.si,
        path.si_prev,
        ds,
        path.specular_chain,
        hit.shown,
        path.bsdf_pdf_prev,
        emitter_pmf,
        hit.hit_surface,
    )
    self_pmf = dr.select(path.self_sampled & ~path.bsdf_delta_prev, 1, 0)
    emitter_pdf *= dr.select(on_geometry, self_pmf, emitter_pmf)
    contribution = path.β * mis_weight(path.bsdf_pdf_prev, emitter_pdf) * light
    path.add_light(scene, ds.emitter, contribution, path.specular_chain, seen, hit.shown)

    on_proxy &= hit.hit_surface & hit.si.is_valid()
    path.valid_ray |= on_proxy & seen & (dr.max(light) > 0)
    path.β[on_proxy] *= through
    return on_proxy


def sample_emitter(
    scene: PathScene, path: PathState, vertex: Vertex, sampler: mi.Sampler
) -> EmitterChoice:
    """Sample an emitter, and a direction towards it. Nothing costly is evaluated yet."""
    active = vertex.active_surface & mi.has_flag(vertex.bsdf.flags(), mi.BSDFFlags.Smooth)
    scene.layers.add_surface(path.record, vertex.si, path.β, active)
    active |= vertex.active_medium
    # Light passes an opaque surface on neither side of its horizon.
    n = mi.Vector3f(vertex.si.n)
    normal = dr.select(vertex.opaque, n * -dr.sign(dr.dot(n, path.ray.d)), 0)
    selected = scene.selection.sample(vertex.si, normal, vertex.owner, sampler, active)
    active &= selected.weight > 0
    emitter = scene.emitter(selected.index, active)
    # From a lamp itself its light comes by `add_self_emission`.
    active &= selected.index != vertex.owner
    sampled = scene.lamps.call(sample_target, emitter, vertex.si, selected.sample, active)
    active &= sampled.valid
    return EmitterChoice(emitter, selected, sampled, active)


def add_emitter_light(
    scene: PathScene,
    path: PathState,
    vertex: Vertex,
    choice: EmitterChoice,
    scattering: Scattering,
) -> None:
    """Add light of a sampled emitter.

    Whether light arrives is asked before how much a baked luminaire sends, which costs a traversal.
    """
    si, ds, active = vertex.si, choice.sampled.ds, choice.active
    active &= ~(vertex.opaque & on_opposite_sides(si, path.ray.d, ds.d))
    light = path.β * scattering.value_em
    active &= dr.max(light) > 0
    light *= visible(
        scene, si, ds, choice.sampled.beyond, choice.selected.index, path.medium, active
    )
    active &= dr.max(light) > 0
    emitter_pmf = choice.selected.emitter_pmf
    weight, pdf = scene.lamps.call(
        eval_target, choice.emitter, si, choice.sampled, scattering.pdf_em, emitter_pmf, active
    )
    weight *= choice.selected.weight
    pdf *= emitter_pmf
    needs_no_mis = ds.delta | choice.sampled.includes_mis
    light *= weight * dr.select(needs_no_mis, 1, mis_weight(pdf, scattering.pdf_em))
    path.add_light(scene, choice.emitter, light, mi.Bool(False), active)


@dr.syntax
def add_self_emission(
    scene: PathScene, path: PathState, vertex: Vertex, sampler: mi.Sampler
) -> mi.Bool:
    """Add light that a lamp sends to its own surfaces and media, where the path shows them.

    Returns where it was sampled.
    """
    if dr.hint(not scene.shows_geometry, mode="scalar"):
        return mi.Bool(False)
    shows = vertex.active_surface & mi.has_flag(vertex.bsdf.flags(), mi.BSDFFlags.Smooth)
    shows = (shows | vertex.active_medium) & vertex.shown & (vertex.owner != NONE)
    sample = sampler.next_2d()
    light, emitter = mi.Spectrum(0), dr.zeros(mi.EmitterPtr)
    # A branch: most packets of rays have no such vertex, and skip the code. Where derivatives make
    # the loops of this integrator evaluated ones, it is evaluated too: shadow rays have a loop.
    mode = None if dr.flag(dr.JitFlag.SymbolicLoops) else "evaluated"
    if dr.hint(shows, mode=mode):
        light, emitter = _self_emission(scene, path, vertex, sample, shows)
    path.add_light(scene, emitter, light, mi.Bool(False), shows, shown=True)
    return shows


def _self_emission(
    scene: PathScene, path: PathState, vertex: Vertex, sample: mi.Point2f, shows: mi.Bool
) -> tuple[mi.Spectrum, mi.EmitterPtr]:
    """Light of a sampled point of a lamp's emitting shapes, and their emitter."""
    si, bsdf = vertex.si, vertex.bsdf
    shape, pmf, sample.x = dr.dispatch(
        scene.emitter(vertex.owner, shows), sample_self_emission, sample.x, shows
    )
    ds, weight = dr.dispatch(shape.emitter(), sample_self_direction, si, sample, shows)
    ds.pdf *= pmf
    active = shows & (ds.pdf > 0)
    wo = si.to_local(ds.d)
    value, pdf = bsdf.eval_pdf(scene.bsdf_ctx, si, wo, active & vertex.active_surface)
    if scene.divided.owners.scatter:
        phase = medium_paths.eval_phase(path.medium, path.ray, ds.d, active & vertex.active_medium)
        value[vertex.active_medium], pdf[vertex.active_medium] = phase
    active &= ~(vertex.opaque & on_opposite_sides(si, path.ray.d, ds.d))
    # The lamp's own glass attenuates its light here.
    through = visible(scene, si, ds, mi.Float(0), mi.UInt32(NONE), path.medium, active)
    light = path.β * value * through * weight * (mis_weight(ds.pdf, pdf) / pmf)
    return light & active, shape.emitter()
