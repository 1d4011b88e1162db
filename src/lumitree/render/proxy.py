"""Sampling directions towards a proxy, in the luminaire's local frame.

Both proxies are sampled from outside only (decision D10): from a point inside, nothing is.

Symbols
    h       half extents of the box
    p, n    point on the proxy and its outward normal
    pdf     density per solid angle; the same in world and local frame, since similarities
            keep angles
"""

from typing import Any, Literal, get_args

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

ProxyKind = Literal["box", "sphere"]
PROXY_KINDS: tuple[ProxyKind, ...] = get_args(ProxyKind)


class BoxProxy:
    """The bounding box; its visible faces are sampled uniformly by area."""

    def __init__(self, half_extents: NDArray[np.float64]) -> None:
        self.half = mi.Vector3f(*half_extents.tolist())
        self.shape = {"type": "cube"}
        self.shape_scale = half_extents

    def _visible_areas(self, origin: Any) -> Any:
        h = self.half
        areas = 4 * mi.Vector3f(h.y * h.z, h.x * h.z, h.x * h.y)
        return dr.select(dr.abs(origin) > h, areas, 0)

    def sample(self, origin: Any, sample: Any) -> tuple[Any, Any, Any, Any]:
        """Point p, normal n, direction from `origin` and pdf for a sample in the unit square."""
        areas = self._visible_areas(origin)
        total = dr.sum(areas)
        scaled = sample.x * total
        choose_x = scaled < areas.x
        choose_y = ~choose_x & (scaled < areas.x + areas.y)
        axis = dr.select(choose_x, mi.UInt32(0), dr.select(choose_y, mi.UInt32(1), 2))
        start = dr.select(choose_x, 0, dr.select(choose_y, areas.x, areas.x + areas.y))
        area = dr.select(choose_x, areas.x, dr.select(choose_y, areas.y, areas.z))
        u = 2 * dr.clip((scaled - start) / area, 0, 1) - 1
        v = 2 * sample.y - 1
        unit = mi.Vector3f(
            dr.select(choose_x, 1, u),
            dr.select(axis == 1, 1, dr.select(choose_x, u, v)),
            dr.select(axis == 2, 1, v),
        )
        on_axis = mi.Vector3f(axis == 0, axis == 1, axis == 2)
        side = dr.select(on_axis > 0, dr.sign(origin), 1)
        p = mi.Point3f(unit * self.half * side)
        return p, on_axis * side, *self._direction(origin, p, on_axis, total)

    def _direction(self, origin: Any, p: Any, on_axis: Any, total: Any) -> tuple[Any, Any]:
        offset = p - origin
        distance_squared = dr.squared_norm(offset)
        direction = offset * dr.rsqrt(distance_squared)
        cosine = dr.abs(dr.dot(direction, on_axis))
        valid = (total > 0) & (cosine > 0)
        return direction, dr.select(valid, distance_squared / (cosine * total), 0)

    def pdf(self, origin: Any, direction: Any) -> Any:
        """Density with which `sample` gives `direction` from `origin`."""
        areas = self._visible_areas(origin)
        inverse = dr.rcp(direction)
        first, second = (-self.half - origin) * inverse, (self.half - origin) * inverse
        near = dr.select(direction == 0, -dr.inf, dr.minimum(first, second))
        far = dr.select(direction == 0, dr.inf, dr.maximum(first, second))
        beside = (direction == 0) & (dr.abs(origin) > self.half)
        t = dr.max(near)
        hit = (t > 0) & (t <= dr.min(far)) & ~dr.any(beside)
        cosine = dr.max(dr.select(near == t, dr.abs(direction), 0))
        total = dr.sum(areas)
        return dr.select(hit & (total > 0), t * t / (cosine * total), 0)


class SphereProxy:
    """The sphere through the box's corners; the visible cone is sampled uniformly."""

    def __init__(self, half_extents: NDArray[np.float64]) -> None:
        self.radius = float(np.linalg.norm(half_extents))
        self.shape = {"type": "sphere"}
        self.shape_scale = np.full(3, self.radius)

    def _cone(self, origin: Any) -> tuple[Any, Any, Any]:
        """Distance of the centre, 1 - cosine of the cone's half angle, and whether outside."""
        distance = dr.norm(mi.Vector3f(origin))
        sine_squared = dr.square(self.radius / distance)
        outside = sine_squared < 1
        cosine = dr.safe_sqrt(1 - sine_squared)
        # 1 - cos without the cancellation that a distant, small sphere would suffer.
        return distance, sine_squared / (1 + cosine), outside

    def sample(self, origin: Any, sample: Any) -> tuple[Any, Any, Any, Any]:
        """Point p, normal n, direction from `origin` and pdf for a sample in the unit square."""
        distance, cap, outside = self._cone(origin)
        one_minus_cos = cap * sample.x
        sine_squared = one_minus_cos * (2 - one_minus_cos)
        sine, cosine = dr.safe_sqrt(sine_squared), 1 - one_minus_cos
        azimuth_sine, azimuth_cosine = dr.sincos(dr.two_pi * sample.y)
        frame = mi.Frame3f(-mi.Vector3f(origin) / distance)
        direction = frame.to_world(mi.Vector3f(sine * azimuth_cosine, sine * azimuth_sine, cosine))
        chord = dr.safe_sqrt(self.radius**2 - dr.square(distance) * sine_squared)
        p = origin + direction * (distance * cosine - chord)
        n = dr.normalize(mi.Vector3f(p))
        p = mi.Point3f(n * self.radius)
        return p, n, direction, dr.select(outside, dr.rcp(dr.two_pi * cap), 0)

    def pdf(self, origin: Any, direction: Any) -> Any:
        """Density with which `sample` gives `direction` from `origin`."""
        _, cap, outside = self._cone(origin)
        along = -dr.dot(mi.Vector3f(origin), direction)
        off_axis = dr.squared_norm(mi.Vector3f(origin) + along * direction)
        hit = outside & (along > 0) & (off_axis < self.radius**2)
        return dr.select(hit, dr.rcp(dr.two_pi * cap), 0)


Proxy = BoxProxy | SphereProxy


def make_proxy(kind: ProxyKind, half_extents: NDArray[np.float64]) -> Proxy:
    """Proxy of the given kind around the box with `half_extents` [3], local units."""
    return BoxProxy(half_extents) if kind == "box" else SphereProxy(half_extents)
