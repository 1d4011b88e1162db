"""A set of sources, each with a radiant intensity by direction.

Symbols
    S   sources
    I   radiant intensity of a source, local units; the sum over sources of its integral over the
        sphere is the flux
    R   octahedral bins of direction a side (`lumitree.core.octahedral`)
"""

from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.places import Disk, Places
from benchmarks.baselines.traced_rays import TracedRays
from lumitree.core.device import on_device
from lumitree.core.harmonics import basis, basis_array, num_coefficients
from lumitree.core.octahedral import bin_of, direction_in_bin, own_solid_angles, solid_angles
from lumitree.rendering.sampling.proxy import cone_pdf, sample_cone
from lumitree.trace.emitted_rays import EmittedRays, RayBatch, seeded_sampler


class Representation(EmittedRays, Protocol):
    """What is compared."""

    num_bytes: int

    def sample_direction(self, x: Any, sampler: Any) -> tuple[Any, Any] | None:
        """A direction in which a receiver gets light; None where there is no such method.

        Args:
            x: mi.Point3f, outside the bounding box.

        Returns:
            mi.Vector3f, unit direction from x; mi.Color3f, whose product with the cosine at the
            receiver has the irradiance as its mean.
        """
        ...

    def eval(self, origin: Any, direction: Any) -> Any | None:
        """Radiance (mi.Color3f) that arrives along a line; None where no line sees it.

        Args:
            origin: mi.Point3f, where it arrives, outside the bounding box.
            direction: mi.Vector3f, unit direction of flight.
        """
        ...


class Tabulated:
    """Intensities by octahedral bins [S, R², 3].

    Bytes are those of a sparse table: a bit for each bin and 4 bytes for each that emits.

    Attributes:
        intensity, flux: of the bins, and of each source [S], all channels together.
    """

    def __init__(self, intensity: NDArray[np.floating]) -> None:
        self.intensity = intensity
        self.resolution = int(np.sqrt(intensity.shape[1]))
        lit = intensity.any(axis=2)
        self.num_bytes = 4 * int(lit.sum()) + lit.size // 8
        angles = own_solid_angles(self.resolution)
        self.flux = (intensity * angles[:, None]).sum(axis=(1, 2))
        bins = (intensity.sum(axis=2) * angles).ravel().astype(np.float32)
        self._chosen = mi.DiscreteDistribution(on_device(mi.Float, bins))
        self._values = on_device(mi.Float, intensity.astype(np.float32).ravel())

    def eval(self, index: Any, direction: Any) -> Any:
        """I (mi.Color3f) of sources (mi.UInt32) in unit directions."""
        row = index * self.resolution**2 + bin_of(direction, self.resolution)
        return dr.gather(mi.Color3f, self._values, row)

    def sample(self, sample1: Any, sample2: Any) -> tuple[Any, Any, Any]:
        """A source, a unit direction, and the density of both."""
        row, _, chance = self._chosen.sample_reuse_pmf(sample1)
        bins = self.resolution**2
        direction, density = direction_in_bin(row % bins, sample2, self.resolution)
        return row // bins, direction, chance * density


class Harmonics:
    """Intensities by real spherical harmonics [S, 3, K] on the outer side of surfaces.

    Negative values and those of directions into the surface are cut off. What remains is scaled to
    the flux of band 0, of each source and channel. Bytes are those of half-precision coefficients.

    Args:
        normals: [S, 3], outward; each is an axis, or its opposite.
    """

    def __init__(
        self, coefficients: NDArray[np.floating], l_max: int, normals: NDArray[np.floating]
    ) -> None:
        self._l_max = l_max
        self.num_bytes = 2 * coefficients.size
        flux = coefficients[:, :, 0] * np.sqrt(4 * np.pi)
        self.flux = flux.sum(axis=1)
        remaining = _flux_above_zero(coefficients, l_max, normals)
        scale = np.divide(flux, remaining, out=np.zeros_like(flux), where=remaining > 0)
        coefficients = coefficients * scale[..., None]
        self._chosen = mi.DiscreteDistribution(on_device(mi.Float, self.flux.astype(np.float32)))
        self._values = on_device(mi.Float, coefficients.astype(np.float32).ravel())
        self._normals = on_device(mi.Float, normals.astype(np.float32).ravel())

    def eval(self, index: Any, direction: Any) -> Any:
        """As `Tabulated.eval`."""
        outward = dr.dot(dr.gather(mi.Vector3f, self._normals, index), direction) > 0
        y = basis(*direction, l_max=self._l_max)
        first = index * (3 * len(y))
        channels = []
        for channel in range(3):
            value = mi.Float(0)
            for k, each in enumerate(y):
                place = first + (channel * len(y) + k)
                value = dr.fma(dr.gather(mi.Float, self._values, place), each, value)
            channels.append(dr.select(outward, dr.maximum(value, 0), 0))
        return mi.Color3f(*channels)

    def sample(self, sample1: Any, sample2: Any) -> tuple[Any, Any, Any]:
        """As `Tabulated.sample`; directions are uniform."""
        index, _, chance = self._chosen.sample_reuse_pmf(sample1)
        return index, mi.warp.square_to_uniform_sphere(sample2), chance * dr.inv_four_pi


