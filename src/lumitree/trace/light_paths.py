"""Light paths: light traced from a luminaire's emitters until it leaves the luminaire.

Camera paths seldom find the image of a filament in a glass wall. Light paths, which start
at the filament, always find it. `LampRays` draws batches of them; an asset emits rays sampled from
its emission (`lumitree.rendering.asset_flux`). Both implement `EmittedRays`, over which flux,
irradiance, photometry and bakes sum.

Symbols
    flux                of a path: radiance times the measure dA cos θ dω, local frame
    straight            all events since the emitter were null interactions: masks and thin glass
                        that the light passed, media that did not scatter it
    smooth              all events were smooth transmissions or null interactions
    termination point   where the field should stop a camera ray that meets the path in
                        reverse, see `termination_point`
    ρ                   as in `lumitree.trace.medium_paths`
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import as_rows, parameter
from lumitree.core.frames import from_viewer
from lumitree.lamp.luminaire import Luminaire
from lumitree.trace import medium_paths
from lumitree.trace.cameras import COSINE_OF_CONE, PATH_DEPTH, check_finite
from lumitree.trace.segments import EndingConfig, EndingSegments, Reservoir, restoring_factor
from lumitree.trace.spawning import (
    is_opaque,
    is_smooth,
    is_transmitted,
    on_opposite_sides,
    scene_box,
    scene_extent,
    spawn,
)

# Number of events after which Russian roulette begins.
_ROULETTE_DEPTH = 8


@dataclasses.dataclass
class RayBatch:
    """Rays that leave a luminaire or an asset; local frame.

    Attributes:
        origin: inside the bounding box, local units.
        direction: unit direction of travel.
        flux: in the luminaire's unit of radiance times sr times local units². The sum over the rays
            of a draw is an estimate of the emitted flux.
    """

    origin: mi.Point3f
    direction: mi.Vector3f
    flux: mi.Color3f

    def arrays(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Origin, direction and flux, each [N, 3]."""
        vectors = self.origin, self.direction, self.flux
        dr.eval(vectors)
        origin, direction, flux = map(as_rows, vectors)
        return origin, direction, flux


class EmittedRays(Protocol):
    """The rays of a luminaire, of an asset, or of another representation of its light."""

    def draw(self, count: int, seed: int) -> RayBatch:
        """Rays that leave, of `count` samples; samples that are absorbed have none.

        Args:
            count: number of samples, which the flux of the rays is divided by.
            seed: 32-bit seed of the draw, see `lumitree.core.seeds`. Equal seeds give equal rays.
        """
        ...


