"""Inverse-square test: from which distance a luminaire is its far field.

A photometric file describes a point. Near a luminaire the illuminance differs from intensity /
distance². The test measures the illuminance on spheres about the centre of the luminous opening, in
cones of 5 degrees about some directions, by the rays with which the intensity is measured.

Symbols
    D       largest side of the luminous opening, m
    d       distance from the centre of the opening, m
    E       mean illuminance, lx, of the part of a sphere of radius d that is in a cone
    I       mean luminous intensity, cd, in that cone
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.formats.type_c import direction_of
from lumitree.measure.batches import jackknife_error

# Radii of the spheres over D. The smallest sphere contains the opening, whose half diagonal is at
# most 0.87 D; rays that start outside of a sphere count where they leave it.
DISTANCES = np.array([1, 1.25, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 15, 20, 30])
# Largest relative difference that counts as the far field.
TOLERANCE = 0.05
# Name, C and γ of the directions; the direction of the largest intensity is added.
DIRECTIONS = (
    ("down", 0.0, 0.0),
    ("45° below, C0", 0.0, 45.0),
    ("45° below, C90", 90.0, 45.0),
    ("45° below, C180", 180.0, 45.0),
    ("45° below, C270", 270.0, 45.0),
    ("horizontal, C0", 0.0, 90.0),
    ("horizontal, C90", 90.0, 90.0),
    ("horizontal, C180", 180.0, 90.0),
    ("horizontal, C270", 270.0, 90.0),
    ("up", 0.0, 180.0),
)
_COSINE_OF_CONE = np.cos(np.deg2rad(5.0))
_SINE_OF_CONE = np.sin(np.deg2rad(5.0))
_SOLID_ANGLE = 2 * np.pi * (1 - _COSINE_OF_CONE)
# A difference that is less certain is not reported.
MAX_ERROR = TOLERANCE / 2


@dataclasses.dataclass(frozen=True)
class NearFieldLimit:
    """Distance from which a luminaire is its far field, in one direction.

    Attributes:
        direction: name of the direction.
        c, gamma: its angles, degrees.
        candela: mean luminous intensity in a cone of 5 degrees about it, cd.
        distance: distance from the centre of the opening, m, from which on the illuminance is
            within 5 % of intensity / distance². None if it is not at 30 times the largest side, or
            if that is not known.
        is_known: False if too few rays go there to tell.
        difference: relative difference of the illuminance from intensity / distance² at five times
            the largest side; None if no ray goes there.
        difference_error: standard error of `difference`.
    """

    direction: str
    c: float
    gamma: float
    candela: float
    distance: float | None
    is_known: bool
    difference: float | None
    difference_error: float | None


class NearFieldTest:
    """Sums over the rays of each batch.

    Args:
        size: D, m.
        brightest: C and γ of the largest intensity, degrees.
    """

    def __init__(self, size: float, brightest: tuple[float, float], batches: int) -> None:
        self._size = size
        self._directions = (*DIRECTIONS, ("towards the largest intensity", *brightest))
        self._axes = np.array([direction_of(c, gamma) for _, c, gamma in self._directions])
        # Flux of each batch in each cone: of the far field, and through each sphere.
        self._batches = np.zeros((batches, 1 + len(DISTANCES), len(self._directions)))

    def add(
        self,
        batch: int,
        origin: NDArray[np.float64],
        direction: NDArray[np.float64],
        lumens: NDArray[np.float64],
    ) -> None:
        """Add rays to a batch.

        Args:
            origin: [N, 3] where the rays start, relative to the centre of the opening, m.
            direction: [N, 3] unit directions of travel.
            lumens: [N] luminous flux of each.
        """
        along = (origin * direction).sum(axis=1)
        beyond = along**2 - (origin**2).sum(axis=1)
        # Distance of the centre of the opening from the line of each ray.
        line_distance = np.sqrt(np.maximum(-beyond, 0))
        nearest = (self._axes @ direction.T).max(axis=0)
        sums = [self._in_cones(direction, lumens)]
        for radius in DISTANCES * self._size:
            half_chord = np.sqrt(np.maximum(beyond + radius**2, 0))
            # Seen from the centre, a ray leaves the sphere at an angle α to the ray's direction,
            # sin α = line_distance / radius. So only rays within α + 5° of an axis may leave in the
            # cone about this axis.
            least = (_COSINE_OF_CONE * half_chord - _SINE_OF_CONE * line_distance) / radius
            distance = half_chord - along
            crosses = (half_chord > 0) & (distance > 0)
            used = np.flatnonzero(crosses & (nearest > least - 1e-5))
            point = origin[used] + distance[used, None] * direction[used]
            sums.append(self._in_cones(point / radius, lumens[used]))
        self._batches[batch] += sums

    def limits(self) -> list[NearFieldLimit]:
        """Result for each direction."""
        batches = self._batches
        difference, error = self.differences()
        five = int(np.flatnonzero(DISTANCES == 5)[0])
        limits = []
        for index, (name, c, gamma) in enumerate(self._directions):
            distance, known = self._limit(difference[:, index], error[:, index])
            lit = bool(np.isfinite(difference[five, index]))
            limits.append(
                NearFieldLimit(
                    direction=name,
                    c=c,
                    gamma=gamma,
                    candela=float(batches[:, 0, index].mean() / _SOLID_ANGLE),
                    distance=distance,
                    is_known=known,
                    difference=float(difference[five, index]) if lit else None,
                    difference_error=float(error[five, index]) if lit else None,
                )
            )
        return limits

    def differences(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """E d² / I - 1 and standard errors (jackknife), by distance and direction.

        NaN where no ray leaves in a cone.
        """
        batches = self._batches
        total = batches.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            value = total[1:] / total[0] - 1
            rest = total - batches
            return value, jackknife_error(rest[:, 1:] / rest[:, :1] - 1)

    def _limit(
        self, difference: NDArray[np.float64], error: NDArray[np.float64]
    ) -> tuple[float | None, bool]:
        """`distance` and `is_known` of a `NearFieldLimit`."""
        if not (np.isfinite(difference).all() and np.isfinite(error).all()):
            return None, False
        outside = np.flatnonzero(np.abs(difference) > TOLERANCE)
        last = int(outside[-1]) if len(outside) else -1
        # The errors at the two spheres between which the difference becomes small.
        if (error[max(last, 0) : last + 2] > MAX_ERROR).any():
            return None, False
        if last < 0:
            return float(DISTANCES[0] * self._size), True
        if last + 1 == len(DISTANCES):
            return None, True
        # Between two spheres, linear in the logarithm of the distance.
        first, second = np.abs(difference[last : last + 2])
        share = (first - TOLERANCE) / (first - second)
        ratio = DISTANCES[last + 1] / DISTANCES[last]
        return float(DISTANCES[last] * ratio**share * self._size), True

    def _in_cones(
        self, points: NDArray[np.float64], lumens: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Flux in each cone, of points on the unit sphere."""
        cosines = points.astype(np.float32) @ self._axes.T.astype(np.float32)
        rays, cones = np.nonzero(cosines >= _COSINE_OF_CONE)
        return np.bincount(cones, lumens[rays], len(self._axes)).astype(np.float64)
