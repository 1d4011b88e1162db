"""Data of a bake: batches of rays with their radiance and transmittance.

Rays are uniform in dA cos(theta) domega, the measure in which flux is the integral of radiance.
The loss of a field is an integral over rays that has the radiance to be learned in first power
only. So the radiance may come in two parts that are summed apart: a ray is followed through smooth
transmission and finds the emitters there; all other light is brought by light paths, which end
outside the luminaire on other rays, with far less noise.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Callable
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import channel_mean, concatenate, parameter
from lumitree.core.frames import LocalFrame, from_viewer
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.octree.config import TILE_RAYS, TILE_SIDE, MaxRadianceConfig
from lumitree.lamp.luminaire import Luminaire
from lumitree.trace import medium_paths
from lumitree.trace.cameras import (
    COSINE_OF_CONE,
    PATH_DEPTH,
    is_smooth,
    is_transmitted,
    path_integrator,
    straight_through,
)
from lumitree.trace.light_paths import LightPaths, termination_point, trace_light
from lumitree.trace.spawning import scene_box, scene_extent, spawn

OriginDirection = tuple["mi.Point3f", "mi.Vector3f"]
# Which rays (origin, direction, local frame) are worth tracing.
Wanted = Callable[["mi.Point3f", "mi.Vector3f"], "mi.Bool"]


@dataclasses.dataclass
class Rays:
    """A batch of rays in the local frame, and the light along them.

    For an f that is 0 on all unwanted rays (light paths are not selected), the integral of
    f(ray) · radiance(ray) over the wanted rays, divided by their measure, is estimated without bias
    by the sum of f · light over the batch; the integral of f(ray) alone by the sum of f · share.

    Attributes:
        origin, direction: local frame, direction of travel.
        share: the part of all wanted rays that this one stands for; 0 for a light path.
        light: radiance times share; for a light path its flux over the measure.
        transmittance: straight-through throughput; 0 for a light path.
    """

    origin: mi.Point3f
    direction: mi.Vector3f
    share: mi.Float
    light: mi.Color3f
    transmittance: mi.Float


@dataclasses.dataclass
class RayPairs:
    """Rays as in `Rays`, with two independent noisy estimates of all their radiance."""

    origin: mi.Point3f
    direction: mi.Vector3f
    first: mi.Color3f
    second: mi.Color3f
    transmittance: mi.Float


@dataclasses.dataclass(frozen=True)
class Subject:
    """Luminaire that the rays show."""

    name: str
    fingerprint: str
    frame: LocalFrame


def chosen_rays(
    origin: mi.Point3f, direction: mi.Vector3f, wanted: Wanted
) -> tuple[mi.Point3f, mi.Vector3f, mi.UInt32]:
    """The wanted rays, and their indices."""
    chosen = dr.compress(wanted(origin, direction))
    origin = dr.gather(mi.Point3f, origin, chosen)
    direction = dr.gather(mi.Vector3f, direction, chosen)
    dr.eval(origin, direction)
    return origin, direction, chosen


class RaySource(Protocol):
    """Where a bake gets its rays from.

    Rays depend on the source's root seed and on the `SeedStream` argument, not on what was
    drawn before: so a bake that was interrupted continues with the same rays.
    """

    @property
    def subject(self) -> Subject:
        """The luminaire that the rays show."""
        ...

    def draw(
        self, count: int, stream: SeedStream, wanted: Wanted, light_paths_per_ray: float
    ) -> Rays:
        """The wanted ones of `count` random rays, and light paths.

        Args:
            light_paths_per_ray: light paths traced for each of the `count` rays.
        """
        ...

    def draw_opacity(
        self, count: int, stream: SeedStream, wanted: Wanted
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Float]:
        """Origin, direction and transmittance of the wanted ones of `count` random rays."""
        ...

    def draw_pairs(self, count: int, stream: SeedStream, paths: int) -> RayPairs:
        """`count` random rays, and two independent means of `paths` camera paths for each."""
        ...


# Steps of Roberts' R sequence in six dimensions, in 2^-32: powers of 1/g, where g^7 = g + 1.
_LATTICE_STEPS = [round(2**32 * 1.1127756842787055**-power) for power in range(1, 7)]


class RayTiles:
    """Uniform rays through the proxy box of half extents [3], local units.

    `spacing` is the distance of neighbouring rays of a tile, local units.
    """

    def __init__(self, half_extents: NDArray[np.float64], spacing: float) -> None:
        # The middles of tiles pass through a box that is larger by half a tile's diagonal. Drawn
        # through the proxy itself, its rim would get fewer rays than its centre.
        self._half = half_extents + TILE_SIDE / math.sqrt(2) * spacing
        # No ray's origin is farther from the centre of the box than this.
        reach = 1.01 * float(np.linalg.norm(self._half)) + TILE_SIDE * spacing
        self.reach, self._spacing = parameter(mi.Float, reach), parameter(mi.Float, spacing)

    @property
    def measure(self) -> float:
        """Integral of dA cos(theta) domega over all rays that `draw` chooses from, local units² sr.

        All rays through the enlarged box have pi times its surface.
        """
        x, y, z = self._half
        return float(np.pi * 8 * (x * y + y * z + z * x))

    def draw(self, count: int, tile_seed: int, sampler: mi.Sampler) -> OriginDirection:
        """Random rays: origins and directions in the local frame.

        Rays of a tile are parallel, `spacing` apart and jittered. Those that meet the proxy are
        uniform; some miss it.

        Args:
            count: number of rays, a multiple of `TILE_RAYS`.
            tile_seed: of the positions, directions and rotations of the tiles.
            sampler: seeded for `count` rays, for the jitter.
        """
        centre, direction, right, up = self._tiles(count // TILE_RAYS, tile_seed)
        index = dr.arange(mi.UInt32, count)
        tile, within = index // TILE_RAYS, index % TILE_RAYS
        place = mi.Point2f(within % TILE_SIDE, within // TILE_SIDE) - TILE_SIDE / 2
        jitter = (place + sampler.next_2d()) * self._spacing
        origin = (
            dr.gather(mi.Vector3f, centre, tile)
            + jitter.x * dr.gather(mi.Vector3f, right, tile)
            + jitter.y * dr.gather(mi.Vector3f, up, tile)
        )
        return mi.Point3f(origin), dr.gather(mi.Vector3f, direction, tile)

    def _tiles(self, count: int, seed: int) -> tuple[mi.Vector3f, ...]:
        """Centre, direction and both axes of `count` tiles."""
        face, turn, *places = _lattice(count, seed)
        x, y, z = self._half
        areas = np.array([y * z, z * x, x * y])
        split = parameter(mi.Vector2f, *np.cumsum(areas / areas.sum())[:2].tolist())
        side = dr.select(face < 0.5, mi.Float(-1), 1)
        u = dr.select(face < 0.5, 2 * face, 2 * face - 1)
        axis = dr.select(u < split[0], 0, dr.select(u < split[1], 1, mi.UInt32(2)))
        place = 2 * mi.Point2f(*places[:2]) - 1
        towards = mi.warp.square_to_cosine_hemisphere(mi.Point2f(*places[2:]))
        centre = _on_axis(axis, place.x, place.y, side) * parameter(
            mi.Vector3f, *self._half.tolist()
        )
        direction = _on_axis(axis, towards.x, towards.y, -side * towards.z)
        s, t = mi.coordinate_system(direction)
        sine, cosine = dr.sincos(2 * np.pi * turn)
        right, up = cosine * s + sine * t, cosine * t - sine * s
        dr.eval(centre, direction, right, up)
        return centre, direction, right, up


def _lattice(count: int, seed: int) -> list[mi.Float]:
    """`count` points of a Kronecker sequence, shifted at random, in six dimensions, 0 to 1.

    Each point is uniform, and together they are spread more evenly than random ones.
    """
    shift = np.random.default_rng(seed).integers(1 << 32, size=len(_LATTICE_STEPS))
    index = dr.arange(mi.UInt32, count)
    return [
        # Wraps at 1, by its 32 bits; a Float has 24 of them.
        mi.Float((index * mi.UInt32(step) + parameter(mi.UInt32, int(first))) >> 8) * 2**-24
        for step, first in zip(_LATTICE_STEPS, shift, strict=True)
    ]


def _on_axis(axis: mi.UInt32, a: mi.Float, b: mi.Float, n: mi.Float) -> mi.Vector3f:
    """A vector whose component along `axis` is n, and a and b the two that follow it."""
    return mi.Vector3f(
        dr.select(axis == 0, n, dr.select(axis == 1, b, a)),
        dr.select(axis == 0, a, dr.select(axis == 1, n, b)),
        dr.select(axis == 0, b, dr.select(axis == 1, a, n)),
    )


@dataclasses.dataclass
class TerminatedRays:
    """Rays with their termination points.

    Attributes:
        origin, direction: the ray, local frame.
        point: local frame; without meaning where `terminated` is false.
        radiance: of the emitters seen through smooth transmission.
    """

    origin: mi.Point3f
    direction: mi.Vector3f
    point: mi.Point3f
    terminated: mi.Bool
    radiance: mi.Color3f


@dr.syntax
def trace_to_termination(scene, sampler, ray):
    """Follow rays by transmissions only, each chosen at random, until they terminate or leave.

    Returns:
        Termination point (mi.Point3f, frame of the scene), whether there is one (mi.Bool), and
        radiance of the emitters seen through smooth transmission (mi.Color3f).
    """
    context = mi.BSDFContext()
    straight = mi.Vector3f(ray.d)
    ray = mi.Ray3f(ray)
    throughput = mi.Color3f(1)
    radiance = mi.Color3f(0)
    first = dr.zeros(mi.Point3f)
    point = dr.zeros(mi.Point3f)
    terminated = mi.Bool(False)
    smooth = mi.Bool(True)
    medium = dr.zeros(mi.MediumPtr)
    extent, box = scene_extent(scene), scene_box(scene)
    crossings = mi.UInt32(0)
    at_first = sampler.next_1d() < 0.5
    active = mi.Bool(True)
    while active:
        si = scene.ray_intersect(ray, active)
        inside = active & (medium != None)  # noqa: E711 (a vector comparison)
        _, extinction = medium_paths.coefficients(medium, active)
        mean = channel_mean(extinction)
        flight = dr.select(inside & (mean > 0), -dr.log(1 - sampler.next_1d(active)) / mean, dr.inf)
        collides = inside & (flight < dr.select(si.is_valid(), si.t, dr.inf))
        travelled = dr.select(collides, flight, dr.select(si.is_valid(), si.t, 0))
        tilt = dr.select(inside, dr.exp(-(extinction - mean) * travelled), 1)
        throughput[active] = throughput * tilt

        hits = active & ~collides & si.is_valid()
        first = dr.select(hits & (crossings == 0), si.p, first)
        light = si.emitter(scene, hits).eval(si, hits)
        radiance[hits & smooth] = radiance + throughput * light
        sample, weight = si.bsdf(ray).sample(
            context, si, sampler.next_1d(hits), sampler.next_2d(hits), hits
        )
        transmits = hits & is_transmitted(sample.sampled_type)
        throughput[hits] = throughput * weight
        smooth &= is_smooth(sample.sampled_type)
        onwards = spawn(si, si.to_world(sample.wo), extent)

        bent = dr.dot(ray.d, straight) < COSINE_OF_CONE
        # Light leaving in another direction is not behind the luminaire: it was deflected inside.
        deflected = active & ~collides & ~si.is_valid() & bent & (crossings > 0)
        ends = deflected | collides | (hits & (~transmits | (dr.max(throughput) <= 0)))
        last = dr.select(collides, ray(flight), dr.select(deflected, ray.o, si.p))
        end = termination_point(box, straight, first, last, bent & at_first)
        point = dr.select(ends, end, point)
        terminated |= ends

        medium = medium_paths.medium_after(si, onwards.d, medium, transmits)
        ray = dr.select(transmits, onwards, ray)
        crossings += 1
        active = transmits & (crossings < PATH_DEPTH) & (dr.max(throughput) > 0)

    return point, terminated, radiance


class _Part(enum.IntEnum):
    """Parts of a draw of `TracedRays` with independent random numbers."""

    TILES = 0
    JITTER = 1
    STRAIGHT_THROUGH = 2
    LIGHT_PATHS = 3
    CAMERA_PATHS = 4
    SECOND_PATHS = 5


class TracedRays:
    """Random rays of a luminaire, as many as needed; equal seeds and streams give equal rays.

    Neighbouring rays of a tile are `spacing` apart, in local units.
    """

    def __init__(self, luminaire: Luminaire, spacing: float, seed: int = 0) -> None:
        self.luminaire, self.spacing = luminaire, spacing
        self._tiles = RayTiles(luminaire.frame.half_extents, spacing)
        self._seed = seed
        self._sampler = mi.load_dict({"type": "independent"})
        self._integrator = path_integrator(luminaire, PATH_DEPTH)
        self._to_world = mi.Transform4f(luminaire.scene_frame.world_from_local)
        self._to_local = mi.Transform4f(luminaire.scene_frame.local_from_world)
        dr.make_opaque(self._to_world, self._to_local)

    @property
    def subject(self) -> Subject:
        """The luminaire."""
        of = self.luminaire
        return Subject(of.name, of.fingerprint, of.frame)

    @property
    def measure(self) -> float:
        """Integral of dA cos(theta) domega over the rays that are drawn from, local units² sr."""
        return self._tiles.measure

    def draw(
        self, count: int, stream: SeedStream, wanted: Wanted, light_paths_per_ray: float
    ) -> Rays:
        """As `RaySource.draw`."""
        origin, direction = self._wanted_rays(count, stream, wanted)
        num_rays = dr.width(origin)
        if not num_rays:
            none = mi.Float()
            return Rays(origin, direction, none, mi.Color3f(none), none)
        through, seen = self._follow_smooth(origin, direction, stream)
        paths = self.light_paths(max(1, round(light_paths_per_ray * count)), stream)
        share = parameter(mi.Float, 1 / num_rays)
        # The measure of the wanted rays is that part of all.
        scale = parameter(mi.Float, count / (num_rays * self.measure))
        num_paths = dr.width(paths.exit)
        rays = Rays(
            _join(origin, paths.exit),
            _join(direction, from_viewer(paths.direction)),
            concatenate([share * dr.ones(mi.Float, num_rays), dr.zeros(mi.Float, num_paths)]),
            _join(seen * share, paths.flux * scale),
            concatenate([through, dr.zeros(mi.Float, num_paths)]),
        )
        dr.eval(rays.origin, rays.direction, rays.share, rays.light, rays.transmittance)
        return rays

    def draw_opacity(
        self, count: int, stream: SeedStream, wanted: Wanted
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Float]:
        """As `RaySource.draw_opacity`."""
        rays = self._wanted_rays(count, stream, wanted)
        if not dr.width(rays[0]):
            return *rays, mi.Float()
        return *rays, self._follow_smooth(*rays, stream)[0]

    def draw_pairs(self, count: int, stream: SeedStream, paths: int) -> RayPairs:
        """As `RaySource.draw_pairs`."""
        origin, direction = self.random_rays(count, stream)
        first, through = self.trace(origin, direction, stream, paths)
        second = self._trace(origin, direction, stream.seed(self._seed, _Part.SECOND_PATHS), paths)
        return RayPairs(origin, direction, first, second, through)

    def draw_terminated(self, count: int, stream: SeedStream) -> TerminatedRays:
        """`count` random rays with their termination points."""
        origin, direction = self.random_rays(count, stream)
        point, terminated, radiance = trace_to_termination(
            self.luminaire.scene, self._sampler, self._world_ray(origin, direction)
        )
        rays = TerminatedRays(origin, direction, self._to_local @ point, terminated, radiance)
        dr.eval(rays.origin, rays.direction, rays.point, rays.terminated, rays.radiance)
        return rays

    def random_rays(self, count: int, stream: SeedStream) -> OriginDirection:
        """Origins and directions of `count` random rays, see `RayTiles.draw`."""
        self._sampler.seed(stream.seed(self._seed, _Part.JITTER), count)
        tile_seed = stream.seed(self._seed, _Part.TILES)
        return self._tiles.draw(count, tile_seed, self._sampler)

    def light_paths(self, count: int, stream: SeedStream) -> LightPaths:
        """The light of `count` light paths, without what rays see through smooth transmission."""
        self._sampler.seed(stream.seed(self._seed, _Part.LIGHT_PATHS), count)
        return trace_light(self.luminaire, self._sampler, count, PATH_DEPTH)

    def trace(
        self, origin: mi.Point3f, direction: mi.Vector3f, stream: SeedStream, paths: int
    ) -> tuple[mi.Color3f, mi.Float]:
        """All radiance of rays, mean of some camera paths, and transmittance."""
        seed = stream.seed(self._seed, _Part.CAMERA_PATHS)
        radiance = self._trace(origin, direction, seed, paths)
        return radiance, self._follow_smooth(origin, direction, stream)[0]

    def max_radiance(self, pixel: float, config: MaxRadianceConfig) -> float:
        """99.99th percentile of radiance over the pixels of views all around.

        If that is 0, the radiance of the brightest pixel: all light is from a small part.

        The rays of a tile average to a pixel; views also have pixels beside the box, which rays do
        not visit.

        Args:
            pixel: its width, local units.
            config: how many rays and paths.
        """
        near = TracedRays(self.luminaire, pixel / TILE_SIDE, seed=self._seed)
        stream = SeedStream(Purpose.MAX_RADIANCE)
        radiance, _ = near.trace(*near.random_rays(config.rays, stream), stream, config.paths)
        tiles = [np.array(dr.block_sum(value, TILE_RAYS)) for value in radiance]
        pixels = np.stack(tiles) / TILE_RAYS
        views = 4 * np.pi * np.pi * self.luminaire.bounding_radius**2
        brightest = max(1, round(1e-4 * 3 * (config.rays // TILE_RAYS) * views / near.measure))
        values = np.sort(pixels.ravel())
        return float(values[-min(brightest, len(values))] or values[-1])

    def _wanted_rays(self, count: int, stream: SeedStream, wanted: Wanted) -> OriginDirection:
        return chosen_rays(*self.random_rays(count, stream), wanted)[:2]

    def _trace(
        self, origin: mi.Point3f, direction: mi.Vector3f, seed: int, paths: int
    ) -> mi.Color3f:
        count, scene = dr.width(origin), self.luminaire.scene
        index = dr.arange(mi.UInt32, count * paths) // paths
        copies = dr.gather(mi.Point3f, origin, index), dr.gather(mi.Vector3f, direction, index)
        self._sampler.seed(seed, count * paths)
        ray = mi.RayDifferential3f(self._world_ray(*copies))
        radiance, _, _ = self._integrator.sample(scene, self._sampler, ray)
        # A block sum evaluates what it sums: without this, every channel would be traced again.
        dr.eval(radiance)
        radiance = mi.Color3f(*(dr.block_sum(value, paths) / paths for value in radiance))
        dr.eval(radiance)
        return radiance

    def _follow_smooth(
        self, origin: mi.Point3f, direction: mi.Vector3f, stream: SeedStream
    ) -> tuple[mi.Float, mi.Color3f]:
        """Transmittance of rays, and radiance seen through smooth transmission only."""
        self._sampler.seed(stream.seed(self._seed, _Part.STRAIGHT_THROUGH), dr.width(origin))
        ray = self._world_ray(origin, direction)
        found = straight_through(self.luminaire.scene, self._sampler, ray, PATH_DEPTH)
        dr.eval(found)
        return found

    def _world_ray(self, origin: mi.Point3f, direction: mi.Vector3f) -> mi.Ray3f:
        # From outside the bounding sphere, so that nothing is missed.
        back = dr.dot(direction, origin) + self._tiles.reach
        outside = mi.Point3f(origin - back * direction)
        return mi.Ray3f(self._to_world @ outside, dr.normalize(self._to_world @ direction))


def _join(first: Any, second: Any) -> Any:
    return type(first)(*(concatenate(values) for values in zip(first, second, strict=True)))
