"""Places of parts in a lamp: transforms `lamp_from_part` [4, 4]."""

import numpy as np
from numpy.typing import ArrayLike

from lumitree.core.frames import rotation, similarity
from lumitree.lamp.meshes import Floats


def at(
    x: float = 0.0, y: float = 0.0, z: float = 0.0, *, turn: float = 0.0, scale: float = 1.0
) -> Floats:
    """Place [4, 4] at a point, metres, turned about y by `turn` degrees."""
    return similarity(rotation([0, 1, 0], turn), scale, [x, y, z])


def around(count: int, radius: float = 0.0, y: float = 0.0, first: float = 0.0) -> list[Floats]:
    """Places [4, 4] evenly on a horizontal circle about the y axis, with +x away from the axis.

    `first` is the azimuth of the first place, degrees, 0 at +x; lengths are in metres.
    """
    return [at(turn=first + 360 * i / count) @ at(radius, y) for i in range(count)]


def aimed(axis: ArrayLike, point: ArrayLike) -> Floats:
    """Place [4, 4] at a point [3], with +y turned the shortest way to `axis` [3]."""
    axis = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    pivot = np.cross([0.0, 1.0, 0.0], axis)
    length = float(np.linalg.norm(pivot))
    angle = np.degrees(np.arctan2(length, axis[1]))
    turn = rotation(pivot if length > 1e-9 else [1.0, 0.0, 0.0], angle)
    return similarity(turn, translation=point)


def polar(azimuth: Floats | float, radius: Floats | float | list, y: Floats | list) -> Floats:
    """Points [N, 3] at an azimuth (radians, 0 at +x), distance from the y axis, and height."""
    x, z = np.multiply(radius, np.cos(azimuth)), np.multiply(radius, -np.sin(azimuth))
    return np.column_stack([x, np.asarray(y), z])