def seeded_sampler(seed: int, count: int) -> mi.Sampler:
    """Independent sampler for `count` samples."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    return sampler


@dataclasses.dataclass
class LightPaths(RayBatch):
    """Light paths that have left the luminaire.

    Each ray starts at the last vertex of its path that is not a null interaction, so straight light
    starts at the emitter. The flux is the light that leaves: a receiver between an emitter and a
    tinted pane gets the light that leaves the pane.

    Attributes:
        straight: whether the light of each ray is straight.
        exit: where each ray leaves its last surface, null ones too; local frame.
        termination: termination point, local frame.
        ending: segments of all paths, also of absorbed ones, that end on the luminaire; None if
            `trace_light` was called without.
    """

    straight: mi.Bool
    exit: mi.Point3f
    termination: mi.Point3f
    ending: EndingSegments | None = None


class LampRays:
    """Light paths of a luminaire, all that leave it; `EmittedRays`.

    Args:
        luminaire: what is traced.
        path_depth: longest path, events.
    """

    def __init__(self, luminaire: Luminaire, path_depth: int = PATH_DEPTH) -> None:
        self._luminaire, self._path_depth = luminaire, path_depth

    def draw(
        self,
        count: int,
        seed: int,
        *,
        ending: EndingConfig | None = None,
        flux_limit: float | None = None,
    ) -> LightPaths:
        """As `EmittedRays.draw`.

        Args:
            count: number of light paths.
            seed: of the draw.
            ending, flux_limit: as for `trace_light`.

        Raises:
            LumitreeError: a path's flux is NaN or infinite.
        """
        paths = trace_light(
            self._luminaire,
            seeded_sampler(seed, count),
            count,
            self._path_depth,
            all_light=True,
            ending=ending,
            flux_limit=flux_limit,
        )
        check_finite(self._luminaire, as_rows(paths.flux))
        if paths.ending is not None:
            check_finite(self._luminaire, as_rows(paths.ending.flux))
        return paths

    def bare_flux(self, count: int, seed: int) -> NDArray[np.float64]:
        """Flux [3] with which the paths of `draw` start, before the luminaire absorbs any.

        It is an estimate of the flux of the bare emitters, local units.
        """
        sampler = seeded_sampler(seed, count)
        return as_rows(emitted_flux(self._luminaire, sampler, count)[0]).sum(axis=0)


def trace_light(
    luminaire: Luminaire,
    sampler: mi.Sampler,
    count: int,
    path_depth: int,
    *,
    all_light: bool = False,
    ending: EndingConfig | None = None,
    flux_limit: float | None = None,
) -> LightPaths:
    """Trace `count` light paths; those that leave the luminaire are returned.

    Light that leaves by smooth transmission only is omitted by default: camera rays that are
    followed straight through find it without noise (`cameras.straight_through`).

    The factor for shading normals has no bound, and the flux of paths has a heavy tail: the number
    of paths with at least g times the flux with which they start is in proportion to 1 / g².
    `flux_limit` cuts the tail off, for bins that a single such path would make too bright.

    Args:
        sampler: seeded for as many paths.
        path_depth: longest path, events.
        all_light: also return paths that leave by smooth transmission only.
        ending: also return segments that end on the luminaire. The paths are the same with it.
        flux_limit: limit of the flux of a path over the flux with which it starts. Straight paths
            have none: only the choice of a channel in a medium makes them brighter, by up to 3. The
            flux above the limit is given to all paths, and to all ending segments, that are not
            straight, in proportion to their flux: sums over the trace stay unbiased, and the
            distribution is biased by the moved flux, 0.1 to 0.2 % for a limit of 8. Default: none,
            and no bias.
    """
    reservoir = None if ending is None else Reservoir.empty(ending, luminaire.scene_frame, count)
    traced, reservoir = _trace(luminaire, sampler, path_depth, reservoir, flux_limit)
    # Evaluated together: otherwise each of them would trace all paths again.
    dr.eval(traced, reservoir)
    flux, leaves = traced.flux, traced.leaves
    if flux_limit is not None:
        bent = dr.select(leaves & ~traced.straight, flux, 0)
        factor = mi.Color3f([restoring_factor(channel * traced.cut, channel) for channel in bent])
        flux = dr.select(traced.straight, flux, flux * factor)
    chosen = dr.compress(leaves if all_light else leaves & ~traced.smooth)
    if not dr.width(chosen):
        # Dr.Jit does not combine an empty array with others, so one path without flux is returned.
        chosen, flux = mi.UInt32([0]), mi.Color3f(dr.zeros(mi.Float, count))
    to_local = mi.Transform4f(luminaire.scene_frame.local_from_world)
    dr.make_opaque(to_local)
    scale = parameter(mi.Float, 1 / (count * luminaire.frame.scale**2))
    paths = LightPaths(
        to_local @ dr.gather(mi.Point3f, traced.vertex, chosen),
        dr.normalize(to_local @ dr.gather(mi.Vector3f, traced.ray.d, chosen)),
        dr.gather(mi.Color3f, flux, chosen) * scale,
        dr.gather(mi.Bool, traced.straight, chosen),
        to_local @ dr.gather(mi.Point3f, traced.ray.o, chosen),
        to_local @ dr.gather(mi.Point3f, traced.termination, chosen),
        None if reservoir is None else reservoir.segments(scale),
    )
    rays = paths.origin, paths.direction, paths.flux, paths.straight, paths.exit
    dr.eval(rays, paths.termination)
    return paths


def emitted_flux(
    luminaire: Luminaire, sampler: mi.Sampler, count: int
) -> tuple[mi.Color3f, mi.UInt32]:
    """Flux with which `count` light paths start, before the luminaire absorbs any.

    Args:
        sampler: seeded for as many paths. Seeded as for `trace_light`, the paths start alike.

    Returns:
        Flux of each path, local units, whose sum is an estimate of the flux of the bare
        emitters; and the path's emitter as its index in the scene.
    """
    extent = scene_extent(luminaire.scene)
    _, flux, emitter = emit(luminaire.emitting_surfaces, sampler, extent)
    return flux * parameter(mi.Float, 1 / (count * luminaire.frame.scale**2)), emitter


@dataclasses.dataclass
class _Traced:
    """Light paths where they ended; scene frame.

    Attributes:
        ray: the last ray.
        vertex: the last vertex that is not a null interaction.
        flux: of the path.
        cut: flux without a limit over `flux`.
        straight, smooth: whether the path is.
        leaves: whether it left the luminaire.
        termination: termination point.
    """

    ray: mi.Ray3f
    vertex: mi.Point3f
    flux: mi.Color3f
    cut: mi.Float
    straight: mi.Bool
    smooth: mi.Bool
    leaves: mi.Bool
    termination: mi.Point3f


@dr.syntax
def _trace(luminaire, sampler, path_depth, reservoir, flux_limit):
    """The `_Traced` paths, and the reservoir."""
    scene, context = luminaire.scene, mi.BSDFContext(mi.TransportMode.Importance)
    extent, box = scene_extent(scene), scene_box(scene)
    ray, light = emit(luminaire.emitting_surfaces, sampler, extent)[:2]
    flux = mi.Color3f(light)
    cut, vertex, straight = mi.Float(1), mi.Point3f(ray.o), mi.Bool(True)
    # Where the last chain of transmissions began, and its direction there.
    start, start_direction = mi.Point3f(ray.o), mi.Vector3f(ray.d)
    smooth = mi.Bool(True)
    medium = dr.zeros(mi.MediumPtr)
    if dr.hint(luminaire.has_media, mode="scalar"):
        medium = medium_paths.medium_around(scene, ray, extent)
    channel, ρ = medium_paths.draw_channel(sampler), mi.Color3f(1)
    depth = mi.UInt32(0)
    leaves = mi.Bool(False)
    active = dr.max(flux) > 0
    while active:
        si = scene.ray_intersect(ray, active)
        leaves |= active & ~si.is_valid()
        active &= si.is_valid()

        arriving = mi.Color3f(flux)
        collides, free_flight, weight, ρ = medium_paths.traverse(
            medium, si.t, channel, ρ, sampler, active
        )
        flux *= weight
        hits = active & ~collides
        scattered, phase_weight, _ = medium_paths.sample_phase(medium, ray, sampler, collides)

        bsdf = si.bsdf()
        sample, bsdf_weight = bsdf.sample(
            context, si, sampler.next_1d(hits), sampler.next_2d(hits), hits
        )
        towards = si.to_world(sample.wo)
        passes = hits & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        passes &= dr.max(bsdf_weight) > 0
        if dr.hint(reservoir is not None, mode="scalar"):
            end = dr.select(collides, ray(free_flight), si.p)
            reservoir.add(vertex, end, ray.d, arriving, cut, straight, active & ~passes)
        correction, scatters = _shading_correction(si, bsdf, sample, ray.d, towards)
        hits &= scatters
        flux = dr.select(
            collides, flux * phase_weight, dr.select(hits, flux * bsdf_weight * correction, flux)
        )

        transmits = hits & is_transmitted(sample.sampled_type)
        smooth &= ~(active & ~(transmits & is_smooth(sample.sampled_type)))
        onwards = spawn(si, towards, extent)
        ray = dr.select(
            collides, mi.Ray3f(ray(free_flight), scattered), dr.select(hits, onwards, ray)
        )
        begins = collides | (hits & ~transmits)
        start = dr.select(begins, ray.o, start)
        start_direction = dr.select(begins, ray.d, start_direction)
        vertex = dr.select(active & ~passes, ray.o, vertex)
        straight &= ~active | passes
        medium = medium_paths.medium_after(si, ray.d, medium, transmits)
        depth += 1
        active = (collides | hits) & (depth < path_depth) & (dr.max(flux) > 0)
        relative = dr.max(flux) / dr.max(light)
        if dr.hint(flux_limit is not None, mode="scalar"):
            limited = active & ~straight
            above = dr.select(limited, dr.maximum(relative / flux_limit, 1), 1)
            flux, cut, relative = flux / above, cut * above, relative / above
        # Paths that lose nothing are not ended: many survivals of less than 1 would add flux.
        survival = dr.clip(relative, 0.05, 1)
        survival = dr.select(depth > _ROULETTE_DEPTH, survival, 1)
        active &= sampler.next_1d(active) < survival
        flux[active] = flux / survival

    deflected = dr.dot(ray.d, start_direction) < COSINE_OF_CONE
    at_first = sampler.next_1d() < 0.5
    termination = termination_point(box, from_viewer(ray.d), ray.o, start, deflected & at_first)
    paths = _Traced(ray, vertex, flux, cut, straight, smooth, leaves, termination)
    return paths, reservoir


def _shading_correction(si, bsdf, sample, arriving, leaving):
    """Factor on a sampled direction for shading normals, and whether light is scattered there.

    Veach 1997, Eq. 5.19. Camera paths decide by the shading normal which side of a surface they are
    on, so light paths do too.
    """
    cos_in, cos_out = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(sample.wo)
    true_in, true_out = dr.dot(si.n, arriving), dr.dot(si.n, leaving)
    crosses = ~is_transmitted(sample.sampled_type) & on_opposite_sides(si, arriving, leaving)
    scatters = (true_in != 0) & (cos_out != 0) & ~(crosses & is_opaque(bsdf))
    return dr.abs(cos_in * true_out / (cos_out * true_in)), scatters


def emit(surfaces, sampler, extent):
    """Rays of light paths that start; their flux (mi.Color3f), world units; and their emitters.

    Directions are sampled about the true normal, not the interpolated one: the ratio of both
    cosines has no bound. Camera paths see the faces themselves, from where both normals are
    visible: for a wire of eight sides this is 2 % less flux (Veach 1997, Eq. 5.19, at the first
    vertex).

    Returns:
        mi.Ray3f; mi.Color3f; and mi.UInt32, the index of the emitter in the scene.
    """
    point = surfaces.sample(sampler.next_2d())
    si = point.si
    normal = dr.mulsign(mi.Vector3f(si.n), dr.dot(si.n, si.sh_frame.n))
    direction = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
    si.wi = si.to_local(direction)
    radiance = mi.Color3f(point.emitter.eval(si))
    flux = dr.select(point.density > 0, radiance * dr.pi / point.density, 0)
    return spawn(si, direction, extent), flux, point.index


def termination_point(
    box: mi.BoundingBox3f,
    direction: mi.Vector3f,
    first: mi.Point3f,
    last: mi.Point3f,
    at_first: mi.Bool,
) -> mi.Point3f:
    """Termination point of a ray whose path meets the luminaire at `first` and ends at `last`.

    It is the orthogonal projection of `last` onto the ray: thick glass displaces what is behind it,
    and rays of other directions see it at the projection too.

    Args:
        box: of the luminaire; for a projection outside it, `first` is returned.
        direction: of the ray.
        first: on the ray, on the first surface.
        last: end of the path.
        at_first: whether to return `first` in any case. With probability ½ where the path is
            deflected, so that glass hides what is behind it.
    """
    along = dr.dot(last - first, direction)
    projection = first + along * direction
    inside = dr.all((projection >= box.min) & (projection <= box.max))
    return mi.Point3f(dr.select(at_first | (along <= 0) | ~inside, first, projection))
