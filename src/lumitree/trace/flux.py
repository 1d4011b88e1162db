"""The light that leaves a luminaire, integrated over all positions and directions by tracing."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.photometry import luminance
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.lamp.luminaire import Luminaire
from lumitree.trace.light_paths import trace_light
from lumitree.trace.tracing import PATH_DEPTH, check_finite, path_integrator

# Paths traced at once.
_BATCH = 1 << 20
# Russian roulette that never begins.
_NO_ROULETTE = {"rr_depth": 1 << 20}


@dataclasses.dataclass(frozen=True)
class Flux:
    """Flux with one standard error, for lengths in metres and radiance in W/(m² sr).

    Attributes:
        watts, watts_error: [3] for R, G and B, W.
        lumens, lumens_error: lm.
        num_paths: that the estimate is the mean of.
    """

    watts: NDArray[np.float64]
    watts_error: NDArray[np.float64]
    lumens: float
    lumens_error: float
    num_paths: int


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
    sampler = mi.load_dict({"type": "independent"})
    moments = _Moments(4)
    for batch_seed in _batch_seeds(num_paths, Purpose.FLUX, seed):
        sampler.seed(batch_seed, _BATCH)
        paths = trace_light(luminaire, sampler, _BATCH, path_depth, all_light=True)
        flux = np.array(paths.flux, np.float64).reshape(3, -1).T
        check_finite(luminaire, flux)
        moments.add(np.column_stack([flux, luminance(flux)]), _BATCH)
    # Flux of the paths of a batch adds up to an estimate, in local units.
    return _flux(moments, _BATCH * luminaire.frame.scale**2)


def flux_along_lines(
    luminaire: Luminaire, num_paths: int, *, path_depth: int = PATH_DEPTH, seed: int = 0
) -> Flux:
    """The same from camera paths along lines that are uniform in position and direction.

    It is noisier, and too large by up to 6 % for small lamps of glass, see `trace.spawning`.
    Arguments and errors as `estimate_flux`, from which it is independent.
    """
    integrator = path_integrator(luminaire, path_depth)
    moments = _Moments(4)
    for batch_seed in _batch_seeds(num_paths, Purpose.LINES, seed):
        radiance = _trace(luminaire, integrator, batch_seed)
        moments.add(np.column_stack([radiance, luminance(radiance)]), _BATCH)
    return _flux(moments, _measure(luminaire))


def _flux(moments: "_Moments", factor: float) -> Flux:
    """Flux as the mean of a path's value times a factor."""
    mean, error = (factor * value for value in moments.mean_and_error())
    return Flux(mean[:3], error[:3], float(mean[3]), float(error[3]), moments.count)


@dataclasses.dataclass(frozen=True)
class Missed:
    """Share of the luminous flux that paths of at most `path_depth` bounces miss, one std. error.

    The reference has Russian roulette switched off and `reference_depth` bounces.
    """

    path_depth: int
    reference_depth: int
    share: float
    error: float


def missed_by_depth(
    luminaire: Luminaire,
    num_paths: int,
    path_depths: Sequence[int] = (32, 64, 128),
    reference_depth: int = 256,
    seed: int = 0,
) -> list[Missed]:
    """What the luminaire's longer paths carry: the light that is lost by cutting paths short.

    The same random numbers draw the short and the long paths, which agree up to the cut, so that
    the difference has little noise.

    Args:
        num_paths: rounded up to whole batches of 2**20.
        path_depths: bounces, below `reference_depth`.
    """
    depths = (reference_depth, *path_depths)
    integrators = [path_integrator(luminaire, depth, **_NO_ROULETTE) for depth in depths]
    moments = _Moments(len(depths))
    for batch_seed in _batch_seeds(num_paths, Purpose.LONG_PATHS, seed):
        flux = [luminance(_trace(luminaire, each, batch_seed)) for each in integrators]
        values = np.column_stack([flux[0], *(flux[0] - short for short in flux[1:])])
        moments.add(values, _BATCH)
    mean, error = moments.mean_and_error()
    total = mean[0] if mean[0] > 0 else np.inf
    return [
        Missed(depth, reference_depth, float(missed / total), float(noise / total))
        for depth, missed, noise in zip(path_depths, mean[1:], error[1:], strict=True)
    ]


class _Moments:
    """Sums and sums of squares of the columns of batches, in double precision."""

    def __init__(self, columns: int) -> None:
        self.count = 0
        self._sum, self._squares = np.zeros(columns), np.zeros(columns)

    def add(self, values: NDArray[np.float64], count: int) -> None:
        """Add the rows of a batch of `count` paths; those without a row have the value 0."""
        self.count += count
        self._sum += values.sum(axis=0)
        self._squares += (values**2).sum(axis=0)

    def mean_and_error(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and its standard error."""
        mean = self._sum / self.count
        variance = np.maximum(self._squares / self.count - mean**2, 0)
        return mean, np.sqrt(variance / (self.count - 1))


def _batch_seeds(num_paths: int, purpose: Purpose, seed: int) -> list[int]:
    return [SeedStream(purpose, batch).seed(seed) for batch in range(-(-num_paths // _BATCH))]


def _measure(luminaire: Luminaire) -> float:
    """Measure of all lines through the bounding sphere: 4π sr times its cross section, unit²."""
    radius = luminaire.bounding_radius * luminaire.frame.scale
    return float(4 * np.pi * np.pi * radius**2)


def _trace(luminaire: Luminaire, integrator: Any, sampler_seed: int) -> NDArray[np.float64]:
    """Radiance [_BATCH, 3] along random lines through the bounding sphere, from outside."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(sampler_seed, _BATCH)
    frame = mi.Frame3f(mi.warp.square_to_uniform_sphere(sampler.next_2d()))
    disk = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
    radius = mi.Float(luminaire.bounding_radius * luminaire.frame.scale)
    centre = mi.Point3f(luminaire.scene_frame.centre)
    dr.make_opaque(radius, centre)
    # The bounding box may reach out of the sphere where shapes are not meshes.
    start = frame.to_world(mi.Vector3f(disk.x, disk.y, -2))
    ray = mi.RayDifferential3f(mi.Ray3f(centre + radius * start, frame.n))
    radiance, _, _ = integrator.sample(luminaire.scene, sampler, ray)
    values = np.array(radiance, np.float64).reshape(3, -1).T
    check_finite(luminaire, values)
    return values
