"""Measurement of the light that leaves a luminaire or an asset, by rays.

Rays come in independent batches of equal size. A figure of all rays has a standard error by the
jackknife: from its values with one batch left out.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, Literal

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.frames import LocalFrame, similarity
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError
from lumitree.goniophotometry.near_field import NearFieldTest
from lumitree.goniophotometry.rays import Rays
from lumitree.goniophotometry.type_c import Grid, y_up
from lumitree.luminaire.luminaire import Luminaire
from lumitree.model.photometry import luminance
from lumitree.octree.field import shared_field
from lumitree.rendering.divided_sampling import emitter_sampler
from lumitree.rendering.proxy import BoxProxy
from lumitree.transport.light_paths import emitted_flux, trace_light
from lumitree.transport.tracing import PATH_DEPTH, check_finite

Up = Literal["y", "z"]
BATCHES = 16
# Steps that are tried, degrees, finest first; the first whose noise is low enough is taken.
STEPS = (1.0, 2.5, 5.0, 10.0)
MAX_NOISE = 0.02
# A coarse step at which the direction of the largest intensity is found before the measurement.
_COARSE_STEP = 10.0


@dataclasses.dataclass(frozen=True)
class Source:
    """What is measured.

    Attributes:
        name: of the luminaire.
        frame: its local frame; the world has y up, and lengths in metres.
        rays: function that takes a sampler and a count, and returns the rays of as many samples:
            origin, direction of travel, flux [3]; local units. The sum of the flux is an estimate
            of the flux that leaves the luminaire.
        emitted: as `rays`, but returns the flux [3, N] of the bare emitters; None if it is not
            known.
    """

    name: str
    frame: LocalFrame
    rays: Callable[[Any, int], tuple[Any, Any, Any]]
    emitted: Callable[[Any, int], NDArray[np.float64]] | None


def oriented(source: Source, unit: float, up: Up) -> Source:
    """The source with lengths in metres and y up.

    Args:
        unit: metres in a unit of length of the luminaire's file.
        up: upward axis of that file.
    """
    turn = y_up(np.eye(3)).T if up == "z" else np.eye(3)
    frame = source.frame
    matrix = similarity(turn, unit) @ frame.world_from_local
    return dataclasses.replace(source, frame=LocalFrame(frame.half_extents, matrix))


def luminaire_source(luminaire: Luminaire) -> Source:
    """Light paths of a luminaire."""

    def rays(sampler: Any, count: int) -> tuple[Any, Any, Any]:
        paths = trace_light(luminaire, sampler, count, PATH_DEPTH, all_light=True)
        check_finite(luminaire, _array(paths.flux))
        # Paths have the direction of the camera ray that meets them.
        return paths.origin, -paths.direction, paths.flux

    def emitted(sampler: Any, count: int) -> NDArray[np.float64]:
        return _array(emitted_flux(luminaire, sampler, count)).sum(axis=0)

    return Source(luminaire.name, luminaire.frame, rays, emitted)


def asset_source(asset: Asset) -> Source:
    """Rays sampled from the emission of an asset: of its exitant light field if it has one."""
    emitter = emitter_sampler(asset, shared_field(asset), BoxProxy(asset.frame.half_extents))

    def rays(sampler: Any, count: int) -> tuple[Any, Any, Any]:
        samples = sampler.next_1d(), sampler.next_2d(), sampler.next_2d()
        origin, direction, flux = emitter.sample_ray(*samples)
        flux /= count
        dr.eval(origin, direction, flux)
        return origin, direction, flux

    return Source(asset.luminaire, asset.frame, rays, None)


@dataclasses.dataclass(frozen=True, eq=False)
class Measurement:
    """Estimates of each batch of rays.

    Attributes:
        name: of the luminaire.
        grid: of the intensities.
        intensity: [B, C, G] luminous intensity, cd.
        watts: [B, 3] radiant flux of R, G and B, W.
        upward: [B] luminous flux above the horizontal, lm.
        emitted: [B, 3] radiant flux of the bare emitters, W; None if it is not known.
        near_field: inverse-square test of these rays.
        size: [3] sides of the bounding box, m.
        num_rays: number of samples.
        rays: rays that were kept.
    """

    name: str
    grid: Grid
    intensity: NDArray[np.float64]
    watts: NDArray[np.float64]
    upward: NDArray[np.float64]
    emitted: NDArray[np.float64] | None
    near_field: NearFieldTest
    size: NDArray[np.float64]
    num_rays: int
    rays: Rays


def measure(
    source: Source, num_rays: int, *, step: float | None = None, kept_rays: int = 0, seed: int = 0
) -> Measurement:
    """Measure the light that leaves a luminaire.

    Args:
        num_rays: light paths, or rays of an asset; rounded up to a multiple of 16.
        step: of the angles, degrees; by default the finest of `STEPS` whose noise, the relative
            root mean square error of the intensity, is at most 2 %, as estimated from one batch.
        kept_rays: about how many samples to keep the rays of; their flux is that of all.
        seed: root seed.

    Raises:
        LumitreeError: no light leaves the luminaire, or a path's flux is NaN or infinite.
    """
    count = -(-num_rays // BATCHES)
    kept_batches = min(BATCHES, -(-kept_rays // count))
    grid = None if step is None else Grid(step)
    test: NearFieldTest | None = None
    intensity, watts, upward, kept = [], [], [], []
    with progress(f"light of {source.name}", BATCHES) as advance:
        for batch in _batches(source, count, seed):
            lumens = luminance(batch.flux)
            if grid is None or test is None:
                if not lumens.any():
                    raise _dark(source)
                grid = grid or Grid(chosen_step(batch.direction, lumens))
                brightest = _brightest(batch.direction, lumens)
                test = NearFieldTest(source.frame.size.max(), brightest)
            intensity.append(grid.intensity(batch.direction, lumens))
            watts.append(batch.flux.sum(axis=0))
            upward.append(lumens[batch.direction[:, 1] > 0].sum())
            test.add(batch.origin - source.frame.centre, batch.direction, lumens)
            if len(kept) < kept_batches:
                kept.append(batch)
            advance(1)
    assert grid is not None
    assert test is not None
    return Measurement(
        name=source.name,
        grid=grid,
        intensity=np.array(intensity),
        watts=np.array(watts),
        upward=np.array(upward),
        emitted=_emitted(source, count, seed),
        near_field=test,
        size=np.abs(source.frame.rotation) @ source.frame.size,
        num_rays=count * BATCHES,
        rays=Rays.joined(kept),
    )


def chosen_step(direction: NDArray[np.float64], lumens: NDArray[np.float64]) -> float:
    """Finest of `STEPS` whose noise is at most `MAX_NOISE`, for `BATCHES` batches such as this.

    Args:
        direction: [N, 3] directions of the rays of one batch.
        lumens: [N] luminous flux of each.
    """
    for step in STEPS:
        grid = Grid(step)
        variance = grid.variance(direction, lumens)
        # Of the squared intensity, the variance is a part that is not signal.
        square = np.maximum(grid.intensity(direction, lumens) ** 2 - variance, 0)
        weights = np.sin(np.deg2rad(grid.gamma))
        signal, noise = ((values * weights).sum() for values in (square, variance / BATCHES))
        if noise <= MAX_NOISE**2 * signal:
            return step
    return STEPS[-1]


def jackknife(
    figure: Callable[[NDArray[np.bool_]], NDArray[np.float64] | float], batches: int = BATCHES
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values of a figure for all batches, and their standard errors.

    Args:
        figure: takes a mask [B] of the batches to use.
    """
    value = np.asarray(figure(np.ones(batches, bool)), np.float64)
    without = np.array([figure(np.arange(batches) != left_out) for left_out in range(batches)])
    deviation = without - without.mean(axis=0)
    return value, np.sqrt((batches - 1) / batches * (deviation**2).sum(axis=0))


