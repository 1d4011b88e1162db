"""Direct illuminance by baked lamps, differentiable by their poses and brightness.

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
from numpy.typing import ArrayLike, NDArray

from lumitree.core.arguments import check_count
from lumitree.core.backend import in_turn
from lumitree.core.device import parameter
from lumitree.core.photometry import LUMA, LUMENS_PER_WATT
from lumitree.core.seeds import Purpose, SeedStream, check_seed
from lumitree.errors import LumitreeError
from lumitree.measure.illuminance_estimate import receivers
from lumitree.measure.receivers import given_points
from lumitree.rendering.emitter import PlacedLamp, lamps_of

_Array = NDArray[np.float64]
# Moves along x, y and z, and turns about them.
_AXES = 6
_MAX_SAMPLES = 1 << 10


@in_turn
def direct_illuminance(
    scene: mi.Scene, points: ArrayLike, normals: ArrayLike, *, samples: int = 16, seed: int = 0
) -> mi.Float:
    """Direct illuminance of points by the baked lamps of a scene, differentiable by Dr.Jit.

    It is the direct part of `illuminance` for lamps, without shadows: the light of all cells of
    each light field, straight or bent. Its derivatives are by the parameters of lamps that
    `mitsuba.traverse` lists, the pose among them. Other emitters do not count, nor do lamps for
    points inside their boxes.

    Args:
        scene: with lamps, as `lumitree.shape` makes them.
        points: [N, 3], scene coordinates.
        normals: [N, 3] or [3] normals of the points, of any length.
        samples: random points of each cell, for each receiver, 1 to 1,024.
        seed: of these points, 0 to 2³¹ - 1; equal seeds have equal ones, so that differences are
            smooth.

    Returns:
        Illuminance [N], lx.

    Raises:
        LumitreeError: an argument is out of range, or a lamp has no light field.
    """
    check_count("samples", samples, 1, _MAX_SAMPLES)
    position, normal = given_points(points, normals)
    total = dr.zeros(mi.Float, len(position))
    for number, lamp in lamps_of(scene.emitters()).items():
        part = SeedStream(Purpose.DESIGN, draw=3).seed(check_seed(seed), number)
        total += direct_lux(lamp.moving or lamp, position, normal, samples, part)
    return total


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
    random = mi.PCG32(dr.width(si.p), parameter(mi.UInt64, seed))
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
    """Derivative [N] of `direct_lux` by a step along, or about, an axis of a lamp at a place."""
    step = [mi.Float(0) for _ in range(_AXES)]
    dr.enable_grad(step[axis])
    lux = direct_lux(moved(lamp, centre, turn, step), points, normals, samples, seed)
    dr.forward(step[axis])
    return np.array(dr.grad(lux), np.float64)
