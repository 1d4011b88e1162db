"""Direct illuminance by baked lamps, differentiable by their poses and gains.

The irradiance of a point is a sum over the cells of each lamp's light field (`DeviceLight`), which
Dr.Jit differentiates. Straight and bent light are both in it. Shadows are not: neither is light
blocked, nor has a shadow that moves with its lamp a derivative.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.photometry import LUMA, LUMENS_PER_WATT
from lumitree.errors import LumitreeError
from lumitree.measure.illuminance_estimate import receivers
from lumitree.rendering.emitter import PlacedLamp

_Array = NDArray[np.float64]
# Moves along x, y and z, and turns about them.
AXES = 6


def direct_lux(
    lamp: PlacedLamp, points: _Array, normals: _Array, samples: int, seed: int
) -> mi.Float:
    """Direct illuminance [N] by one lamp without shadows, lx; 0 inside of its box.

    Args:
        points, normals: [N, 3].
        samples: random points of each cell, for each receiver.
        seed: of their random numbers.
    """
    if lamp.light is None:
        raise LumitreeError("a lamp has no light field; bake it again")
    si = receivers(points, normals, samples)
    x, normal = lamp.local_line(si.p, mi.Vector3f(si.n))
    random = mi.PCG32(dr.width(si.p), seed)
    outside = ~lamp.in_box(dr.detach(x))
    found = lamp.factor * lamp.light.irradiance(x, normal, random, outside)
    lux = sum((weight * each for weight, each in zip(LUMA, found, strict=True)), mi.Float(0))
    return LUMENS_PER_WATT / samples * dr.block_sum(lux, samples)


def moved(
    lamp: PlacedLamp, centre: _Array, turn: _Array, step: Sequence[mi.Float] | None = None
) -> PlacedLamp:
    """The lamp at another place.

    Args:
        centre: [3] of its box, scene.
        turn: [3, 3] rotation from the axes that it was placed with.
        step: [6] moves, and turns about the axes of the scene, of length 0, with derivatives.
    """
    scale, dimming = lamp.numbers[[0, -1]].tolist()
    axes = turn @ lamp.numbers[4:13].reshape(3, 3)
    numbers = [mi.Float(each) for each in (scale, *centre.tolist(), *axes.ravel().tolist())]
    dr.make_opaque(numbers)
    if step is not None:
        rotation, small = mi.Matrix3f(*numbers[4:]), mi.Vector3f(*step[3:])
        numbers[1:4] = [number + each for number, each in zip(numbers[1:4], step[:3], strict=True)]
        columns = [mi.Vector3f(*(rotation[i, j] for i in range(3))) for j in range(3)]
        columns = [column + dr.cross(small, column) for column in columns]
        numbers[4:] = [columns[j][i] for i in range(3) for j in range(3)]
    other = copy.copy(lamp)
    other._move([*numbers, mi.Float(dimming)])
    return other


def slope(
    lamp: PlacedLamp,
    centre: _Array,
    turn: _Array,
    axis: int,
    points: _Array,
    normals: _Array,
    samples: int,
    seed: int,
) -> _Array:
    """Derivative [N] of `direct_lux`, by a move or a turn of `AXES` of a lamp that is `moved`."""
    step = [mi.Float(0) for _ in range(AXES)]
    dr.enable_grad(step[axis])
    lux = direct_lux(moved(lamp, centre, turn, step), points, normals, samples, seed)
    dr.forward(step[axis])
    return np.array(dr.grad(lux), np.float64)
