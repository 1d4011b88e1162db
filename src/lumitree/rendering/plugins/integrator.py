"""The integrator `lumitree_path`: Mitsuba's `path`, which also walks through null surfaces.

A null interaction (a baked luminaire's proxy, a hole of an alpha mask) bends no ray. So it counts
neither towards `max_depth` nor for Russian roulette, it keeps the state of multiple importance
sampling (the vertex before it and the density of the direction sampled there), and shadow rays
cross it with the transmittance that its BSDF states.

Homogeneous media attenuate and scatter light along each way (`medium_paths`). A scattering is a
vertex like one on a rough surface. Heterogeneous media need `volpath`, and are refused.

Opaque BSDFs do not scatter light through the geometric surface (`geometric_normals`), as `path`
lets them do where shading normals are smooth.

Proxies are not traced. The integrator traces the other shapes as a scene of their own, and finds
the proxies that a ray enters by itself (`proxies.DividedScene`). Where a scene cannot be divided, a
ray crosses a proxy as any null surface.

Where images show the model of a lamp, its shapes are in the scene, and each path gets its light
once. As long as all vertices since the camera are specular or on surfaces of this lamp, the path
gets what the lamp's shapes emit (`self_emission`). A scattering in a medium of the lamp's model
counts as a vertex on the lamp. Vertices elsewhere, inside its box too, get its light field,
which contains all light that its surfaces scatter: so these surfaces get none of it again.
After the first vertex that is not specular, the lamp's glass bends no ray (`model_plugins`),
and a crossing of it is a null interaction.

Symbols
    β, η    throughput of the path, product of its relative indices of refraction
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.errors import LumitreeError
from lumitree.lamp.media import absorption, media
from lumitree.rendering.layers import Layers, Unrecorded
from lumitree.rendering.plugins.deferred_emitter import DeferredEmitter, EmitterSample
from lumitree.rendering.plugins.model_plugins import CROSSED_STRAIGHT, ModelEmitter
from lumitree.rendering.plugins.proxies import ALL, NONE, DividedScene, bit_of
from lumitree.rendering.plugins.shadow_rays import MAX_CROSSINGS, has_null_surfaces, visible
from lumitree.rendering.sampling.emitter_sampling import Target
from lumitree.trace import medium_paths
from lumitree.trace.geometric_normals import is_opaque, on_opposite_sides
from lumitree.trace.spawning import scene_extent, spawn

_DEFAULT_RR_DEPTH = 5


def integrator_class() -> type:
    """Class of `lumitree_path` for the variant of Mitsuba that is set.

    Its properties are those of `path`: `max_depth` (-1: no limit), `rr_depth` and
    `hide_emitters`, which hides baked luminaires from the camera as other area lights.
    """

    class LumitreePath(mi.SamplingIntegrator):
        # Other integrators cannot divide the light of a lamp whose model is in the scene.
        shows_models = True

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.max_depth = int(props.get("max_depth", -1))
            self.rr_depth = int(props.get("rr_depth", _DEFAULT_RR_DEPTH))
            # What is recorded beside the image.
            self.layers: Layers | Unrecorded = Unrecorded()
            self._divided = DividedScene()
            if self.max_depth < -1 or self.rr_depth < 1:
                raise LumitreeError(
                    f"lumitree_path has max_depth {self.max_depth} and rr_depth {self.rr_depth}; "
                    "expected max_depth of -1 (no limit) or more and rr_depth of 1 or more"
                )

        def sample(self, scene, sampler, ray, medium=None, active=True):
            if not scene.emitters():
                nothing = [mi.Float(0) for _ in self.aov_names()]
                return mi.Color3f(0), scene.ray_test(ray, active), nothing
            crossed = [*media(scene), *([] if medium is None else [medium])]
            if not all(each.is_homogeneous() for each in crossed):
                raise LumitreeError(
                    "a medium is heterogeneous; lumitree_path expects homogeneous media: use "
                    "volpath"
                )
            divided = self._divided.of(scene)
            medium = dr.zeros(mi.MediumPtr) if medium is None else mi.MediumPtr(medium)
            ray, active = mi.Ray3f(ray), mi.Bool(active)
            return _trace(self, scene, divided, crossed, sampler, ray, medium, active)

        def aov_names(self):
            return self.layers.channel_names()

        def to_string(self) -> str:
            return f"LumitreePath[max_depth={self.max_depth}, rr_depth={self.rr_depth}]"

    return LumitreePath


@dr.syntax
def _trace(settings, scene, divided, crossed, sampler, ray, medium, active):
    """Radiance along camera rays, whether they met something (for the film's alpha), and layers."""
    max_depth = mi.UInt32(settings.max_depth % (1 << 32))  # no limit: the largest number
    surfaces, proxies, _, owners = divided
    sees_null = has_null_surfaces(surfaces)
    sees_media = bool(crossed)
    sees_scattering = any(absorption(each) is None for each in crossed)
    shows_models = any(isinstance(emitter, ModelEmitter) for emitter in scene.emitters())
    sees_environment = scene.environment() is not None and not settings.hide_emitters
    extent = scene_extent(scene)
    sampling_weight = sum(emitter.sampling_weight() for emitter in scene.emitters())
    context = mi.BSDFContext()

    layers = settings.layers
    record = layers.start()
    radiance, β, η = mi.Color3f(0), mi.Color3f(1), mi.Float(1)
    # For media that scatter: the channel that the path is sampled for, and see `medium_paths`.
    channel, ρ = mi.UInt32(0), mi.Color3f(1)
    if dr.hint(sees_scattering, mode="scalar"):
        channel = medium_paths.draw_channel(sampler)
    # `freed` counts bounces that do not count towards the largest depth.
    depth, freed, crossings = mi.UInt32(0), mi.UInt32(0), mi.UInt32(0)
    valid = mi.Bool(sees_environment)
    # The last interaction that was not null, the density of the direction sampled there, and
    # whether next-event estimation could not have found that direction.
    vertex = dr.zeros(mi.Interaction3f)
    pdf, delta = mi.Float(1), mi.Bool(True)
    # Whether all interactions since the camera were specular, so that the image shows the next.
    specular_chain = mi.Bool(True)
    # The lamp whose own shapes' emission counts even if not all interactions were specular; and
    # whether next-event estimation at the vertex could have found it.
    self_emission, sampled_self_emission = mi.UInt32(NONE), mi.Bool(False)
    # Lamps whose light the ray does not get in the box in which it starts (`proxies.bit_of`).
    skipped = mi.UInt32(0)
    active &= depth < max_depth
    pi = surfaces.ray_intersect_preliminary(ray, coherent=True, active=active)

    while active:
        # Where a medium scatters before the ray meets anything.
        flight, collides = mi.Float(dr.inf), mi.Bool(False)
        if dr.hint(sees_scattering, mode="scalar"):
            flight = medium_paths.flight(medium, channel, sampler, active)
            collides = active & (flight < pi.t)
        if dr.hint(settings.hide_emitters, mode="scalar"):
            # Not Mitsuba's `skip_area_emitters`, whose distance belongs to another ray.
            hidden = active & ~collides & (depth == 0) & _emits(pi)
            while hidden:
                if dr.hint(sees_media, mode="scalar"):
                    weight, densities = medium_paths.passed(medium, pi.t, ρ, hidden)
                    β[hidden] *= weight
                    ρ[hidden] = densities
                passed = pi.compute_surface_interaction(ray, mi.RayFlags.Minimal, hidden)
                ray[hidden] = spawn(passed, ray.d, extent)
                pi[hidden] = surfaces.ray_intersect_preliminary(ray, coherent=True, active=hidden)
                crossings[hidden] += 1
                active &= crossings < MAX_CROSSINGS
                if dr.hint(sees_scattering, mode="scalar"):
                    flight[hidden] = medium_paths.flight(medium, channel, sampler, hidden)
                    collides |= hidden & (flight < pi.t)
                hidden &= active & ~collides & _emits(pi)

        # Lamps whose proxies the ray enters before it meets a surface.
        if dr.hint(proxies.exist, mode="scalar"):
            entered = mi.Bool(active)
            if dr.hint(settings.hide_emitters, mode="scalar"):
                entered &= depth > 0
            end = dr.minimum(pi.t, flight)
            distance, lamp = proxies.first(ray, end, entered, specular_chain, skipped)
            entered &= lamp != NONE
            ahead = owners.of(pi.shape, entered & pi.is_valid() & ~collides)
            while entered:
                ends = divided.ends(ray, end, lamp, ahead, entered)
                emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), lamp, entered)
                emitter_pmf = dr.select(
                    delta, 0, emitter.sampling_weight() * dr.rcp(sampling_weight)
                )
                emitted, through, emitter_pdf = dr.dispatch(
                    emitter,
                    entered_light,
                    ray,
                    distance,
                    vertex,
                    specular_chain,
                    pdf,
                    emitter_pmf,
                    ends,
                    entered,
                )
                emitted *= β * _mis_weight(pdf, emitter_pdf * emitter_pmf)
                if dr.hint(sees_media, mode="scalar"):
                    emitted *= medium_paths.passed(medium, distance, ρ, entered)[0]
                radiance[entered] += emitted
                layers.add_light(record, emitter, emitted, specular_chain, entered)
                β[entered] *= through
                valid |= entered & (dr.max(emitted) > 0)
                distance, lamp = proxies.next(
                    ray, distance, lamp, end, entered, specular_chain, skipped
                )
                entered &= lamp != NONE

        si = pi.compute_surface_interaction(ray, mi.RayFlags.All, active)
        hit_surface = active & ~collides
        if dr.hint(sees_media, mode="scalar"):
            weight, densities = medium_paths.passed(medium, si.t, ρ, hit_surface)
            β[hit_surface] *= weight
            ρ[hit_surface] = densities
        if dr.hint(sees_scattering, mode="scalar"):
            weight, densities = medium_paths.scattered(medium, flight, ρ, collides)
            β[collides] *= weight
            ρ[collides] = densities
        bsdf = si.bsdf(ray)

        # Light of the emitter that the ray has hit.
        seen = mi.Bool(hit_surface)
        if dr.hint(settings.hide_emitters, mode="scalar"):
            seen &= depth > 0
        ds = mi.DirectionSample3f(scene, si, vertex)
        pmf = ds.emitter.sampling_weight() * dr.rcp(sampling_weight)
        # The lamp that the surface belongs to, and whether the path gets what its shapes emit.
        owner, shown = mi.UInt32(NONE), mi.Bool(specular_chain)
        if dr.hint(shows_models, mode="scalar"):
            owner = owners.of(si.shape, hit_surface & si.is_valid())
            if dr.hint(owners.scatter, mode="scalar"):
                owner = dr.select(collides, owners.of_medium(medium, collides), owner)
            shown |= (owner == self_emission) & (owner != NONE)
        emitter_pmf = dr.select(delta, 0, pmf)
        emitted, through, emitter_pdf, proxy, of_lamp = dr.dispatch(
            ds.emitter,
            _emitted,
            si,
            vertex,
            ds,
            specular_chain,
            shown,
            pdf,
            emitter_pmf,
            hit_surface,
        )
        self_pmf = dr.select(sampled_self_emission & ~delta, 1, 0)
        emitter_pdf *= dr.select(of_lamp, self_pmf, emitter_pmf)
        hit = β * _mis_weight(pdf, emitter_pdf) * emitted
        radiance[seen] += hit
        layers.add_light(record, ds.emitter, hit, specular_chain, seen)

        # A proxy is left the way it was entered; every other surface is sampled.
        proxy &= hit_surface & si.is_valid()
        scatters = active & ~proxy & (si.is_valid() | collides) & (depth - freed + 1 < max_depth)
        if dr.hint(sees_scattering, mode="scalar"):
            si[collides] = medium_paths.scattering_point(ray, flight)
        # By a surface, or by the medium before it.
        reflects, collides = scatters & ~collides, scatters & collides

        glass, behind, shows = mi.Bool(False), mi.Bool(False), mi.Bool(False)
        if dr.hint(shows_models, mode="scalar"):
            # Glass that light crosses straight is seen from outside on both sides.
            glass = reflects & ~specular_chain & ((bsdf.flags() & CROSSED_STRAIGHT) != 0)
            behind = glass & (si.wi.z < 0)
            si.wi.z = dr.select(behind, -si.wi.z, si.wi.z)

        # Next-event estimation. Whether light arrives is asked before how much a baked luminaire
        # sends, which costs a traversal.
        estimates = reflects & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        layers.add_surface(record, si, β, estimates)
        estimates |= collides
        sample = sampler.next_2d()
        index, emitter_weight, sample.x = scene.sample_emitter(sample.x, estimates)
        emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), index, estimates)
        estimates &= index != owner
        sampled = dr.dispatch(emitter, sample_target, si, sample, estimates)
        ds = sampled.ds
        estimates &= sampled.valid
        wo = si.to_local(ds.d)
        bsdf_value, bsdf_pdf, bs, bsdf_weight = bsdf.eval_pdf_sample(
            context, si, wo, sampler.next_1d(), sampler.next_2d(), reflects
        )
        opaque = reflects & is_opaque(bsdf)
        estimates &= ~(opaque & on_opposite_sides(si, ray.d, ds.d))
        onwards = mi.Vector3f(0)
        if dr.hint(sees_scattering, mode="scalar"):
            phase = medium_paths.eval_phase(medium, ray, ds.d, collides)
            bsdf_value[collides], bsdf_pdf[collides] = phase
            onwards, *phase = medium_paths.sample_phase(medium, ray, sampler, collides)
            bsdf_weight[collides], bs.pdf[collides] = phase
        direct = β * bsdf_value
        estimates &= dr.max(direct) > 0
        way = scene, divided, sees_null, sees_media, extent
        direct *= visible(*way, si, ds, sampled.beyond, index, medium, estimates)
        estimates &= dr.max(direct) > 0
        emitter_pmf = dr.rcp(emitter_weight)
        weight, em_pdf = dr.dispatch(
            emitter, eval_target, si, sampled, bsdf_pdf, emitter_pmf, estimates
        )
        weight *= emitter_weight
        em_pdf *= emitter_pmf
        needs_no_mis = ds.delta | sampled.includes_mis
        direct *= weight * dr.select(needs_no_mis, 1, _mis_weight(em_pdf, bsdf_pdf))
        radiance[estimates] += direct
        layers.add_light(record, emitter, direct, mi.Bool(False), estimates)

        # The same from a surface or a medium of a lamp, for the lamp's own light.
        if dr.hint(shows_models, mode="scalar"):
            shows = reflects & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            shows = (shows | collides) & shown & (owner != NONE)
            sample = sampler.next_2d()
            lamp_emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), owner, shows)
            shape, emitter_pmf, sample.x = dr.dispatch(
                lamp_emitter, _sample_self_emission, sample.x, shows
            )
            ds = shape.sample_direction(si, sample, shows)
            ds.pdf *= emitter_pmf
            found = shows & (ds.pdf > 0)
            bsdf_value, bsdf_pdf = bsdf.eval_pdf(context, si, si.to_local(ds.d), found & reflects)
            if dr.hint(owners.scatter, mode="scalar"):
                phase = medium_paths.eval_phase(medium, ray, ds.d, found & collides)
                bsdf_value[collides], bsdf_pdf[collides] = phase
            found &= ~(opaque & on_opposite_sides(si, ray.d, ds.d))
            direct = (
                β * bsdf_value * visible(*way, si, ds, mi.Float(0), mi.UInt32(NONE), medium, found)
            )
            found &= dr.max(direct) > 0
            direct *= dr.dispatch(shape.emitter(), _self_radiance, ds, found)
            direct *= _mis_weight(ds.pdf, bsdf_pdf) / ds.pdf
            radiance[found] += direct
            layers.add_light(record, shape.emitter(), direct, mi.Bool(False), found)

        # The next ray.
        null = proxy | (reflects & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null))
        if dr.hint(shows_models, mode="scalar"):
            straight = glass & mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaTransmission)
            null |= straight
            # Radiance is not compressed, as it would be in a denser medium.
            β[straight] *= dr.square(bs.eta)
            bs.wo.z = dr.select(behind, -bs.wo.z, bs.wo.z)
        bounces = scatters & ~null
        β[proxy] *= through
        β[scatters] *= bsdf_weight
        η[bounces & reflects] *= bs.eta
        vertex[bounces] = mi.Interaction3f(si)
        pdf[bounces] = bs.pdf
        sampled_self_emission[bounces] = shows
        # A ray that goes on behind a proxy, or behind a surface of a lamp, has its light already.
        skipped[bounces] = 0
        skipped[proxy] = ALL
        if dr.hint(shows_models, mode="scalar"):
            self_emission[bounces] = dr.select(shown, owner, NONE)
            skipped[bounces | null] |= bit_of(owner)
        delta[bounces] = reflects & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        specular_chain &= ~bounces | delta
        depth[bounces] += 1
        if dr.hint(owners.scatter, mode="scalar"):
            # Light that scatters in a lamp is shown whatever the largest depth: as the light that
            # the lamp sends elsewhere.
            freed[bounces & shown & owners.scatters(owner, bounces) & (freed < MAX_CROSSINGS)] += 1
        valid |= bounces | (proxy & seen & (dr.max(emitted) > 0))
        # A null ray keeps its direction to the last bit.
        direction = dr.select(null, ray.d, si.to_world(bs.wo))
        if dr.hint(sees_scattering, mode="scalar"):
            direction[collides] = onwards
        leaks = opaque & ~null & on_opposite_sides(si, ray.d, direction)
        ray = spawn(si, direction, extent)
        crossings[null] += 1
        if dr.hint(sees_media, mode="scalar"):
            medium = medium_paths.behind(si, ray.d, medium, proxy | reflects)

        # Russian roulette, as in `path`.
        brightest = dr.max(β)
        survival = dr.minimum(brightest * dr.square(η), 0.95)
        roulette = bounces & (depth >= settings.rr_depth)
        survives = ~roulette | (sampler.next_1d() < survival)
        β[roulette] *= dr.rcp(survival)
        active = (proxy | scatters) & ~leaks & survives
        active &= (brightest != 0) & (crossings < MAX_CROSSINGS)
        pi = surfaces.ray_intersect_preliminary(ray, coherent=False, active=active)

    return radiance, valid, layers.channels(record)


