"""The light that leaves a luminaire, integrated over all positions and directions by tracing.

`estimate_flux` starts at the emitters. `flux_by_camera_paths` starts outside and finds emitters by
hitting them, so that it is wrong for other reasons: both are compared in every bake.
`emitted_spectrum` weights the spectra of emitters by their flux, and `check_output` finds where
light is lost or created.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import EmittedSpectrum
from lumitree.core.photometry import (
    Flux,
    MissedFlux,
    luminance,
    matching_functions,
    sampled_spectrum,
)
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.lamp.importers.overrides import setting
from lumitree.lamp.luminaire import Luminaire
from lumitree.lamp.scene_shapes import SceneShape, shapes_of_scene
from lumitree.trace import medium_paths
from lumitree.trace.cameras import PATH_DEPTH, check_finite, path_integrator
from lumitree.trace.light_paths import LampRays, as_rows, emit, emitted_flux, seeded_sampler
from lumitree.trace.medium_paths import coefficients, medium_after
from lumitree.trace.spawning import scene_extent, spawn

# Paths traced at once.
BATCH = 1 << 18
# Russian roulette that never begins.
_NO_ROULETTE = {"rr_depth": 1 << 20}
# Number of events after which Russian roulette of camera paths begins.
_ROULETTE_DEPTH = 8
# Light paths that estimate the shares of the emitters, to about 0.2 %, always the same ones.
_SPECTRUM_PATHS = 1 << 18
# Part of the light of the emitters below which the luminaire is said to enclose them.
_ENCLOSED = 1e-3
# Standard errors by which the light that leaves must exceed the light of the emitters; and this
# part of it, for what shading normals add.
_CERTAIN, _CREATED = 3, 2e-3
_PATHS, _BARE_PATHS = 1 << 13, 1 << 18
# Shapes that a message names have at least this part of what the first has.
_COMPARABLE, _NAMED = 0.5, 3


def estimate_flux(
    luminaire: Luminaire, num_paths: int, *, path_depth: int = PATH_DEPTH, seed: int = 0
) -> Flux:
    """Flux that leaves a luminaire, from light paths.

    Args:
        num_paths: independent paths, rounded up to whole batches of 2**18.
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
            batches of 2**18.
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


def flux_of(moments: Moments, factor: float) -> Flux:
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
        num_paths: rounded up to whole batches of 2**18.
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


def _random_ray(luminaire: Luminaire, sampler: mi.Sampler) -> mi.Ray3f:
    """mi.Ray3f, uniform in position and direction, that enters the bounding sphere."""
    frame = mi.Frame3f(mi.warp.square_to_uniform_sphere(sampler.next_2d()))
    disk = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
    radius = mi.Float(luminaire.bounding_radius * luminaire.frame.scale)
    centre = mi.Point3f(luminaire.scene_frame.centre)
    dr.make_opaque(radius, centre)
    # The bounding box may reach out of the sphere where shapes are not meshes.
    start = frame.to_world(mi.Vector3f(disk.x, disk.y, -2))
    return mi.Ray3f(centre + radius * start, frame.n)


def emitted_spectrum(luminaire: Luminaire) -> EmittedSpectrum | None:
    """The spectra of a luminaire's emitters, weighted by their luminous flux.

    Returns:
        The spectrum; None if no emitter has one, as in a `mi.Scene` and in models.

    Raises:
        LumitreeError: a spectrum has negative values, or wavelengths that do not increase.
    """
    known = {} if luminaire.file is None else luminaire.file.spectra
    samples = [known.get(emitter.id()) for emitter in luminaire.scene.emitters()]
    if not any(samples):
        return None
    lumens = np.ones(1)
    if len(samples) > 1:
        sampler = seeded_sampler(SeedStream(Purpose.SPECTRUM).seed(0), _SPECTRUM_PATHS)
        flux, emitter = emitted_flux(luminaire, sampler, _SPECTRUM_PATHS)
        lumens = np.bincount(np.array(emitter), luminance(as_rows(flux)), len(samples))
    luminosity = matching_functions()[1]
    power, lumens_known = np.zeros(len(luminosity)), 0.0
    for each, flux in zip(samples, lumens.tolist(), strict=True):
        spectrum = np.zeros(len(luminosity)) if each is None else sampled_spectrum(*each)
        if (visible := spectrum @ luminosity) > 0:
            power += flux / visible * spectrum
            lumens_known += flux
    return EmittedSpectrum.of(power, min(lumens_known / max(float(lumens.sum()), 1e-300), 1.0))


