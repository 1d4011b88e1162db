"""Light traced from the emitters: where it leaves the luminaire, and where it last was bent.

Camera paths find the image of a filament in a glass wall only by chance; light that starts at the
filament always shows it. Light that reaches the outside by perfectly smooth transmission alone is
left out: camera rays follow that without noise (`lumitree.transport.straight_through`).

Symbols
    flux        of a path, radiance units times the measure dA cos(theta) domega of `TracedRays`
    stop        where a camera ray that meets the path in reverse would stop, see `Stops`
"""

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.frames import similarity_scale
from lumitree.luminaire.luminaire import Luminaire
from lumitree.transport.straight_through import COSINE_OF_CONE, is_smooth, is_transmitted

# Paths longer than this many events are played at Russian roulette with.
_ROULETTE_DEPTH = 8


@dataclasses.dataclass
class LightPaths:
    """Paths that have left the luminaire.

    Attributes:
        origin: mi.Point3f, the last place they were bent; local frame.
        direction: mi.Vector3f, of the camera ray that sees them: against their flight.
        flux: mi.Color3f; the sum over all paths of a trace is the flux they stand for.
        stop: mi.Point3f, local frame.
    """

    origin: Any
    direction: Any
    flux: Any
    stop: Any


def trace_light(luminaire: Luminaire, sampler: Any, count: int, path_depth: int) -> LightPaths:
    """Trace `count` paths from the emitters; those that end outside are returned.

    Args:
        sampler: mi.Sampler, seeded for as many paths.
        path_depth: longest path, events.
    """
    origin, direction, flux, stop, leaves = _trace(luminaire.scene, sampler, path_depth)
    dr.eval(origin, direction, flux, stop, leaves)
    chosen = dr.compress(leaves)
    if not dr.width(chosen):
        # An array without elements goes with no other: one path that carries nothing stands in.
        chosen, flux = mi.UInt32([0]), mi.Color3f(dr.zeros(mi.Float, count))
    to_local = mi.Transform4f(np.linalg.inv(luminaire.world_from_proxy))
    dr.make_opaque(to_local)
    scale = dr.opaque(mi.Float, 1 / (count * similarity_scale(luminaire.world_from_proxy) ** 2))
    paths = LightPaths(
        to_local @ dr.gather(mi.Point3f, origin, chosen),
        dr.normalize(to_local @ dr.gather(mi.Vector3f, -direction, chosen)),
        dr.gather(mi.Color3f, flux, chosen) * scale,
        to_local @ dr.gather(mi.Point3f, stop, chosen),
    )
    dr.eval(paths.origin, paths.direction, paths.flux, paths.stop)
    return paths


