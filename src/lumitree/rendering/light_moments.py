"""Radiance of a light field with derivatives by the line, for integrators that fix directions.

With the direction fixed, the radiance of small cells changes from ray to ray by far more than the
light of the lamp does, and a ray that grazes a face of a cell has any derivative. So the light of
each bin of direction starts in the whole box instead, with a smooth density of equal moments up to
degree two: irradiances at distances r (local units) differ by the order of 1 / r³.

Symbols
    R       bins of direction a side
    y       place in the box, in coordinates of [-1, 1]³
    w       weight Π 3/4 (1 - y²), under which 1, y, y² - 1/5 and products of two coordinates are
            orthogonal; the means of their squares are 1, 1/5, 8/175 and 1/25
    ρ       density: w times the sum of these polynomials, each times its mean over the light of the
            bin, over the mean of its square
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import LightField, unpack
from lumitree.core.device import on_device, parameter
from lumitree.octree.build import grid_boxes_inside
from lumitree.rendering.device_light import bins_around
from lumitree.rendering.sampling import safe_inverse, slab

# Packets of four numbers of a bin: R, G, B and the coefficients of the nine polynomials.
_PACKETS = 3
# Points along a line: exact for the polynomial of degree 8.
_NODES, _WEIGHTS = (each.tolist() for each in np.polynomial.legendre.leggauss(5))


class LightMoments:
    """The light of a light field by bin, with its moments in the box.

    Args:
        factors: [3] factors on R, G and B.
    """

    def __init__(
        self, field: LightField, half_extents: NDArray[np.float64], factors: tuple[float, ...]
    ) -> None:
        lower, upper = grid_boxes_inside(half_extents, field.cells, field.depth)
        middle = (lower + upper) / (2 * half_extents)
        spread = ((upper - lower) / (2 * half_extents)) ** 2 / 3
        pairs = middle * np.roll(middle, -1, axis=1)
        means = np.concatenate([middle, middle**2 + spread - 1 / 5, pairs], axis=1)
        light = field.dense(unpack(field.intensity).astype(np.float32))
        rows = np.zeros((field.resolution**2, 4 * _PACKETS))
        rows[:, :3] = light.sum(axis=0) * (field.scale * np.array(factors))
        by_bin = light.sum(axis=2)
        sums = (by_bin.T @ means) / np.maximum(by_bin.sum(axis=0), 1e-30)[:, None]
        rows[:, 3:] = sums * np.repeat([5, 175 / 8, 25], 3)
        self._resolution, self._rows = field.resolution, on_device(mi.Float, rows)
        self._half = parameter(mi.Vector3f, *half_extents.tolist())

    def radiance(
        self, origin: mi.Point3f, direction: mi.Vector3f, active: mi.Bool | bool = True
    ) -> mi.Color3f:
        """Radiance along a line of the local frame, linear between the middles of bins."""
        o, d = mi.Vector3f(origin), direction
        near, far = slab(-dr.detach(o), self._half, safe_inverse(dr.detach(d)))
        # ρ is 0 at the box: its ends need no derivatives.
        start, length = dr.max(near), dr.maximum(dr.min(far) - dr.max(near), 0)
        points = [
            ((o + (start + length * ((1 + node) / 2)) * d) / self._half, weight)
            for node, weight in zip(_NODES, _WEIGHTS, strict=True)
        ]
        total = mi.Color3f(0)
        for index, weight in bins_around(-d, self._resolution):
            packets = [
                dr.gather(mi.Vector4f, self._rows, _PACKETS * index + i, active)
                for i in range(_PACKETS)
            ]
            red, green, blue, *means = (number for packet in packets for number in packet)
            first, squares, pairs = (mi.Vector3f(*means[i : i + 3]) for i in (0, 3, 6))
            density = mi.Float(0)
            for y, part in points:
                w = dr.prod(0.75 * (1 - y * y))
                following = mi.Vector3f(y.y, y.z, y.x)
                series = 1 + dr.dot(first, y) + dr.dot(squares, y * y - 1 / 5)
                density += part / 2 * w * (series + dr.dot(pairs, y * following))
            density *= length * dr.rcp(dr.prod(self._half))
            total += weight * density * mi.Color3f(red, green, blue)
        return dr.select(active, total, 0)
