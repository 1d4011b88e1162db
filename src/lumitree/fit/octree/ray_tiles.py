"""Random rays through a box, in tiles of parallel neighbours that are spread evenly.

Neighbouring rays traverse the same part of an octree, which a vector unit does together.
"""

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.fit.octree.config import TILE_RAYS, TILE_SIDE

# Steps of Roberts' R sequence in six dimensions, in 2^-32: powers of 1/g, where g^7 = g + 1.
_LATTICE_STEPS = [round(2**32 * 1.1127756842787055**-power) for power in range(1, 7)]


class RayTiles:
    """Uniform rays through the proxy box of half extents [3], local units.

    `spacing` is the distance of neighbouring rays of a tile, local units.
    """

    def __init__(self, half_extents: NDArray[np.float64], spacing: float) -> None:
        self._spacing = spacing
        # The middles of tiles pass through a box that is larger by half a tile's diagonal. Drawn
        # through the proxy itself, its rim would get fewer rays than its centre.
        self._half = half_extents + TILE_SIDE / math.sqrt(2) * spacing
        # No ray's origin is farther from the centre of the box than this.
        self.reach = 1.01 * float(np.linalg.norm(self._half)) + TILE_SIDE * spacing

    @property
    def measure(self) -> float:
        """Integral of dA cos(theta) domega over all rays that `draw` chooses from, local units² sr.

        Of all rays through the enlarged box: pi times its surface.
        """
        x, y, z = self._half
        return float(np.pi * 8 * (x * y + y * z + z * x))

    def draw(self, count: int, tile_seed: int, sampler: Any) -> tuple[Any, Any]:
        """Random rays: origins (mi.Point3f) and directions (mi.Vector3f) in the local frame.

        Rays of a tile are parallel, `spacing` apart and jittered. Those that meet the proxy are
        uniform; some miss it.

        Args:
            count: number of rays, a multiple of `TILE_RAYS`.
            tile_seed: of the positions, directions and rotations of the tiles.
            sampler: mi.Sampler, seeded for `count` rays, for the jitter.
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

    def _tiles(self, count: int, seed: int) -> tuple[Any, Any, Any, Any]:
        """Centre, direction and both axes of `count` tiles (mi.Vector3f)."""
        face, turn, *places = _lattice(count, seed)
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
        return centre, direction, right, up


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


def _on_axis(axis: Any, a: Any, b: Any, n: Any) -> Any:
    """mi.Vector3f whose component along `axis` is n, and a and b the two that follow it."""
    return mi.Vector3f(
        dr.select(axis == 0, n, dr.select(axis == 1, b, a)),
        dr.select(axis == 0, a, dr.select(axis == 1, n, b)),
        dr.select(axis == 0, b, dr.select(axis == 1, a, n)),
    )
