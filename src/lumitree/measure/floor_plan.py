"""Floor plans below illuminance: walls and furniture by rays through the scene, and lamps.

A plan is cut at its plane, as an architect's: a surface that crosses the plane is a line of the
section, and steps of the surfaces below the plane are edges.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.geometry import MeshShape
from lumitree.asset.light_field import Outline
from lumitree.core.device import on_device
from lumitree.measure.receivers import Plane

if TYPE_CHECKING:
    from lumitree.rendering.scene import PlacedLuminaire

# Pixels of the longer side, and part of the plane's longer side that is shown around the plane.
_PIXELS, _AROUND = 600, 0.25
# Height of an edge, in pixels: surfaces that are steeper than this are steps.
_STEP = 3
# Corners of an outline that is round.
_ROUND = 48
# Directions in which an outline has its farthest points.
_TOWARDS = np.exp(2j * np.pi * np.arange(128) / 128).view(np.float64).reshape(-1, 2)
_CORNERS = np.stack(np.meshgrid(*3 * [[-1.0, 1.0]]), axis=-1).reshape(-1, 3)


@dataclasses.dataclass(frozen=True, eq=False)
class FloorPlan:
    """Outlines of a room at a plane, along the plane's axes u and v from the scene's origin.

    Attributes:
        low, high: [2] corners of the part that is shown.
        section: [H, W] whether a surface crosses the plane, from the smallest v on.
        edges: [H, W] whether there is a step of the surfaces below the plane.
        lamps: [K, 2] convex outline of each lamp.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    section: NDArray[np.bool_]
    edges: NDArray[np.bool_]
    lamps: list[NDArray[np.float64]]


def floor_plan(plane: Plane, scene: mi.Scene, lamps: Sequence[PlacedLuminaire]) -> FloorPlan:
    """The floor plan of a scene at a plane, with the lamps that are placed in it."""
    axes, half = plane.axes, np.asarray(plane.extent) / 2
    centre = axes @ np.asarray(plane.centre, np.float64)
    least, most = (np.ravel(each) for each in (scene.bbox().min, scene.bbox().max))
    corners = np.where(_CORNERS > 0, most, least) @ axes[:2].T
    around = _AROUND * max(plane.extent)
    # As far as the room, but not far beyond the plane. A wall at the edge has to be inside.
    low = np.maximum(corners.min(axis=0) - 0.02 * around, centre[:2] - half - around)
    high = np.minimum(corners.max(axis=0) + 0.02 * around, centre[:2] + half + around)
    low, high = np.minimum(low, centre[:2] - half), np.maximum(high, centre[:2] + half)
    pixel = float((high - low).max()) / _PIXELS
    columns, rows = np.ceil((high - low) / pixel).astype(int)
    u, v = np.meshgrid(low[0] + pixel * np.arange(columns), low[1] + pixel * np.arange(rows))
    flat = np.stack([u, v, np.full_like(u, centre[2])], axis=-1).reshape(-1, 3)

    def ray(direction: NDArray[np.float64]) -> mi.Ray3f:
        towards = np.broadcast_to(direction, flat.shape)
        return mi.Ray3f(on_device(mi.Point3f, flat @ axes), on_device(mi.Vector3f, towards))

    section = np.zeros(u.shape, bool)
    for axis in axes[:2]:
        short = ray(axis)
        short.maxt = mi.Float(pixel)
        section |= np.array(scene.ray_test(short)).reshape(u.shape)
    seen = scene.ray_intersect_preliminary(ray(-axes[2]), coherent=True)
    depth = np.array(dr.select(seen.is_valid(), seen.t, np.nan), np.float64).reshape(u.shape)
    edges = np.zeros(u.shape, bool)
    edges[1:] |= np.abs(np.diff(depth, axis=0)) > _STEP * pixel
    edges[:, 1:] |= np.abs(np.diff(depth, axis=1)) > _STEP * pixel
    return FloorPlan(low, high, section, edges, [_outline(each, axes[:2]) for each in lamps])


def _outline(lamp: PlacedLuminaire, axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convex outline [K, 2] of a lamp along two axes.

    It is the outline of its meshes, of its luminous opening, or of its bounding box.
    """
    geometry = None if lamp.asset is None else lamp.asset.geometry
    if geometry is not None and all(isinstance(each, MeshShape) for each in geometry.shapes):
        matrix, points = lamp.scene_from_world, geometry.vertices + np.array(geometry.origin)
    else:
        matrix, light = lamp.scene_from_box, None if lamp.asset is None else lamp.asset.light_field
        points = _CORNERS if light is None else opening_points(light.outline)
    flat = (points @ matrix[:3, :3].T + matrix[:3, 3]) @ axes.T
    # The farthest points in directions all around, in their order.
    farthest = [int(np.argmax(flat @ each)) for each in _TOWARDS]
    return flat[list(dict.fromkeys(farthest))]


def opening_points(outline: Outline | None) -> NDArray[np.float64]:
    """Points [N, 3] of an opening in the box [-1, 1]³, whose convex hull it is."""
    if outline is None or outline == "box":
        return _CORNERS
    angle = np.linspace(0, 2 * np.pi, _ROUND, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if outline == "ellipsoid":
        rings = [np.insert(circle, axis, 0.0, axis=1) for axis in range(3)]
    else:
        axis = "xyz".index(outline[-1])
        rings = [np.insert(circle, axis, end, axis=1) for end in (-1.0, 1.0)]
    return np.concatenate(rings)
