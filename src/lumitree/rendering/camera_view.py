"""Where a camera stands and looks."""

from __future__ import annotations

import dataclasses
import math

import mitsuba as mi
import numpy as np

Vector = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class CameraView:
    """View of a perspective camera.

    Attributes:
        origin: [3] its place, scene coordinates.
        direction, up: [3] unit vectors, where it looks and what is up in the image.
        horizontal, vertical: angles of view, degrees.
    """

    origin: Vector
    direction: Vector
    up: Vector
    horizontal: float
    vertical: float


def camera_view(sensor: mi.Sensor) -> CameraView | None:
    """View of a camera; None if it is not a perspective one, with or without a lens."""
    parameters = mi.traverse(sensor)
    if "x_fov" not in parameters:
        return None
    matrix = np.array(sensor.world_transform().matrix, np.float64).reshape(4, 4)
    width, height = (int(side) for side in sensor.film().size())
    horizontal = float(np.ravel(parameters["x_fov"])[0])
    half = math.tan(math.radians(horizontal / 2)) * height / width
    axes = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
    origin, direction, up = (
        tuple(each.tolist()) for each in (matrix[:3, 3], axes[:, 2], axes[:, 1])
    )
    return CameraView(origin, direction, up, horizontal, 2 * math.degrees(math.atan(half)))
