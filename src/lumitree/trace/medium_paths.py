"""Segments of paths in homogeneous media.

A medium that scatters ends a segment at a random distance, which is sampled for R, G or B: each
path has one of them, drawn when it starts. The other two could have given the same path, so its
weight is over the mean density of all three along the whole path (Wilkie et al. 2014, Hero
Wavelength Spectral Sampling). A medium that only absorbs attenuates a segment exactly and needs no
random number.

All functions take the mi.MediumPtr of each path, which may be none. In spectral variants they need
its wavelengths.

Symbols
    σ_s, σ_t    scattering and extinction, per scene unit
    T           transmittance of a segment: exp(-σ_t · length)
    ρ           mi.Spectrum, densities of the path so far, sampled for each channel, over their mean
"""

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.trace.spawning import spawn

# Surfaces that a ray crosses to the first border of a medium.
_MAX_CROSSINGS = 128


def coefficients(medium: Any, active: Any, wavelengths: Any = None) -> tuple[Any, Any]:
    """σ_s and σ_t (mi.Spectrum), 0 outside of media: any point of a homogeneous medium will do."""
    inside = active & (medium != None)  # noqa: E711 (a vector comparison)
    anywhere = dr.zeros(mi.MediumInteraction3f)
    if wavelengths is not None and mi.is_spectral:
        anywhere.wavelengths = wavelengths
    scattering, _, extinction = medium.get_scattering_coefficients(anywhere, inside)
    return mi.Spectrum(scattering), mi.Spectrum(extinction)


def draw_channel(sampler: Any) -> Any:
    """Index (mi.UInt32) of the channel for which a path is sampled."""
    channels = dr.size_v(mi.Spectrum)
    return mi.UInt32(dr.minimum(channels * sampler.next_1d(), channels - 1))


def free_flight(
    medium: Any, channel: Any, sampler: Any, active: Any, wavelengths: Any = None
) -> Any:
    """Distance (mi.Float) to the next scattering in a medium; infinite where nothing scatters."""
    scattering, extinction = coefficients(medium, active, wavelengths)
    scatters = active & (dr.max(scattering) > 0)
    *others, rate = extinction
    for index in reversed(range(len(others))):
        rate = dr.select(channel == index, others[index], rate)
    distance = -dr.log(1 - sampler.next_1d(scatters)) * dr.rcp(rate)
    return dr.select(scatters & (rate > 0), distance, dr.inf)


def segment_weight(
    medium: Any, distance: Any, ρ: Any, active: Any, wavelengths: Any = None
) -> tuple[Any, Any]:
    """A segment that ends before the `free_flight`.

    Returns:
        Its weight (mi.Spectrum), T over the chance of that; and ρ after it.
    """
    scattering, extinction = coefficients(medium, active, wavelengths)
    through = _transmittance(extinction, distance)
    return _weighted(through, dr.select(dr.max(scattering) > 0, through, 1), ρ)


def scattering_weight(
    medium: Any, distance: Any, ρ: Any, active: Any, wavelengths: Any = None
) -> tuple[Any, Any]:
    """A segment that ends by scattering, as `segment_weight`: σ_s T over its density."""
    scattering, extinction = coefficients(medium, active, wavelengths)
    through = _transmittance(extinction, distance)
    return _weighted(scattering * through, extinction * through, ρ)


def traverse(
    medium: Any, distance: Any, channel: Any, ρ: Any, sampler: Any, active: Any
) -> tuple[Any, Any, Any, Any]:
    """The segment of a path to the next surface, or to where the medium scatters before it.

    Args:
        distance: mi.Float, to the surface.

    Returns:
        Where the medium scatters (mi.Bool); the free flight; the segment's weight (mi.Color3f); and
        ρ after it.
    """
    flight = free_flight(medium, channel, sampler, active)
    collides = active & (flight < distance)
    through, behind = segment_weight(medium, distance, ρ, active & ~collides)
    scattered, after = scattering_weight(medium, flight, ρ, collides)
    weight = dr.select(collides, scattered, dr.select(active, through, 1))
    return collides, flight, weight, dr.select(collides, after, dr.select(active, behind, ρ))


