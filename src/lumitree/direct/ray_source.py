"""Rays to learn from, traced afresh for every batch: random lines, and paths from the emitters.

What a line sees through smooth transmission alone is found by following it; all other light is
brought by paths that start at the emitters (`light_paths`), which find it with far less noise. The
loss of a field is an integral over lines that holds the light to be learned in first power only, so
that the two parts are summed apart.

Symbols
    line        a ray that enters the proxy box; lines are uniform in dA cos(theta) domega, the
                measure in which flux is the integral of radiance
    light       integral of radiance over lines; a path from an emitter carries some of it
    stop        where a line ends that cannot be followed straight through: at the surface or in
                the medium that reflects, scatters or absorbs it, or on the line abreast of that;
                where it was bent on the way, by a coin at the first surface (`stop_on_line`)
"""

import dataclasses
import enum
import math
from collections.abc import Callable
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.seeds import Purpose, SeedStream
from lumitree.luminaire.luminaire import Luminaire
from lumitree.transport.light_paths import LightPaths, stop_on_line, trace_light
from lumitree.transport.straight_through import (
    COSINE_OF_CONE,
    extinction_at,
    is_smooth,
    is_transmitted,
    straight_through,
)
from lumitree.transport.tracing import PATH_DEPTH, path_integrator

# Lines come in tiles of so many neighbours a side, so that the lanes of a vector unit walk the same
# part of the tree.
TILE = 4
TILE_LINES = TILE**2
# Steps of Roberts' R sequence in six dimensions, in 2^-32: powers of 1/g, where g^7 = g + 1.
_LATTICE_STEPS = [round(2**32 * 1.1127756842787055**-power) for power in range(1, 7)]
# Paths from the emitters for each line, where not said otherwise.
LIGHT_SHARE = 0.5
# Which lines (origin, direction, local frame) are worth tracing: mi.Bool.
Wanted = Callable[[Any, Any], Any]


@dataclasses.dataclass
class Rays:
    """A batch of rays in the local frame, and what they should show.

    For an f that is 0 on all other lines (emitted paths are not sorted by what is wanted),
    the integral of f(ray) · radiance(ray) over the wanted lines, divided by their measure, is the
    sum of f · light over the batch without bias; of f(ray) alone, of f · share.

    Attributes:
        origin, direction: mi.Point3f and mi.Vector3f, local frame, direction of travel.
        share: mi.Float, the part of all wanted lines that the ray stands for; 0 where it is a path
            from an emitter.
        light: mi.Color3f, radiance times share.
        transmittance: mi.Float, straight-through throughput (D7); 0 for paths from emitters.
    """

    origin: Any
    direction: Any
    share: Any
    light: Any
    transmittance: Any


@dataclasses.dataclass
class Stops:
    """Where lines stop.

    Attributes:
        origin, direction: the line, local frame.
        point: mi.Point3f, where it stops, local frame; without meaning where it does not.
        stopped: mi.Bool; false where the line passes through.
        radiance: mi.Color3f, of the emitters seen through smooth transmission.
    """

    origin: Any
    direction: Any
    point: Any
    stopped: Any
    radiance: Any


@dataclasses.dataclass
class Pairs:
    """Lines with two independent noisy estimates of all their radiance.

    Attributes:
        origin, direction: as in `Rays`.
        first, second: mi.Color3f.
        transmittance: mi.Float, straight-through throughput (D7).
    """

    origin: Any
    direction: Any
    first: Any
    second: Any
    transmittance: Any


@dataclasses.dataclass(frozen=True)
class Subject:
    """What the rays show.

    Attributes:
        name: of the luminaire.
        fingerprint: identifies its content.
        half_extents: [3] the proxy box, local units.
        world_from_proxy: [4, 4] local frame (D8).
    """

    name: str
    fingerprint: str
    half_extents: NDArray[np.float64]
    world_from_proxy: NDArray[np.float64]


class _Part(enum.IntEnum):
    """Parts of a draw of `TracedRays` that have random numbers of their own."""

    TILES = 0
    LINES = 1
    STRAIGHT_THROUGH = 2
    LIGHT_PATHS = 3
    CAMERA_PATHS = 4
    SECOND_PATHS = 5