def _emitted(
    emitter: Any,
    si: Any,
    vertex: Any,
    ds: Any,
    specular_chain: Any,
    shown: Any,
    pdf: Any,
    emitter_pmf: Any,
    active: Any,
) -> tuple[Any, Any, Any, Any, Any]:
    """Radiance of an emitter that was hit, T if it is a proxy, density, and whether it is one.

    Last, whether it belongs to a shape of a lamp's model.
    """
    no = mi.Bool(False)
    if isinstance(emitter, DeferredEmitter):
        # Only where the scene is not divided.
        ray = mi.Ray3f(si.p, -si.to_world(si.wi))
        entering = active & (mi.Frame3f.cos_theta(si.wi) > 0)
        nowhere = mi.Float(dr.inf), mi.Float(dr.inf)
        hit = entered_light(
            emitter, ray, mi.Float(0), vertex, specular_chain, pdf, emitter_pmf, nowhere, entering
        )
        return *hit, mi.Bool(True), no
    if isinstance(emitter, ModelEmitter):
        radiance, pdf = emitter.eval_self_emission(si, vertex, ds, active & shown)
        return radiance & shown, mi.Float(1), pdf, no, mi.Bool(True)
    pdf = emitter.pdf_direction(vertex, ds, active)
    return emitter.eval(si, active), mi.Float(1), pdf, no, no