@dr.syntax
def _trace(scene, sampler, path_depth):
    context = mi.BSDFContext(mi.TransportMode.Importance)
    index, chance, _ = scene.sample_emitter(sampler.next_1d())
    emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), index)
    ray, weight = emitter.sample_ray(0, sampler.next_1d(), sampler.next_2d(), sampler.next_2d())
    ray = mi.Ray3f(ray)
    light = mi.Color3f(weight * chance)
    flux = mi.Color3f(light)
    # Where the last chain of transmissions began, and in which direction.
    start, start_direction = mi.Point3f(ray.o), mi.Vector3f(ray.d)
    smooth = mi.Bool(True)
    first = mi.Bool(True)
    medium = dr.zeros(mi.MediumPtr)
    depth = mi.UInt32(0)
    leaves = mi.Bool(False)
    active = dr.max(flux) > 0
    while active:
        si = scene.ray_intersect(ray, active)
        leaves |= active & ~si.is_valid()
        active &= si.is_valid()
        # An emitter within a medium: what it looks back into from the first border.
        border = active & si.is_medium_transition()
        medium = dr.select(first & border, si.target_medium(-ray.d), medium)
        first &= ~active

        inside = active & (medium != None)  # noqa: E711 (a vector comparison)
        here = dr.zeros(mi.MediumInteraction3f)
        here.p = ray.o
        here.wi = -ray.d
        here.sh_frame = mi.Frame3f(here.wi)
        scattering, _, extinction = medium.get_scattering_coefficients(here, inside)
        # The flight is that of one channel, chosen at random, weighed by the mean of all three.
        scatters = inside & (dr.max(scattering) > 0)
        choice = mi.UInt32(dr.minimum(3 * sampler.next_1d(scatters), 2))
        rate = dr.select(
            choice == 0, extinction.x, dr.select(choice == 1, extinction.y, extinction.z)
        )
        flight = dr.select(
            scatters & (rate > 0), -dr.log(1 - sampler.next_1d(scatters)) / rate, dr.inf
        )
        collides = scatters & (flight < si.t)
        through = dr.exp(-extinction * dr.select(collides, flight, si.t))
        mean = dr.mean(dr.select(collides, extinction * through, through))
        attenuation = dr.select(
            collides, scattering * through / mean, dr.select(scatters, through / mean, through)
        )
        flux[inside] = flux * attenuation

        here.p = ray(dr.select(collides, flight, 0))
        phase_context = mi.PhaseFunctionContext(sampler)
        phase = medium.phase_function()
        scattered, phase_weight, _ = phase.sample(
            phase_context, here, sampler.next_1d(collides), sampler.next_2d(collides), collides
        )

        hits = active & ~collides
        sample, bsdf_weight = si.bsdf().sample(
            context, si, sampler.next_1d(hits), sampler.next_2d(hits), hits
        )
        towards = si.to_world(sample.wo)
        # Veach 1997, Eq. 5.19: what shading normals make of light that travels backwards. Camera
        # paths take either side of a surface for what its shading normal says, so these do too.
        cos_in, cos_out = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(sample.wo)
        true_in, true_out = dr.dot(si.n, ray.d), dr.dot(si.n, towards)
        hits &= (true_in != 0) & (cos_out != 0)
        correction = dr.abs(cos_in * true_out / (cos_out * true_in))
        flux = dr.select(
            collides, flux * phase_weight, dr.select(hits, flux * bsdf_weight * correction, flux)
        )

        transmits = hits & is_transmitted(sample.sampled_type)
        smooth &= ~(active & ~(transmits & is_smooth(sample.sampled_type)))
        onwards = si.spawn_ray(towards)
        ray = dr.select(collides, mi.Ray3f(here.p, scattered), dr.select(hits, onwards, ray))
        begins = collides | (hits & ~transmits)
        start = dr.select(begins, ray.o, start)
        start_direction = dr.select(begins, ray.d, start_direction)
        medium = dr.select(transmits & si.is_medium_transition(), si.target_medium(ray.d), medium)
        depth += 1
        active = (collides | hits) & (depth < path_depth) & (dr.max(flux) > 0)
        survival = dr.clip(dr.max(flux) / dr.max(light), 0.05, 0.95)
        survival = dr.select(depth > _ROULETTE_DEPTH, survival, 1)
        active &= sampler.next_1d(active) < survival
        flux[active] = flux / survival

    bent = dr.dot(ray.d, start_direction) < COSINE_OF_CONE
    at_once = sampler.next_1d() < 0.5
    stop = stop_on_line(scene.bbox(), -ray.d, ray.o, start, bent & at_once)
    return ray.o, ray.d, flux, stop, leaves & ~smooth


def stop_on_line(box: Any, direction: Any, first: Any, last: Any, at_once: Any) -> Any:
    """Where a line counts as stopped whose path meets `first` and ends at `last`.

    On the line, abreast of where the path ends: through thick glass a thing is seen elsewhere than
    it is, and so lines of other directions see it there too.

    Args:
        box: mi.BoundingBox3f of the luminaire; what lies abreast outside it counts as at `first`.
        direction: mi.Vector3f of the line.
        first: mi.Point3f of the line, the first surface.
        last: mi.Point3f, the end of the path or its last place.
        at_once: mi.Bool, at `first` in any case: as often as not where the path is bent, so that
            glass hides what is behind it.
    """
    along = dr.dot(last - first, direction)
    abreast = first + along * direction
    inside = dr.all((abreast >= box.min) & (abreast <= box.max))
    return mi.Point3f(dr.select(at_once | (along <= 0) | ~inside, first, abreast))
