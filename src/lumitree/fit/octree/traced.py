"""Rays of a luminaire, traced afresh for every batch: `RaySource` from a scene.

What a ray sees through smooth transmission alone is found by following it. All other light is
brought by light paths (`trace.light_paths`), which find it with far less noise.
"""

import enum
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.frames import from_viewer
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.octree.config import TILE_RAYS, TILE_SIDE, MaxRadianceConfig
from lumitree.fit.octree.ray_source import RayPairs, Rays, Subject, Wanted
from lumitree.fit.octree.ray_tiles import RayTiles
from lumitree.fit.octree.termination import TerminatedRays, trace_to_termination
from lumitree.lamp.luminaire import Luminaire
from lumitree.trace.light_paths import LightPaths, trace_light
from lumitree.trace.straight_through import straight_through
from lumitree.trace.tracing import PATH_DEPTH, path_integrator


class _Part(enum.IntEnum):
    """Parts of a draw of `TracedRays` that have random numbers of their own."""

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
        """The wanted ones of `count` random rays, and light paths.

        Args:
            light_paths_per_ray: light paths traced for each of the `count` rays.
        """
        origin, direction = self._wanted_rays(count, stream, wanted)
        num_rays = dr.width(origin)
        if not num_rays:
            none = mi.Float()
            return Rays(origin, direction, none, mi.Color3f(none), none)
        through, seen = self._follow_smooth(origin, direction, stream)
        paths = self.light_paths(max(1, round(light_paths_per_ray * count)), stream)
        share = dr.opaque(mi.Float, 1 / num_rays)
        # The measure of the wanted rays is that part of all.
        scale = dr.opaque(mi.Float, count / (num_rays * self.measure))
        num_paths = dr.width(paths.exit)
        rays = Rays(
            _join(origin, paths.exit),
            _join(direction, from_viewer(paths.direction)),
            dr.concat([share * dr.ones(mi.Float, num_rays), dr.zeros(mi.Float, num_paths)]),
            _join(seen * share, paths.flux * scale),
            dr.concat([through, dr.zeros(mi.Float, num_paths)]),
        )
        dr.eval(rays.origin, rays.direction, rays.share, rays.light, rays.transmittance)
        return rays

    def draw_opacity(self, count: int, stream: SeedStream, wanted: Wanted) -> tuple[Any, Any, Any]:
        """Origin, direction and transmittance of the wanted ones of `count` random rays."""
        rays = self._wanted_rays(count, stream, wanted)
        if not dr.width(rays[0]):
            return *rays, mi.Float()
        return *rays, self._follow_smooth(*rays, stream)[0]

    def draw_pairs(self, count: int, stream: SeedStream, paths: int) -> RayPairs:
        """`count` random rays, and two independent means of `paths` camera paths for each."""
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

    def random_rays(self, count: int, stream: SeedStream) -> tuple[Any, Any]:
        """Origins and directions of `count` random rays, see `RayTiles.draw`."""
        self._sampler.seed(stream.seed(self._seed, _Part.JITTER), count)
        tile_seed = stream.seed(self._seed, _Part.TILES)
        return self._tiles.draw(count, tile_seed, self._sampler)

    def light_paths(self, count: int, stream: SeedStream) -> LightPaths:
        """The light of `count` light paths, without what rays see through smooth transmission."""
        self._sampler.seed(stream.seed(self._seed, _Part.LIGHT_PATHS), count)
        return trace_light(self.luminaire, self._sampler, count, PATH_DEPTH)

    def trace(self, origin: Any, direction: Any, stream: SeedStream, paths: int) -> tuple[Any, Any]:
        """All radiance (mi.Color3f) of rays, mean of some camera paths, and transmittance."""
        seed = stream.seed(self._seed, _Part.CAMERA_PATHS)
        radiance = self._trace(origin, direction, seed, paths)
        return radiance, self._follow_smooth(origin, direction, stream)[0]

    def max_radiance(self, pixel: float, config: MaxRadianceConfig) -> float:
        """99.99th percentile of radiance over the pixels of views all around.

        If that is 0, the radiance of the brightest pixel: all light is from a small part.

        The rays of a tile average to a pixel; views also hold pixels beside the box, which rays do
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

    def _wanted_rays(self, count: int, stream: SeedStream, wanted: Wanted) -> tuple[Any, Any]:
        origin, direction = self.random_rays(count, stream)
        chosen = dr.compress(wanted(origin, direction))
        origin = dr.gather(mi.Point3f, origin, chosen)
        direction = dr.gather(mi.Vector3f, direction, chosen)
        dr.eval(origin, direction)
        return origin, direction

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
        """Transmittance of rays, and radiance seen through smooth transmission alone."""
        self._sampler.seed(stream.seed(self._seed, _Part.STRAIGHT_THROUGH), dr.width(origin))
        ray = self._world_ray(origin, direction)
        found = straight_through(self.luminaire.scene, self._sampler, ray, PATH_DEPTH)
        dr.eval(found)
        return found

    def _world_ray(self, origin: Any, direction: Any) -> Any:
        # From outside the bounding sphere, so that nothing is missed.
        back = dr.dot(direction, origin) + self._tiles.reach
        outside = mi.Point3f(origin - back * direction)
        return mi.Ray3f(self._to_world @ outside, dr.normalize(self._to_world @ direction))


def _join(first: Any, second: Any) -> Any:
    return type(first)(*(dr.concat(values) for values in zip(first, second, strict=True)))