def transmittance(medium: Any, distance: Any, active: Any, wavelengths: Any = None) -> Any:
    """T (mi.Spectrum) of a segment."""
    return _transmittance(coefficients(medium, active, wavelengths)[1], distance)


def medium_after(si: Any, direction: Any, medium: Any, active: Any) -> Any:
    """Medium of a ray that leaves a surface in a direction; `medium` is that before it."""
    return dr.select(active & si.is_medium_transition(), si.target_medium(direction), medium)


@dr.syntax
def medium_around(
    scene: Any,
    ray: Any,
    extent: Any,
    is_border: Callable[[Any, Any], Any] = lambda hit, active: hit.is_medium_transition(),
) -> Any:
    """mi.MediumPtr where rays start: the medium on this side of the first border on their way.

    Args:
        scene: mi.Scene.
        ray: mi.Ray3f.
        extent: `scene_extent` of it.
        is_border: function of a hit and a mask. Default: borders are where media change.
    """
    ray, active = mi.Ray3f(ray), dr.full(mi.Bool, True, dr.width(ray))
    medium, crossings = dr.zeros(mi.MediumPtr, dr.width(ray)), mi.UInt32(0)
    while active:
        hit = scene.ray_intersect(ray, active)
        active &= hit.is_valid()
        border = active & is_border(hit, active)
        medium[border] = hit.target_medium(-ray.d)
        crossings += 1
        active &= ~border & (crossings < _MAX_CROSSINGS)
        ray[active] = spawn(hit, ray.d, extent)
    return medium


def scattering_point(ray: Any, distance: Any) -> Any:
    """Place on a ray where a medium scatters, as a mi.SurfaceInteraction3f without a surface.

    Its normals are 0, so that rays leave it from where it is.
    """
    point = dr.zeros(mi.SurfaceInteraction3f)
    point.t, point.p = distance, ray(distance)
    point.time, point.wavelengths = ray.time, ray.wavelengths
    return point


def eval_phase(medium: Any, ray: Any, wo: Any, active: Any) -> tuple[Any, Any]:
    """Value (mi.Spectrum) and density of the phase function for a ray that arrives.

    Args:
        ray: mi.Ray3f.
        wo: mi.Vector3f, direction in the scene.
    """
    context = mi.PhaseFunctionContext(None)
    value, pdf = medium.phase_function().eval_pdf(context, _scattering(ray), wo, active)
    return mi.Spectrum(value), pdf


def sample_phase(medium: Any, ray: Any, sampler: Any, active: Any) -> tuple[Any, Any, Any]:
    """A direction in which a ray (mi.Ray3f) that arrives scatters, its weight and density."""
    context = mi.PhaseFunctionContext(sampler)
    sample = sampler.next_1d(active), sampler.next_2d(active)
    return medium.phase_function().sample(context, _scattering(ray), *sample, active)


def _scattering(ray: Any) -> Any:
    here = dr.zeros(mi.MediumInteraction3f)
    here.wi = -ray.d
    here.sh_frame = mi.Frame3f(here.wi)
    return here


def _weighted(value: Any, density: Any, ρ: Any) -> tuple[Any, Any]:
    """A value over the mean density of the channels, and the new ρ."""
    densities = ρ * density
    mean = dr.mean(densities)
    inverse = dr.select(mean > 0, dr.rcp(mean), 0)
    return value * inverse, densities * inverse


def _transmittance(extinction: Any, distance: Any) -> Any:
    # A ray that meets nothing is infinite, and 0 · ∞ is not a number.
    return mi.Spectrum(dr.select(extinction > 0, dr.exp(-extinction * distance), 1))
