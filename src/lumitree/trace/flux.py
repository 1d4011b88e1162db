"""The light that leaves a luminaire, integrated over all positions and directions by tracing.

`estimate_flux` starts at the emitters. `flux_by_camera_paths` starts outside and finds emitters by
hitting them, so that it is wrong for other reasons: both are compared in every bake.
"""

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.photometry import luminance
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.lamp.luminaire import Luminaire
from lumitree.trace import medium_paths
from lumitree.trace.emitted_rays import as_rows, seeded_sampler
from lumitree.trace.flux_figures import Flux, MissedFlux
from lumitree.trace.lamp_rays import LampRays
from lumitree.trace.spawning import scene_extent, spawn
from lumitree.trace.tracing import PATH_DEPTH, check_finite, path_integrator

# Paths traced at once.
BATCH = 1 << 20
# Russian roulette that never begins.
_NO_ROULETTE = {"rr_depth": 1 << 20}
# Number of events after which Russian roulette of camera paths begins.
_ROULETTE_DEPTH = 8


def estimate_flux(
    luminaire: Luminaire, num_paths: int, *, path_depth: int = PATH_DEPTH, seed: int = 0
) -> Flux:
    """Flux that leaves a luminaire, from light paths.

    Args:
        num_paths: independent paths, rounded up to whole batches of 2**20.
        path_depth: longest path, bounces.
        seed: root seed; estimates with different seeds are independent.

    Raises:
        LumitreeError: a path's flux is NaN or infinite.
    """
    rays, moments = LampRays(luminaire, path_depth), Moments(4)
    for batch_seed in batch_seeds(num_paths, Purpose.FLUX, seed):
        flux = as_rows(rays.draw(BATCH, batch_seed).flux)
        moments.add(np.column_stack([flux, luminance(flux)]), BATCH)
    # Flux of the paths of a batch adds up to an estimate, in local units.
    return flux_of(moments, BATCH * luminaire.frame.scale**2)


def flux_by_camera_paths(
    luminaire: Luminaire, num_paths: int, *, path_depth: int = PATH_DEPTH, seed: int = 0
) -> Flux:
    """Flux that leaves a luminaire, from camera paths that sample BSDFs only, no emitters.

    Args:
        num_paths: paths along random lines through the bounding sphere, rounded up to whole
            batches of 2**20.
        path_depth: longest path, events.
        seed: root seed.

    Raises:
        LumitreeError: a path's radiance is NaN or infinite.
    """
    moments = Moments(4)
    for batch_seed in batch_seeds(num_paths, Purpose.LINES, seed):
        sampler = seeded_sampler(batch_seed, BATCH)
        ray = _random_ray(luminaire, sampler)
        radiance = as_rows(_camera_paths(luminaire.scene, ray, sampler, path_depth))
        check_finite(luminaire, radiance)
        moments.add(np.column_stack([radiance, luminance(radiance)]), BATCH)
    # All lines through the bounding sphere measure 4π sr times its cross section, unit².
    radius = luminaire.bounding_radius * luminaire.frame.scale
    return flux_of(moments, 4 * np.pi * np.pi * radius**2)


@dr.syntax
def _camera_paths(scene, ray, sampler, path_depth):
    """Radiance (mi.Color3f) that rays from outside find."""
    context, extent = mi.BSDFContext(), scene_extent(scene)
    β, radiance = mi.Color3f(1), mi.Color3f(0)
    medium = dr.zeros(mi.MediumPtr)
    channel, ρ = medium_paths.draw_channel(sampler), mi.Color3f(1)
    depth, active = mi.UInt32(0), mi.Bool(True)
    while active:
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        collides, free_flight, weight, ρ = medium_paths.traverse(
            medium, si.t, channel, ρ, sampler, active
        )
        β *= weight
        hits = active & ~collides
        radiance[hits] += β * si.emitter(scene, hits).eval(si, hits)

        scattered, weight, _ = medium_paths.sample_phase(medium, ray, sampler, collides)
        β[collides] *= weight
        sample, weight = si.bsdf().sample(
            context, si, sampler.next_1d(hits), sampler.next_2d(hits), hits
        )
        β[hits] *= weight
        towards = si.to_world(sample.wo)
        medium = medium_paths.medium_after(si, towards, medium, hits)
        onwards = spawn(si, towards, extent)
        ray = dr.select(collides, mi.Ray3f(ray(free_flight), scattered), onwards)
        depth += 1
        survival = dr.select(depth > _ROULETTE_DEPTH, dr.clip(dr.max(β), 0.05, 1), 1)
        active &= (depth < path_depth) & (dr.max(β) > 0) & (sampler.next_1d(active) < survival)
        β[active] /= survival
    return radiance


