"""Illuminance of point lights that are read from an exported lamp."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ReadLight:
    """A point light in the frame of the lamp's file, with y up.

    Attributes:
        place: [3], m.
        candela: luminous intensity [N], cd, for unit directions [N, 3].
    """

    place: Array
    candela: Callable[[Array], Array]


def summed_lux(lights: Sequence[ReadLight], points: Array, normals: Array) -> Array:
    """Illuminance [N], lx, at points [N, 3] with normals [N, 3]: the sum of I cos θ / d²."""
    lux = np.zeros(len(points))
    for light in lights:
        offset = points - light.place
        distance = np.linalg.norm(offset, axis=1)
        direction = offset / distance[:, None]
        cosine = np.maximum(-(direction * normals).sum(axis=1), 0)
        lux += light.candela(direction) * cosine / distance**2
    return lux