def entered_light(
    emitter: Any,
    ray: Any,
    distance: Any,
    vertex: Any,
    specular_chain: Any,
    pdf: Any,
    emitter_pmf: Any,
    ends: tuple[Any, Any],
    active: Any,
) -> tuple[Any, Any, Any]:
    """Radiance, transmittance and density of a lamp whose proxy a ray enters."""
    if isinstance(emitter, DeferredEmitter):
        return emitter.eval_entered(
            ray, distance, vertex, specular_chain, pdf, emitter_pmf, ends, active
        )
    return mi.Color3f(0), mi.Float(1), mi.Float(0)


def _sample_self_emission(emitter: Any, sample: Any, active: Any) -> tuple[Any, Any, Any]:
    """A shape of a lamp that emits, its probability, and a new sample."""
    if isinstance(emitter, DeferredEmitter):
        return emitter.sample_self_emission(sample, active)
    return dr.zeros(mi.ShapePtr), mi.Float(0), mi.Float(0)


def _self_radiance(emitter: Any, ds: Any, active: Any) -> Any:
    """Radiance of a sampled point of a lamp's shape."""
    if isinstance(emitter, ModelEmitter):
        return emitter.radiance_at(ds, active)
    return mi.Color3f(0)


def sample_target(emitter: Any, it: Any, sample: Any, active: Any) -> EmitterSample:
    """Direction sampled towards an emitter; weight and density are for `eval_target` to find."""
    if isinstance(emitter, DeferredEmitter):
        return emitter.sample_target(it, sample, active)
    ds, weight = emitter.sample_direction(it, sample, active)
    target = Target.at(mi.Float(0))
    return EmitterSample(ds, weight, ds.pdf != 0, mi.Bool(False), target, mi.Float(0))


def eval_target(
    emitter: Any, it: Any, sampled: EmitterSample, bsdf_pdf: Any, emitter_pmf: Any, active: Any
) -> tuple[Any, Any]:
    """Weight and density of a direction of `sample_target`."""
    if isinstance(emitter, DeferredEmitter):
        return emitter.eval_target(it, sampled, bsdf_pdf, emitter_pmf, active)
    return mi.Color3f(sampled.weight), mi.Float(sampled.ds.pdf)


def _emits(pi: Any) -> Any:
    """Whether a preliminary intersection is with an emitter."""
    return pi.is_valid() & (pi.shape.emitter() != None)  # noqa: E711 (a vector comparison)


def _mis_weight(pdf: Any, other_pdf: Any) -> Any:
    """Power heuristic; 0 where neither density is positive, as in `path`."""
    weight = dr.square(pdf) / (dr.square(pdf) + dr.square(other_pdf))
    return dr.select(dr.isfinite(weight), weight, 0)