class Sources:
    """A representation made of sources."""

    def __init__(self, places: Places, intensity: Tabulated | Harmonics) -> None:
        self._places, self._intensity = places, intensity
        self._chosen = mi.DiscreteDistribution(
            on_device(mi.Float, intensity.flux.astype(np.float32))
        )
        self.num_bytes = places.num_bytes + intensity.num_bytes

    def draw(self, count: int, seed: int) -> RayBatch:
        """As `EmittedRays.draw`."""
        sampler = seeded_sampler(seed, count)
        index, direction, density = self._intensity.sample(sampler.next_1d(), sampler.next_2d())
        point = self._places.point(index, direction, sampler.next_1d(), sampler.next_2d())
        # A sum of many probabilities is rounded, so that one of 0 can be chosen.
        possible = density > 0
        weight = dr.select(possible, dr.rcp(dr.select(possible, density, 1) * count), 0)
        flux = self._intensity.eval(index, direction) * weight
        dr.eval(point, direction, flux)
        return RayBatch(point, direction, flux)

    def sample_direction(self, x: Any, sampler: Any) -> tuple[Any, Any]:
        index, _, chance = self._chosen.sample_reuse_pmf(sampler.next_1d())
        towards = dr.normalize(mi.Vector3f(x))
        point = self._places.point(index, towards, sampler.next_1d(), sampler.next_2d())
        offset = mi.Vector3f(x - point)
        distance = dr.norm(offset)
        direction = offset / distance
        value = self._intensity.eval(index, direction) / (chance * dr.square(distance))
        return -direction, value

    def eval(self, origin: Any, direction: Any) -> Any | None:
        seen = self._places.seen(origin, direction)
        if seen is None:
            return None
        index, area, hit = seen
        return dr.select(hit, self._intensity.eval(index, direction) / area, 0)


class SphereSource(Sources):
    """One source: a sphere about the centre, of equal radiance for all rays of one direction."""

    def __init__(self, radius: float, intensity: Tabulated) -> None:
        super().__init__(Disk(radius), intensity)
        self._radius = radius

    def sample_direction(self, x: Any, sampler: Any) -> tuple[Any, Any]:
        direction = sample_cone(x, self._radius, sampler.next_2d())
        radiance = self._intensity.eval(mi.UInt32(0), -direction) / (np.pi * self._radius**2)
        return direction, radiance / cone_pdf(x, self._radius)


def tabulated(
    rays: TracedRays, index: NDArray[np.integer], count: int, resolution: int
) -> Tabulated:
    """Intensities that are even in octahedral bins, of rays by source; see `histogram`."""
    flux = histogram(rays, index, count, resolution)
    return Tabulated(flux / own_solid_angles(resolution)[:, None])


def histogram(
    rays: TracedRays, index: NDArray[np.integer], count: int, resolution: int
) -> NDArray[np.float64]:
    """Flux [S, R², 3] of rays by source (index [N], `count` sources) and octahedral bin."""
    bins = np.array(bin_of(on_device(mi.Vector3f, rays.direction), resolution)).astype(np.int64)
    row = index * resolution**2 + bins
    size = count * resolution**2
    flux = np.empty((size, 3))
    for channel, each in enumerate(rays.flux.T):
        flux[:, channel] = np.bincount(row, each, size)
    return flux.reshape(count, -1, 3)


def _flux_above_zero(
    coefficients: NDArray[np.floating],
    l_max: int,
    normals: NDArray[np.floating],
    resolution: int = 32,
) -> NDArray[np.float64]:
    """Integral [S, 3] of the positive part of expansions [S, 3, K] over outward directions."""
    bins = mi.UInt32(np.arange(resolution**2, dtype=np.uint32))
    directions = np.array(direction_in_bin(bins, mi.Point2f(0.5), resolution)[0], np.float64).T
    y, angles = basis_array(directions, l_max), solid_angles(resolution)
    integral = np.empty(coefficients.shape[:2])
    # One source after the other: all of them at once would take gigabytes.
    for source, (each, normal) in enumerate(zip(coefficients, normals, strict=True)):
        integral[source] = np.maximum(each @ y.T, 0) @ np.where(directions @ normal > 0, angles, 0)
    return integral


def projected(
    rays: TracedRays, index: NDArray[np.integer], l_max: int, normals: NDArray[np.floating]
) -> Harmonics:
    """Projection of rays on spherical harmonics by source (index [N], outward normals [S, 3])."""
    y = basis_array(rays.direction, l_max)
    coefficients = np.empty((len(normals), 3, num_coefficients(l_max)))
    for channel in range(3):
        for k in range(y.shape[1]):
            weight = rays.flux[:, channel] * y[:, k]
            coefficients[:, channel, k] = np.bincount(index, weight, len(normals))
    return Harmonics(coefficients, l_max, normals)