class RaySource(Protocol):
    """Where a bake gets its rays from.

    Rays depend on the source's own root seed and on the `SeedStream` argument, not on what was
    drawn before: so a bake that was interrupted continues with the same rays.
    """

    @property
    def subject(self) -> Subject:
        """What the rays show."""
        ...

    def draw(
        self, count: int, stream: SeedStream, wanted: Wanted, light_share: float = LIGHT_SHARE
    ) -> Rays:
        """Of `count` random lines those that are wanted, and light from the emitters.

        Args:
            light_share: paths traced from the emitters for each of the lines.
        """
        ...

    def straight(self, count: int, stream: SeedStream, wanted: Wanted) -> tuple[Any, Any, Any]:
        """Origin, direction and transmittance of those of `count` random lines that are wanted."""
        ...

    def pairs(self, count: int, stream: SeedStream, paths: int) -> Pairs:
        """`count` random lines, and two independent means of `paths` camera paths for each."""
        ...


class TracedRays:
    """Endless rays of a luminaire; equal root seeds and streams give equal rays.

    Args:
        luminaire: what is traced.
        spacing: distance of neighbouring lines, local units.
        seed: root seed of all random numbers, see `core.seeds`.
    """

    def __init__(self, luminaire: Luminaire, spacing: float, seed: int = 0) -> None:
        self.luminaire, self.spacing = luminaire, spacing
        # The middles of tiles pass through a box that is larger by half a tile's diagonal: were it
        # the proxy itself, its rim would get fewer lines, since the middles of theirs may miss it.
        self._half = luminaire.half_extents + TILE / math.sqrt(2) * spacing
        self._reach = 1.01 * float(np.linalg.norm(self._half)) + TILE * spacing
        self._seed = seed
        self._sampler = mi.load_dict({"type": "independent"})
        self._integrator = path_integrator(luminaire, PATH_DEPTH)
        self._to_world = mi.Transform4f(luminaire.world_from_proxy)
        self._to_local = mi.Transform4f(np.linalg.inv(luminaire.world_from_proxy))
        dr.make_opaque(self._to_world, self._to_local)

    @property
    def subject(self) -> Subject:
        """The luminaire."""
        of = self.luminaire
        return Subject(of.name, of.fingerprint, of.half_extents, of.world_from_proxy)

    @property
    def measure(self) -> float:
        """Integral of dA cos(theta) domega over all that `lines` draws from, local units² sr."""
        x, y, z = self._half
        return float(np.pi * 8 * (x * y + y * z + z * x))

    def lines(self, count: int, stream: SeedStream) -> tuple[Any, Any]:
        """Random lines: origins and directions in the local frame.

        Lines of a tile are parallel, `spacing` apart and jittered; the tiles are spread evenly.
        Those that meet the proxy are uniform; some miss it.

        Args:
            count: number of lines, a multiple of `TILE_LINES`.
        """
        face, turn, *places = _lattice(count // TILE_LINES, stream.seed(self._seed, _Part.TILES))
        x, y, z = self._half
        areas = np.array([y * z, z * x, x * y])
        split = np.cumsum(areas / areas.sum())
        side = dr.select(face < 0.5, mi.Float(-1), 1)
        u = dr.select(face < 0.5, 2 * face, 2 * face - 1)
        axis = dr.select(u < split[0], 0, dr.select(u < split[1], 1, mi.UInt32(2)))
        place = 2 * mi.Point2f(*places[:2]) - 1
        towards = mi.warp.square_to_cosine_hemisphere(mi.Point2f(*places[2:]))
        centre = _on_axis(axis, place.x, place.y, side) * mi.Vector3f(*self._half.tolist())
        direction = _on_axis(axis, towards.x, towards.y, -side * towards.z)
        s, t = mi.coordinate_system(direction)
        sine, cosine = dr.sincos(2 * np.pi * turn)
        right, up = cosine * s + sine * t, cosine * t - sine * s
        dr.eval(centre, direction, right, up)

        self._sampler.seed(stream.seed(self._seed, _Part.LINES), count)
        index = dr.arange(mi.UInt32, count)
        tile, within = index // TILE_LINES, index % TILE_LINES
        place = mi.Point2f(within % TILE, within // TILE) - TILE / 2
        jitter = (place + self._sampler.next_2d()) * self.spacing
        origin = (
            dr.gather(mi.Vector3f, centre, tile)
            + jitter.x * dr.gather(mi.Vector3f, right, tile)
            + jitter.y * dr.gather(mi.Vector3f, up, tile)
        )
        return mi.Point3f(origin), dr.gather(mi.Vector3f, direction, tile)

    def draw(
        self, count: int, stream: SeedStream, wanted: Wanted, light_share: float = LIGHT_SHARE
    ) -> Rays:
        """Of `count` random lines those that are wanted, and light from the emitters.

        Args:
            light_share: paths traced from the emitters for each of the lines.
        """
        origin, direction = self._wanted_lines(count, stream, wanted)
        lines = dr.width(origin)
        if not lines:
            none = mi.Float()
            return Rays(origin, direction, none, mi.Color3f(none), none)
        through, seen = self._follow_smooth(origin, direction, stream)
        paths = self.light(round(light_share * count), stream)
        share = dr.opaque(mi.Float, 1 / lines)
        # The measure of the wanted lines is that part of all.
        scale = dr.opaque(mi.Float, count / (lines * self.measure))
        size = dr.width(paths.origin)
        rays = Rays(
            _join(origin, paths.origin),
            _join(direction, paths.direction),
            dr.concat([share * dr.ones(mi.Float, lines), dr.zeros(mi.Float, size)]),
            _join(seen * share, paths.flux * scale),
            dr.concat([through, dr.zeros(mi.Float, size)]),
        )
        dr.eval(rays.origin, rays.direction, rays.share, rays.light, rays.transmittance)
        return rays

    def straight(self, count: int, stream: SeedStream, wanted: Wanted) -> tuple[Any, Any, Any]:
        """Origin, direction and transmittance of those of `count` random lines that are wanted."""
        line = self._wanted_lines(count, stream, wanted)
        if not dr.width(line[0]):
            return *line, mi.Float()
        return *line, self._follow_smooth(*line, stream)[0]

    def _wanted_lines(self, count: int, stream: SeedStream, wanted: Wanted) -> tuple[Any, Any]:
        origin, direction = self.lines(count, stream)
        chosen = dr.compress(wanted(origin, direction))
        origin = dr.gather(mi.Point3f, origin, chosen)
        direction = dr.gather(mi.Vector3f, direction, chosen)
        dr.eval(origin, direction)
        return origin, direction

    def light(self, count: int, stream: SeedStream) -> LightPaths:
        """What comes out of `count` paths from the emitters, all but what lines see smoothly."""
        self._sampler.seed(stream.seed(self._seed, _Part.LIGHT_PATHS), count)
        return trace_light(self.luminaire, self._sampler, count, PATH_DEPTH)

    def pairs(self, count: int, stream: SeedStream, paths: int) -> Pairs:
        """`count` random lines, and two independent means of `paths` camera paths for each."""
        origin, direction = self.lines(count, stream)
        first, through = self.trace(origin, direction, stream, paths)
        second = self._trace(origin, direction, stream.seed(self._seed, _Part.SECOND_PATHS), paths)
        return Pairs(origin, direction, first, second, through)

    def trace(self, origin: Any, direction: Any, stream: SeedStream, paths: int) -> tuple[Any, Any]:
        """All radiance (mi.Color3f) of lines, mean of some camera paths, and transmittance."""
        seed = stream.seed(self._seed, _Part.CAMERA_PATHS)
        radiance = self._trace(origin, direction, seed, paths)
        return radiance, self._follow_smooth(origin, direction, stream)[0]

    def _trace(self, origin: Any, direction: Any, seed: int, paths: int) -> Any:
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

    def _follow_smooth(self, origin: Any, direction: Any, stream: SeedStream) -> tuple[Any, Any]:
        self._sampler.seed(stream.seed(self._seed, _Part.STRAIGHT_THROUGH), dr.width(origin))
        ray = self._world_ray(origin, direction)
        found = straight_through(self.luminaire.scene, self._sampler, ray, PATH_DEPTH)
        dr.eval(found)
        return found

    def max_radiance(self, pixel: float) -> float:
        """L_max (D9): 99.99th percentile of radiance over the pixels of views all around.

        Lines of a tile average to a pixel; views also hold pixels beside the box, which lines do
        not visit.

        Args:
            pixel: its width, local units.
        """
        count = 1 << 21
        near = TracedRays(self.luminaire, pixel / TILE, seed=self._seed)
        stream = SeedStream(Purpose.MAX_RADIANCE)
        radiance, _ = near.trace(*near.lines(count, stream), stream, 2)
        tiles = [np.array(dr.block_sum(value, TILE_LINES)) for value in radiance]
        pixels = np.stack(tiles) / TILE_LINES
        views = 4 * np.pi * np.pi * self.luminaire.bounding_radius**2
        brightest = max(1, round(1e-4 * 3 * (count // TILE_LINES) * views / near.measure))
        values = np.sort(pixels.ravel())
        return float(values[-min(brightest, len(values))])

    def stops(self, count: int, stream: SeedStream) -> Stops:
        """Random lines with the place where each one's straight part ends."""
        origin, direction = self.lines(count, stream)
        point, stopped, radiance = self._follow(self._world_ray(origin, direction))
        stops = Stops(origin, direction, self._to_local @ point, stopped, radiance)
        dr.eval(stops.origin, stops.direction, stops.point, stops.stopped, stops.radiance)
        return stops

    def _world_ray(self, origin, direction):
        # From outside the bounding sphere, so that nothing is missed.
        back = dr.dot(direction, origin) + self._reach
        outside = mi.Point3f(origin - back * direction)
        return mi.Ray3f(self._to_world @ outside, dr.normalize(self._to_world @ direction))

    @dr.syntax
    def _follow(self, ray):
        scene, sampler = self.luminaire.scene, self._sampler
        context = mi.BSDFContext()
        straight = mi.Vector3f(ray.d)
        ray = mi.Ray3f(ray)
        throughput = mi.Color3f(1)
        radiance = mi.Color3f(0)
        first = dr.zeros(mi.Point3f)
        stop = dr.zeros(mi.Point3f)
        stopped = mi.Bool(False)
        smooth = mi.Bool(True)
        medium = dr.zeros(mi.MediumPtr)
        crossings = mi.UInt32(0)
        at_once = sampler.next_1d() < 0.5
        active = mi.Bool(True)
        while active:
            si = scene.ray_intersect(ray, active)
            inside = active & (medium != None)  # noqa: E711 (a vector comparison)
            extinction = extinction_at(medium, ray.o, inside)
            mean = dr.mean(extinction)
            flight = dr.select(
                inside & (mean > 0), -dr.log(1 - sampler.next_1d(active)) / mean, dr.inf
            )
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
            onwards = si.spawn_ray(si.to_world(sample.wo))

            bent = dr.dot(ray.d, straight) < COSINE_OF_CONE
            # What leaves in another direction was stopped on its way.
            missed = active & ~collides & ~si.is_valid() & bent & (crossings > 0)
            ends = missed | collides | (hits & (~transmits | (dr.max(throughput) <= 0)))
            last = dr.select(collides, ray(flight), dr.select(missed, ray.o, si.p))
            halt = stop_on_line(scene.bbox(), straight, first, last, bent & at_once)
            stop = dr.select(ends, halt, stop)
            stopped |= ends

            medium = dr.select(
                transmits & si.is_medium_transition(), si.target_medium(onwards.d), medium
            )
            ray = dr.select(transmits, onwards, ray)
            crossings += 1
            active = transmits & (crossings < PATH_DEPTH) & (dr.max(throughput) > 0)

        return stop, stopped, radiance


def _lattice(count: int, seed: int) -> list[Any]:
    """`count` points of a Kronecker sequence, shifted at random: six mi.Float in [0, 1).

    Each point is uniform, and together they are spread more evenly than random ones.
    """
    shift = np.random.default_rng(seed).integers(1 << 32, size=len(_LATTICE_STEPS))
    index = dr.arange(mi.UInt32, count)
    return [
        # Wraps at 1, by its 32 bits; a Float holds 24 of them.
        mi.Float((index * mi.UInt32(step) + dr.opaque(mi.UInt32, int(first))) >> 8) * 2**-24
        for step, first in zip(_LATTICE_STEPS, shift, strict=True)
    ]


def _join(first: Any, second: Any) -> Any:
    """One vector array after the other."""
    return type(first)(*(dr.concat(values) for values in zip(first, second, strict=True)))


def _on_axis(axis: Any, a: Any, b: Any, n: Any) -> Any:
    """mi.Vector3f whose component along `axis` is n, and a and b the two that follow it."""
    return mi.Vector3f(
        dr.select(axis == 0, n, dr.select(axis == 1, b, a)),
        dr.select(axis == 0, a, dr.select(axis == 1, n, b)),
        dr.select(axis == 0, b, dr.select(axis == 1, a, n)),
    )
