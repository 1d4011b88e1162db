"""The diffuse room of the benchmarks in Mitsuba, and the pixels of an image that show its walls."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cycles.room import CAMERA, DIFFUSE_BOUNCES, WALLS, mitsuba_walls

REGIONS = ("floor", "ceiling", "back", "left", "right")
LAMP_CENTRE = (0.0, 1.5, 0.0)
# Vertices of a path: the first surface, the diffuse bounces, and the light.
PATH_DEPTH = DIFFUSE_BOUNCES + 2


def mitsuba_room(width: int, height: int) -> Any:
    """The room (mi.Scene)."""
    import mitsuba as mi

    from lumitree.rendering.objects import load_ordered

    scene: dict[str, Any] = {"type": "scene", **mitsuba_walls(WALLS)}
    look = mi.ScalarTransform4f().look_at(CAMERA["origin"], CAMERA["target"], [0, 1, 0])
    scene["sensor"] = {
        "type": "perspective",
        "fov": CAMERA["fov"],
        "to_world": look,
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
        },
    }
    return load_ordered(scene)


def region_masks(width: int, height: int, half: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """Masks [H, W] of the pixels that show a wall, and neither its edges nor the lamp.

    Args:
        half: [3] half the sides of the lamp's box, m.
    """
    origin = np.array(CAMERA["origin"])
    forward = CAMERA["target"] - origin
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    upwards = np.cross(right, forward)
    tangent = np.tan(np.radians(CAMERA["fov"]) / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * tangent
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * tangent * height / width
    direction = forward + x[None, :, None] * right + y[:, None, None] * upwards
    # A pixel more on all sides.
    margin = half + 3 * tangent / width * np.linalg.norm(origin)
    first, second = ((LAMP_CENTRE + s * margin - origin) / direction for s in (-1, 1))
    lamp = np.minimum(first, second).max(axis=-1) < np.maximum(first, second).min(axis=-1)
    low, high = np.array([-2, 0, -2]), np.array([2, 2.4, 2])
    away = np.where(direction > 0, high - origin, low - origin) / direction
    hit = origin + away.min(axis=-1, keepdims=True) * direction
    inside = np.minimum(hit - low, high - hit)
    # On a wall one distance is 0; the two others are those from its edges.
    clear = np.sort(inside, axis=-1)[..., 1] > 0.05
    masks = {}
    for name in REGIONS:
        wall = WALLS[name]
        centre, normal = np.array(wall["centre"]), np.cross(wall["first"], wall["second"])
        on = np.abs((hit - centre) @ (normal / np.linalg.norm(normal))) < 1e-9
        masks[name] = on & clear & ~lamp
    return masks