def flux_of(moments: "Moments", factor: float) -> Flux:
    """Flux as the mean of a path's value times a factor."""
    mean, error = ((factor * value).tolist() for value in moments.mean_and_error())
    return Flux(
        watts=tuple(mean[:3]),
        watts_error=tuple(error[:3]),
        lumens=mean[3],
        lumens_error=error[3],
        paths=moments.count,
        hits=moments.hits,
    )


def missed_by_depth(
    luminaire: Luminaire,
    num_paths: int,
    path_depths: Sequence[int] = (32, 64, 128),
    reference_depth: int = 256,
    seed: int = 0,
) -> list[MissedFlux]:
    """Flux of the luminaire's longer paths: the light that is lost by cutting paths short.

    The same random numbers draw the short and the long paths, which agree up to the cut, so that
    the difference has little noise.

    Args:
        num_paths: rounded up to whole batches of 2**20.
        path_depths: bounces, below `reference_depth`.
    """
    depths = (reference_depth, *path_depths)
    integrators = [path_integrator(luminaire, depth, **_NO_ROULETTE) for depth in depths]
    moments = Moments(len(depths))
    for batch_seed in batch_seeds(num_paths, Purpose.LONG_PATHS, seed):
        flux = [luminance(random_radiance(luminaire, each, batch_seed)) for each in integrators]
        values = np.column_stack([flux[0], *(flux[0] - short for short in flux[1:])])
        moments.add(values, BATCH)
    mean, error = moments.mean_and_error()
    total = mean[0] if mean[0] > 0 else np.inf
    return [
        MissedFlux(
            path_depth=depth,
            reference_depth=reference_depth,
            share=float(missed / total),
            error=float(noise / total),
        )
        for depth, missed, noise in zip(path_depths, mean[1:], error[1:], strict=True)
    ]


class Moments:
    """Sums and sums of squares of the columns of batches, in double precision."""

    def __init__(self, columns: int) -> None:
        self.count = self.hits = 0
        self._sum, self._squares = np.zeros(columns), np.zeros(columns)

    def add(self, values: NDArray[np.float64], count: int) -> None:
        """Add the rows of a batch of `count` paths; those without a row have the value 0."""
        self.count += count
        self.hits += int(np.count_nonzero(values.any(axis=1)))
        self._sum += values.sum(axis=0)
        self._squares += (values**2).sum(axis=0)

    def mean_and_error(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and its standard error."""
        mean = self._sum / self.count
        variance = np.maximum(self._squares / self.count - mean**2, 0)
        return mean, np.sqrt(variance / (self.count - 1))


def batch_seeds(num_paths: int, purpose: Purpose, seed: int) -> list[int]:
    """Seeds of as many batches as have `num_paths` paths; `seed` is the root seed."""
    return [SeedStream(purpose, batch).seed(seed) for batch in range(-(-num_paths // BATCH))]


def random_radiance(luminaire: Luminaire, integrator: Any, seed: int) -> NDArray[np.float64]:
    """Radiance [BATCH, 3] along random rays through the bounding sphere, from outside."""
    sampler = seeded_sampler(seed, BATCH)
    ray = mi.RayDifferential3f(_random_ray(luminaire, sampler))
    radiance, _, _ = integrator.sample(luminaire.scene, sampler, ray)
    values = as_rows(radiance)
    check_finite(luminaire, values)
    return values


def _random_ray(luminaire: Luminaire, sampler: Any) -> Any:
    """mi.Ray3f, uniform in position and direction, that enters the bounding sphere."""
    frame = mi.Frame3f(mi.warp.square_to_uniform_sphere(sampler.next_2d()))
    disk = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
    radius = mi.Float(luminaire.bounding_radius * luminaire.frame.scale)
    centre = mi.Point3f(luminaire.scene_frame.centre)
    dr.make_opaque(radius, centre)
    # The bounding box may reach out of the sphere where shapes are not meshes.
    start = frame.to_world(mi.Vector3f(disk.x, disk.y, -2))
    return mi.Ray3f(centre + radius * start, frame.n)