def _batches(source: Source, count: int, seed: int) -> Iterator[Rays]:
    """Rays of each batch, in the frame of the luminaire's file, with flux in W."""
    rotation, scale, centre = source.frame.rotation, source.frame.scale, source.frame.centre
    for step in range(BATCHES):
        origin, direction, flux = source.rays(_sampler(step, count, seed), count)
        yield Rays(
            _array(origin) @ rotation.T * scale + centre,
            _array(direction) @ rotation.T,
            _array(flux) * scale**2,
        )


def _emitted(source: Source, count: int, seed: int) -> NDArray[np.float64] | None:
    """Flux [B, 3], W, of the bare emitters, for the light paths of `_batches`."""
    if source.emitted is None:
        return None
    batches = [source.emitted(_sampler(step, count, seed), count) for step in range(BATCHES)]
    return np.array(batches) * source.frame.scale**2


def _sampler(step: int, count: int, seed: int) -> Any:
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(SeedStream(Purpose.PHOTOMETRY, step).seed(seed), count)
    return sampler


def _brightest(direction: NDArray[np.float64], lumens: NDArray[np.float64]) -> tuple[float, float]:
    """Angles C and γ of the largest intensity on a coarse grid."""
    grid = Grid(_COARSE_STEP)
    intensity = grid.intensity(direction, lumens)
    plane, row = np.unravel_index(intensity.argmax(), intensity.shape)
    return float(grid.c[plane]), float(grid.gamma[row])


def _array(vectors: Any) -> NDArray[np.float64]:
    """Dr.Jit vectors as an array [N, 3]."""
    return np.array(vectors, np.float64).reshape(3, -1).T


def _dark(source: Source) -> LumitreeError:
    return LumitreeError(
        f"no light leaves {source.name}; look for emitters that are enclosed or black"
    )
