"""Sampling: use of random samples in more than one place, weights of MIS, and the proxy, a box.

The proxy is sampled from outside only: from a point inside, nothing is.

Symbols
    h       half extents of the box
    pdf     density per solid angle; the same in world and local frame, since similarities
            keep angles
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import parameter
from lumitree.lamp.emitting_surfaces import four_numbers

_PARALLEL = 1e-12
# Least cosine by which candidates are weighted: a BSDF may have another normal.
_LEAST = 0.1
# Part of the samples that is taken uniformly.
UNIFORM_FRACTION = 0.1
# Kind of a target: bent light (or all) for receivers outside the box or inside; or straight light.
OUTSIDE, INSIDE, STRAIGHT = range(3)


@dataclass
class Target:
    """The point in a lamp that a sampled direction leads to (a PyTree of Dr.Jit).

    The distance is -inf where a sampler returns directions alone; it sets no other attribute.

    Attributes:
        distance: of the point from the receiver, local units.
        cell: index of the cell of the point: of the light field, of the light inside, or, for
            straight light, of the cluster of emitters.
        pmf: probability with which this cell is sampled.
        place: `OUTSIDE`, `INSIDE` or `STRAIGHT`.
        bins: bin of the cell towards the receiver.
        factor: on the point's light: it makes the chosen point stand for all candidates.
        light: straight light of the point, over the density with which it is sampled.
        total: estimate of the light of all points that the receiver may get, for the choice between
            bent and straight light.
        density: of the point of straight light, per steradian, for multiple importance sampling.
    """

    distance: mi.Float
    cell: mi.UInt32
    pmf: mi.Float
    place: mi.UInt32
    bins: mi.UInt32
    factor: mi.Float
    light: mi.Color3f
    total: mi.Float
    density: mi.Float

    @classmethod
    def at(cls, distance: mi.Float) -> Target:
        """Target at a distance, of a sampler that does not sample cells."""
        none, no = mi.UInt32(0), mi.Float(0)
        factor = mi.Float(1)
        return cls(distance, none, no, mi.UInt32(OUTSIDE), none, factor, mi.Color3f(0), no, no)


def divide_sample(sample: mi.Float, fraction: mi.Float | float) -> tuple[mi.Bool, mi.Float]:
    """Whether a sample in [0, 1) is below `fraction`, and a sample in [0, 1) for either case."""
    below = sample < fraction
    rest = dr.select(below, sample / fraction, (sample - fraction) / (1 - fraction))
    return below, dr.clip(rest, 0, dr.one_minus_epsilon(mi.Float))


def scrambled(sample: mi.Point2f) -> mi.Point3f:
    """The first three of `four_numbers`."""
    return mi.Point3f(*four_numbers(sample)[:3])


def cosine_weight(normal: mi.Vector3f, offset: mi.Vector3f, behind: float = _LEAST) -> mi.Float:
    """Cosine at a receiver for the choice among candidates; `behind` for those behind its surface.

    The normal is towards the side that light comes from; 0 where it may come from both.
    """
    cosine = dr.dot(normal, offset) * dr.rsqrt(dr.squared_norm(offset))
    return dr.select(cosine < 0, behind, dr.maximum(cosine, _LEAST))


# Dr.Jit variables that a `Reservoir` keeps together.
Candidate = tuple[Any, ...]


@dataclass
class Reservoir:
    """Resampled importance sampling (Talbot et al. 2005) of candidates (a PyTree of Dr.Jit).

    Candidates come from a table. One is kept, in proportion to its weight: the light that it is
    estimated to send, over the probability with which the table returns it.

    Attributes:
        place: number in [0, 1) for the table. Candidates share it, moved by equal steps.
        step: 1 over the number of candidates.
        choice: number in [0, 1) for the choice among candidates.
        kept: the candidate that is kept, a tuple.
        weight: of the candidate that is kept; 0 where no candidate sends light.
        total: weight of all candidates so far.
    """

    place: mi.Float
    step: mi.Float
    choice: mi.Float
    kept: Candidate
    weight: mi.Float
    total: mi.Float

    @classmethod
    def start(
        cls, place: mi.Float, count: int | mi.UInt32, choice: mi.Float, kept: Candidate
    ) -> Reservoir:
        """Before the first candidate; `kept` is returned where no candidate sends light."""
        step = dr.rcp(mi.Float(count))
        return cls(mi.Float(place), step, mi.Float(choice), kept, mi.Float(0), mi.Float(0))

    def add(self, weight: mi.Float, candidate: Candidate) -> None:
        """Add a candidate, and move `place` for the next one."""
        self.total += weight
        fraction = dr.select(self.total > 0, weight / self.total, 0)
        taken, self.choice = divide_sample(self.choice, fraction)
        self.kept = dr.select(taken, candidate, self.kept)
        self.weight = dr.select(taken, weight, self.weight)
        self.place += self.step
        self.place = dr.select(self.place < 1, self.place, self.place - 1)

    @property
    def mean(self) -> mi.Float:
        """Mean weight, an estimate of all light that candidates stand for."""
        return self.total * self.step

    @property
    def factor(self) -> mi.Float:
        """Factor on the light of the candidate that is kept, which then stands for all light."""
        return dr.select(self.weight > 0, self.mean / self.weight, 0)


def sample_row(
    cumulated: mi.Float, first: mi.UInt32, count: int, sample: mi.Float, active: mi.Bool | bool
) -> mi.UInt32:
    """Index, from 0, of a sample in [0, 1) in one row of a table of cumulated probabilities."""

    # The search is over the next power of two, so that rows of similar lengths share a kernel.
    length, bound = parameter(mi.UInt32, count), 1 << (count - 1).bit_length()

    def below(index):
        inside = active & (index < length)
        return inside & (dr.gather(mi.Float, cumulated, first + index, inside) <= sample)

    return dr.minimum(dr.binary_search(0, bound - 1, below), length - 1)


def mis_weight(pdf: mi.Float, other_pdf: mi.Float) -> mi.Float:
    """Power heuristic; 0 where neither density is positive, as in `path`."""
    weight = dr.square(pdf) / (dr.square(pdf) + dr.square(other_pdf))
    return dr.select(dr.isfinite(weight), weight, 0)


class BoxProxy:
    """The bounding box; its visible faces are sampled uniformly by area."""

    def __init__(self, half_extents: NDArray[np.float64]) -> None:
        self.half = parameter(mi.Vector3f, *half_extents.tolist())

    def _visible_areas(self, origin: mi.Point3f) -> mi.Vector3f:
        return dr.select(dr.abs(origin) > self.half, face_areas(self.half), 0)

    def sample(self, origin: mi.Point3f, sample: mi.Point2f) -> mi.Vector3f:
        """Direction from `origin` for a sample in the unit square; valid where `pdf` is not 0."""
        p = point_on_box(self.half, self._visible_areas(origin), origin, sample)
        return dr.normalize(p - origin)

    def enter(
        self, origin: mi.Point3f, direction: mi.Vector3f
    ) -> tuple[mi.Float, mi.Vector3f, mi.Bool]:
        """Distance and outward normal where a line enters from outside, and whether it does."""
        near, far = slab(-mi.Vector3f(origin), self.half, safe_inverse(direction))
        distance = dr.max(near)
        normal = dr.select(near == distance, -dr.sign(direction), 0)
        return distance, dr.normalize(normal), (distance > 0) & (distance <= dr.min(far))

    def pdf(self, origin: mi.Point3f, direction: mi.Vector3f) -> mi.Float:
        """Density with which `sample` gives `direction` from `origin`."""
        distance, normal, hit = self.enter(origin, direction)
        cosine = -dr.dot(normal, direction)
        total = dr.sum(self._visible_areas(origin))
        return dr.select(hit & (total > 0), dr.square(distance) / (cosine * total), 0)


def sample_cone(origin: mi.Point3f, radius: mi.Float, sample: mi.Point2f) -> mi.Vector3f:
    """Direction towards the sphere of this radius about the centre, uniform over its solid angle.

    From a point inside the sphere all directions are towards it.
    """
    axis = -mi.Vector3f(origin)
    one_minus_cos = _cap(origin, radius) * sample.x
    sine, cosine = dr.safe_sqrt(one_minus_cos * (2 - one_minus_cos)), 1 - one_minus_cos
    azimuth_sine, azimuth_cosine = dr.sincos(dr.two_pi * sample.y)
    frame = mi.Frame3f(dr.normalize(axis))
    return frame.to_world(mi.Vector3f(sine * azimuth_cosine, sine * azimuth_sine, cosine))


def cone_pdf(origin: mi.Point3f, radius: float | mi.Float) -> mi.Float:
    """Density of `sample_cone`, the same for all of its directions."""
    return dr.rcp(dr.two_pi * _cap(origin, radius))


def _cap(origin, radius):
    """1 - cosine of the half angle that a sphere subtends; 2 from inside."""
    sine_squared = radius**2 / dr.squared_norm(mi.Vector3f(origin))
    # Written so that a distant, small sphere does not suffer from cancellation.
    cap = sine_squared / (1 + dr.safe_sqrt(1 - sine_squared))
    return dr.select(sine_squared < 1, cap, 2)


def face_areas(half: mi.Vector3f) -> mi.Vector3f:
    """Area [3] of a face of a box with half extents `half`, by the axis it is perpendicular to."""
    return 4 * mi.Vector3f(half.y * half.z, half.x * half.z, half.x * half.y)


def point_on_box(
    half: mi.Vector3f, weights: mi.Vector3f, towards: mi.Vector3f | mi.Point3f, sample: mi.Point2f
) -> mi.Vector3f:
    """Point on the faces of a box at the origin that look `towards` a direction or point.

    A face is chosen in proportion to the weight [3] of its axis, and a point uniformly on it.
    """
    scaled = sample.x * dr.sum(weights)
    on_x = scaled < weights.x
    on_y = ~on_x & (scaled < weights.x + weights.y)
    on_z = ~on_x & ~on_y
    start = dr.select(on_x, 0, dr.select(on_y, weights.x, weights.x + weights.y))
    weight = dr.select(on_x, weights.x, dr.select(on_y, weights.y, weights.z))
    u = 2 * dr.clip((scaled - start) / weight, 0, 1) - 1
    v = 2 * sample.y - 1
    unit = mi.Vector3f(
        dr.select(on_x, dr.sign(towards.x), u),
        dr.select(on_y, dr.sign(towards.y), dr.select(on_x, u, v)),
        dr.select(on_z, dr.sign(towards.z), v),
    )
    return unit * half


def safe_inverse(direction: mi.Vector3f) -> mi.Vector3f:
    """1 / direction by component, finite for lines parallel to an axis."""
    return dr.rcp(dr.select(dr.abs(direction) < _PARALLEL, _PARALLEL, direction))


def slab(
    delta: mi.Vector3f, half: mi.Vector3f, inverse_direction: mi.Vector3f
) -> tuple[mi.Vector3f, mi.Vector3f]:
    """Distances [3], [3] at which a line crosses the planes of a box with its centre at `delta`."""
    middle, reach = delta * inverse_direction, half * dr.abs(inverse_direction)
    return middle - reach, middle + reach
