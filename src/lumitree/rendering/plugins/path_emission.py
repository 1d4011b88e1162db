"""Light that paths of `lumitree_path` get: of emitters that are hit, and by emitter sampling."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from lumitree.rendering.plugins.emitter_calls import (
    eval_target,
    hit_light,
    sample_target,
)
from lumitree.rendering.plugins.path_scene import PathScene
from lumitree.rendering.plugins.path_state import EmitterChoice, Hit, PathState, Scattering, Vertex
from lumitree.rendering.plugins.proxies import NONE
from lumitree.rendering.plugins.shadow_rays import visible
from lumitree.rendering.sampling.samples import mis_weight
from lumitree.trace.spawning import on_opposite_sides


def add_emission(scene: PathScene, path: PathState, hit: Hit) -> None:
    """Add light of the emitter that the ray has hit."""
    seen = mi.Bool(hit.hit_surface)
    if scene.hide_emitters:
        seen &= path.depth > 0
    ds = mi.DirectionSample3f(scene.whole, hit.si, path.si_prev)
    # Emitter sampling chooses a lamp, and then a point of its shapes.
    sampled = ds.emitter
    if scene.shows_geometry:
        of_lamp = seen & (hit.owner != NONE)
        sampled = dr.select(of_lamp, scene.emitter(hit.owner, of_lamp), sampled)
    emitter_pmf = scene.selection.pmf(sampled, path.si_prev, seen)
    emitter_pmf = dr.select(path.bsdf_delta_prev, 0, emitter_pmf)
    light, emitter_pdf = scene.lamps.call(
        hit_light, ds.emitter, hit.si, path.si_prev, ds, hit.shown, hit.straight, hit.hit_surface
    )
    # A density may be infinite, as of a point that is seen along the surface from `si_prev`.
    emitter_pdf = dr.select(emitter_pmf > 0, emitter_pdf * emitter_pmf, 0)
    weight = mis_weight(path.bsdf_pdf_prev, emitter_pdf)
    contribution = path.β * weight * light
    path.add_light(scene, ds.emitter, contribution, path.specular_chain, seen, hit.shown)


def sample_emitter(
    scene: PathScene, path: PathState, vertex: Vertex, sampler: mi.Sampler
) -> EmitterChoice:
    """Sample an emitter, and a direction towards it. Nothing costly is evaluated yet."""
    active = vertex.active_surface & mi.has_flag(vertex.bsdf.flags(), mi.BSDFFlags.Smooth)
    scene.layers.add_surface(path.record, vertex.si, path.β, active)
    active = (active | vertex.active_medium) & ~vertex.last
    # An opaque surface transmits no light, on either side of its horizon.
    n = mi.Vector3f(vertex.si.n)
    normal = dr.select(vertex.opaque, n * -dr.sign(dr.dot(n, path.ray.d)), 0)
    # A lamp lights its own surfaces where the path shows them. Else its light field has that light.
    without = dr.select(vertex.shown, NONE, vertex.owner)
    selected = scene.selection.sample(vertex.si, normal, without, sampler, active)
    active &= (selected.weight > 0) & (selected.index != without)
    emitter = scene.emitter(selected.index, active)
    own = active & (selected.index == vertex.owner)
    sampled = scene.lamps.call(sample_target, emitter, vertex.si, selected.sample, own, active)
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
    # What passes a lamp's glass is in its light field, of which its own surfaces get nothing.
    own = choice.selected.index == vertex.owner
    target = dr.select(own, NONE, choice.selected.index)
    light *= visible(scene, si, ds, choice.sampled.beyond, target, path.medium, active)
    active &= dr.max(light) > 0
    emitter_pmf = choice.selected.emitter_pmf
    weight, pdf = scene.lamps.call(
        eval_target, choice.emitter, si, choice.sampled, scattering.pdf_em, emitter_pmf, active
    )
    weight *= choice.selected.weight
    pdf *= emitter_pmf
    needs_no_mis = ds.delta | choice.sampled.includes_mis
    light *= weight * dr.select(needs_no_mis, 1, mis_weight(pdf, scattering.pdf_em))
    path.add_light(scene, choice.emitter, light, mi.Bool(False), active, own)
