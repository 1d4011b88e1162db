"""Flat plates with an outline in the x-y plane, centred on z = 0: panes, sheets, pierced panels."""

import numpy as np
from numpy.typing import ArrayLike

from lumitree.lamp.meshes import Floats, Mesh, facets, skin


def arch(width: float, bottom: float, spring: float) -> Floats:
    """Outline [N, 2] of an opening whose round head begins at `spring`, counter-clockwise; m."""
    angle = np.radians(np.linspace(0, 180, 33))
    head = width / 2 * np.column_stack([np.cos(angle), np.sin(angle)]) + [0, spring]
    return np.concatenate([[[-width / 2, bottom], [width / 2, bottom]], head])


def sheet(outline: ArrayLike) -> Mesh:
    """Single sheet [N, 3] within a flat convex outline, faced where it is counter-clockwise."""
    outline = np.asarray(outline, np.float64)
    centre = np.broadcast_to(outline.mean(axis=0), outline.shape)
    return facets(np.stack([centre, outline, np.roll(outline, -1, axis=0)], axis=1))


def pane(outline: ArrayLike, thickness: float) -> Mesh:
    """Closed plate within a convex outline [N, 2], counter-clockwise; metres."""
    front = _raised(np.asarray(outline, np.float64), thickness / 2)
    back = front * [1, 1, -1]
    centre = front.mean(axis=0)
    after, behind = np.roll(front, -1, axis=0), np.roll(back, -1, axis=0)
    middle = np.broadcast_to(centre, front.shape)
    fan = [np.stack([middle, front, after], axis=1)]
    fan.append(np.stack([middle * [1, 1, -1], behind, back], axis=1))
    rim = [np.stack([front, back, behind], axis=1), np.stack([front, behind, after], axis=1)]
    return facets(np.concatenate(fan + rim))


def pierced(
    opening: ArrayLike, left: float, right: float, bottom: float, top: float, thickness: float
) -> Mesh:
    """Closed rectangular plate with an opening, star-shaped about its mean point; metres.

    The outline [N, 2] is counter-clockwise, the thickness along z.
    """
    inner = np.asarray(opening, np.float64)
    centre = inner.mean(axis=0)
    corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
    inner, outer = _matched(inner, corners, centre)
    half = thickness / 2
    loops = [_raised(outer, half), _raised(inner, half), _raised(inner, -half)]
    loops += [_raised(outer, -half), _raised(outer, half)]
    # From the outer rim inwards over the front, through the opening, and back outside.
    mesh = skin(
        np.stack(loops), np.zeros((len(loops), len(inner), 3)), np.ones(len(loops) - 1, bool)
    )
    return facets(mesh.vertices[mesh.faces])


def _matched(inner: Floats, corners: Floats, centre: Floats) -> tuple[Floats, Floats]:
    """Points of both outlines in the same directions from the centre, at all their corners."""
    angles = [np.arctan2(*(line - centre).T[::-1]) for line in (inner, corners)]
    directions = np.unique(np.concatenate(angles).round(9))
    return _seen(inner, centre, directions), _seen(corners, centre, directions)


def _seen(outline: Floats, centre: Floats, directions: Floats) -> Floats:
    """Points [M, 2] of a closed outline in directions from the centre, radians."""
    start = outline - centre
    step = np.roll(start, -1, axis=0) - start
    ray = np.column_stack([np.cos(directions), np.sin(directions)])[:, None]
    det = ray[..., 0] * step[:, 1] - ray[..., 1] * step[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (start[:, 0] * step[:, 1] - start[:, 1] * step[:, 0]) / det
        along = (start[:, 0] * ray[..., 1] - start[:, 1] * ray[..., 0]) / det
    hit = (reach > 0) & (along > -1e-6) & (along < 1 + 1e-6)
    reach = np.where(hit, reach, np.inf).min(axis=1)
    return centre + reach[:, None] * ray[:, 0]


def _raised(outline: Floats, z: float) -> Floats:
    return np.column_stack([outline, np.full(len(outline), z)])
