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

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from lumitree.core.device import channel_mean
from lumitree.trace.spawning import spawn

# Surfaces that a ray crosses to the first border of a medium.
_MAX_CROSSINGS = 128


def coefficients(
    medium: mi.MediumPtr, active: mi.Bool, wavelengths: mi.Spectrum | None = None
) -> tuple[mi.Spectrum, mi.Spectrum]:
    """σ_s and σ_t, 0 outside of media: any point of a homogeneous medium will do."""
    inside = active & (medium != None)  # noqa: E711 (a vector comparison)
    anywhere = dr.zeros(mi.MediumInteraction3f)
    if wavelengths is not None and mi.is_spectral:
        anywhere.wavelengths = wavelengths
    scattering, _, extinction = medium.get_scattering_coefficients(anywhere, inside)
    return mi.Spectrum(scattering), mi.Spectrum(extinction)


def draw_channel(sampler: mi.Sampler) -> mi.UInt32:
    """Index of the channel for which a path is sampled."""
    channels = dr.size_v(mi.Spectrum)
    return mi.UInt32(dr.minimum(channels * sampler.next_1d(), channels - 1))


def free_flight(
    medium: mi.MediumPtr,
    channel: mi.UInt32,
    sampler: mi.Sampler,
    active: mi.Bool,
    wavelengths: mi.Spectrum | None = None,
) -> mi.Float:
    """Distance to the next scattering in a medium; infinite where nothing scatters."""
    scattering, extinction = coefficients(medium, active, wavelengths)
    scatters = active & (dr.max(scattering) > 0)
    *others, rate = extinction
    for index in reversed(range(len(others))):
        rate = dr.select(channel == index, others[index], rate)
    distance = -dr.log(1 - sampler.next_1d(scatters)) * dr.rcp(rate)
    return dr.select(scatters & (rate > 0), distance, dr.inf)


def segment_weight(
    medium: mi.MediumPtr,
    distance: mi.Float,
    ρ: mi.Spectrum,
    active: mi.Bool,
    wavelengths: mi.Spectrum | None = None,
) -> tuple[mi.Spectrum, mi.Spectrum]:
    """A segment that ends before the `free_flight`.

    Returns:
        Its weight, T over the probability that it ends there; and ρ after it.
    """
    scattering, extinction = coefficients(medium, active, wavelengths)
    through = _transmittance(extinction, distance)
    return _weighted(through, dr.select(dr.max(scattering) > 0, through, 1), ρ)


def scattering_weight(
    medium: mi.MediumPtr,
    distance: mi.Float,
    ρ: mi.Spectrum,
    active: mi.Bool,
    wavelengths: mi.Spectrum | None = None,
) -> tuple[mi.Spectrum, mi.Spectrum]:
    """A segment that ends by scattering, as `segment_weight`: σ_s T over its density."""
    scattering, extinction = coefficients(medium, active, wavelengths)
    through = _transmittance(extinction, distance)
    return _weighted(scattering * through, extinction * through, ρ)


def traverse(
    medium: mi.MediumPtr,
    distance: mi.Float,
    channel: mi.UInt32,
    ρ: mi.Spectrum,
    sampler: mi.Sampler,
    active: mi.Bool,
) -> tuple[mi.Bool, mi.Float, mi.Spectrum, mi.Spectrum]:
    """The segment of a path to the next surface, or to where the medium scatters before it.

    Args:
        distance: to the surface.

    Returns:
        Where the medium scatters; the free flight; the segment's weight; and ρ after it.
    """
    flight = free_flight(medium, channel, sampler, active)
    collides = active & (flight < distance)
    through, behind = segment_weight(medium, distance, ρ, active & ~collides)
    scattered, after = scattering_weight(medium, flight, ρ, collides)
    weight = dr.select(collides, scattered, dr.select(active, through, 1))
    return collides, flight, weight, dr.select(collides, after, dr.select(active, behind, ρ))


def transmittance(
    medium: mi.MediumPtr,
    distance: mi.Float,
    active: mi.Bool,
    wavelengths: mi.Spectrum | None = None,
) -> mi.Spectrum:
    """T of a segment."""
    return _transmittance(coefficients(medium, active, wavelengths)[1], distance)


def medium_after(
    si: mi.SurfaceInteraction3f, direction: mi.Vector3f, medium: mi.MediumPtr, active: mi.Bool
) -> mi.MediumPtr:
    """Medium of a ray that leaves a surface in a direction; before it, the medium is `medium`."""
    return dr.select(active & si.is_medium_transition(), si.target_medium(direction), medium)


@dr.syntax
def medium_around(scene, ray, extent, is_border=lambda hit, active: hit.is_medium_transition()):
    """mi.MediumPtr where rays start: the medium on this side of the first border on their way.

    Args:
        scene: mi.Scene.
        ray: mi.Ray3f.
        extent: `scene_extent` of the scene.
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


def scattering_point(ray: mi.Ray3f, distance: mi.Float) -> mi.SurfaceInteraction3f:
    """Place on a ray where a medium scatters, as an interaction without a surface.

    Its normals are 0, so that rays leave it from where it is.
    """
    point = dr.zeros(mi.SurfaceInteraction3f)
    point.t, point.p = distance, ray(distance)
    point.time, point.wavelengths = ray.time, ray.wavelengths
    return point


def eval_phase(
    medium: mi.MediumPtr, ray: mi.Ray3f, wo: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Spectrum, mi.Float]:
    """Value and density of the phase function for a ray that arrives.

    Args:
        wo: direction in the scene.
    """
    context = mi.PhaseFunctionContext(None)
    value, pdf = medium.phase_function().eval_pdf(context, _scattering(ray), wo, active)
    return mi.Spectrum(value), pdf


def sample_phase(
    medium: mi.MediumPtr, ray: mi.Ray3f, sampler: mi.Sampler, active: mi.Bool
) -> tuple[mi.Vector3f, mi.Spectrum, mi.Float]:
    """A direction in which a ray that arrives scatters, its weight and density."""
    context = mi.PhaseFunctionContext(sampler)
    sample = sampler.next_1d(active), sampler.next_2d(active)
    return medium.phase_function().sample(context, _scattering(ray), *sample, active)


def _scattering(ray: mi.Ray3f) -> mi.MediumInteraction3f:
    here = dr.zeros(mi.MediumInteraction3f)
    here.wi = -ray.d
    here.sh_frame = mi.Frame3f(here.wi)
    return here


def _weighted(
    value: mi.Spectrum, density: mi.Spectrum, ρ: mi.Spectrum
) -> tuple[mi.Spectrum, mi.Spectrum]:
    """A value over the mean density of the channels, and the new ρ."""
    densities = ρ * density
    mean = channel_mean(densities)
    inverse = dr.select(mean > 0, dr.rcp(mean), 0)
    return value * inverse, densities * inverse


def _transmittance(extinction: mi.Spectrum, distance: mi.Float) -> mi.Spectrum:
    # A ray that meets nothing is infinite, and 0 · ∞ is not a number.
    return mi.Spectrum(dr.select(extinction > 0, dr.exp(-extinction * distance), 1))
