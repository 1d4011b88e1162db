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
    """View of a camera; None if it is not a perspective one, with or without a lens.

    Nor is there one of an image whose centre is not on the camera's axis: in a crop window, or with
    an offset of the principal point.
    """
    parameters, film = mi.traverse(sensor), sensor.film()
    if "x_fov" not in parameters:
        return None
    size, crop, start = (
        np.array(each, np.int64) for each in (film.size(), film.crop_size(), film.crop_offset())
    )
    shifts = [parameters[key] for key in parameters.keys() if key.startswith("principal_point")]  # noqa: SIM118
    if np.abs(2 * start + crop - size).max() > 1 or np.any(shifts):
        return None
    matrix = np.array(sensor.world_transform().matrix, np.float64).reshape(4, 4)
    # Half the width of the whole film at a distance of 1, and of the image that is its part.
    half = math.tan(math.radians(float(np.ravel(parameters["x_fov"])[0]) / 2))
    halves = half * crop / size[0]
    horizontal, vertical = (2 * math.degrees(math.atan(each)) for each in halves)
    axes = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
    origin, direction, up = (
        tuple(each.tolist()) for each in (matrix[:3, 3], axes[:, 2], axes[:, 1])
    )
    return CameraView(origin, direction, up, horizontal, vertical)