def check_output(luminaire: Luminaire, lumens: NDArray[np.float64], seed: int) -> None:
    """Refuse a luminaire that no light leaves; warn of one that encloses or creates light.

    Args:
        lumens: [B] independent estimates of the luminous flux that leaves it, local units.
        seed: root seed.

    Raises:
        LumitreeError: all are 0; the message names what encloses the emitters.
    """
    sampler = seeded_sampler(SeedStream(Purpose.FLUX, draw=1).seed(seed), _BARE_PATHS)
    bare = luminance(as_rows(emitted_flux(luminaire, sampler, _BARE_PATHS)[0])) * _BARE_PATHS
    emitted, leaving = bare.mean(), lumens.mean()
    if emitted == 0:
        raise LumitreeError(f"no light leaves {luminaire.name}; its emitters are black")
    share = leaving / emitted
    if share < _ENCLOSED:
        how_much = f"only {100 * share:.2g} % of the" if leaving > 0 else "no"
        message = f"{how_much} light leaves {luminaire.name}: {_enclosing(luminaire, seed)}"
        if leaving == 0:
            raise LumitreeError(message)
        warnings.warn(message, LumitreeWarning, stacklevel=3)
    # One batch has no error.
    spread = lumens.std(ddof=1) if len(lumens) > 1 else np.inf
    noise = spread / len(lumens) ** 0.5 / emitted, share * bare.std() / len(bare) ** 0.5 / emitted
    error = float(np.hypot(*noise))
    if share - 1 > max(_CERTAIN * error, _CREATED):
        names = _described(_largest(luminaire, -lost_light(luminaire, seed)))
        warnings.warn(
            f"{100 * share:.4g} ± {100 * error:.2g} % of the light of the emitters leaves "
            f"{luminaire.name}: the material of {names} creates light; its reflectance and "
            "transmittance exceed 1",
            LumitreeWarning,
            stacklevel=3,
        )


def lost_light(luminaire: Luminaire, seed: int) -> NDArray[np.float64]:
    """Part of the emitted luminous flux that is lost at each shape of a luminaire's scene.

    From a few thousand light paths. Light that a medium absorbs is lost at the shape where the
    segment ends. Less than 0 where a material creates light.
    """
    scene, context = luminaire.scene, mi.BSDFContext(mi.TransportMode.Importance)
    sampler = seeded_sampler(SeedStream(Purpose.FLUX, draw=2).seed(seed), _PATHS)
    ids = np.array(dr.reinterpret_array(mi.UInt32, scene.shapes_dr()))
    lost = dr.zeros(mi.Float, int(ids.max()) + 1)
    extent = scene_extent(scene)
    ray, flux, _ = emit(luminaire.emitting_surfaces, sampler, extent)
    total = dr.sum(mi.luminance(flux))
    medium, active = dr.zeros(mi.MediumPtr), mi.Bool(True)
    for depth in range(PATH_DEPTH):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid() & (dr.max(flux) > 0)
        if not dr.any(active):
            break
        sample, weight = si.bsdf().sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        scattering, extinction = coefficients(medium, active)
        left = flux * weight * dr.exp(-(extinction - scattering) * dr.select(active, si.t, 0))
        left = dr.select(depth < PATH_DEPTH - 1, left, 0)
        shape = dr.select(si.instance != None, si.instance, si.shape)  # noqa: E711
        index = dr.reinterpret_array(mi.UInt32, shape)
        dr.scatter_add(lost, mi.luminance(flux - left), index, active)
        towards = si.to_world(sample.wo)
        medium = medium_after(si, towards, medium, active)
        ray, flux = spawn(si, towards, extent), mi.Color3f(left)
        dr.eval(ray, flux, medium, active, lost)
    return np.array(lost, np.float64)[ids] / float(total[0])


def _enclosing(luminaire: Luminaire, seed: int) -> str:
    """The shapes that enclose the emitters, and the way to mend it."""
    lost = lost_light(luminaire, seed)
    emits = np.array([shape.is_emitter() for shape in luminaire.scene.shapes()])
    if (lost[~emits] > 0).any():
        # The surfaces of emitters are often black, and get light back from what encloses them.
        lost = np.where(emits, 0.0, lost)
    shapes = _largest(luminaire, lost)
    names = _described(shapes)
    if shapes[0].number is not None or not shapes[0].materials:
        return f"it ends on {names}; leave an opening, or give it a BSDF that transmits light"
    toml, line = Path(luminaire.name).name, setting(shapes[0].materials[0], "glass = {}")
    return (
        f"it ends on {names}; if this is glass, which Blender writes into OBJ files as opaque "
        f"(d 1), put first into {shown(toml, 100)}.toml: {line}"
    )


def _largest(luminaire: Luminaire, parts: NDArray[np.float64]) -> list[SceneShape]:
    """The shapes with the largest parts."""
    shapes = shapes_of_scene(luminaire.scene, luminaire.shapes)
    order = np.argsort(-parts, kind="stable")[:_NAMED]
    return [shapes[at] for at in order if parts[at] >= _COMPARABLE * parts[order[0]]]


def _described(shapes: list[SceneShape]) -> str:
    """Names of shapes with their materials, for messages."""
    names = []
    for shape in shapes:
        material = [shown(repr(each), 60) for each in shape.materials[:1]]
        names.append(f"{shape.label} ({' '.join([shape.bsdf, *material]) or 'no BSDF'})")
    return " and ".join(names)
