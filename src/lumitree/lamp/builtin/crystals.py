"""Cut crystal: faceted solids of glass, and strings of them with metal pins between.

Every piece is closed and flat-shaded, hangs on the y axis, and keeps clear of its pins.
"""

import numpy as np
from numpy.typing import ArrayLike

from lumitree.lamp.builtin.fittings import strut
from lumitree.lamp.builtin.layout import aimed, at
from lumitree.lamp.meshes import Floats, Mesh, facets, join, lathe, moved, resample, skin

_PIN = 0.0006  # radius of the wires, metres
_CLEARANCE = 0.0006  # between a wire's end and the glass, metres


def cut(profile: ArrayLike, sides: int, flatness: float = 1.0) -> Mesh:
    """Faceted solid about the y axis; the profile [N, 2], radius and y, goes upwards along it.

    `flatness` is its thickness along z as a share of the width along x.
    """
    mesh = lathe(profile, sides)
    return facets(mesh.vertices[mesh.faces] * [1, 1, flatness])


def bead(length: float) -> Mesh:
    """Eight-sided bead, centred, its axis along y."""
    half = length / 2
    profile = [[0, -half], [0.5 * half, -0.86 * half], [0.92 * half, -0.3 * half]]
    profile += [[0.92 * half, 0.3 * half], [0.5 * half, 0.86 * half], [0, half]]
    return cut(profile, 8)


def ball(radius: float) -> Mesh:
    """Ball of many facets around its centre, every second row of them turned by half a facet."""
    elevation = np.radians([-72, -48, -24, 0, 24, 48, 72])
    sides = 16
    rings = [np.broadcast_to([0.0, -radius, 0.0], (sides, 3))]
    for row, angle in enumerate(elevation):
        azimuth = 2 * np.pi * (np.arange(sides) + row % 2 / 2) / sides
        flat = radius * np.cos(angle)
        height = np.full(sides, radius * np.sin(angle))
        rings.append(np.stack([flat * np.cos(azimuth), height, -flat * np.sin(azimuth)], axis=1))
    rings.append(np.broadcast_to([0.0, radius, 0.0], (sides, 3)))
    stacked = np.stack(rings)
    mesh = skin(stacked, np.zeros_like(stacked), np.ones(len(rings) - 1, bool))
    return facets(mesh.vertices[mesh.faces])


def pendant(length: float) -> tuple[Mesh, Mesh]:
    """Drop that hangs from the origin: an octagon above a pear; glass and pins."""
    body = 0.66 * length
    wide = 0.27 * body
    pear = [
        [0, -body],
        [0.5 * wide, -0.94 * body],
        [wide, -0.74 * body],
        [0.86 * wide, -0.52 * body],
    ]
    pear += [[0.2 * wide, -0.04 * body], [0, 0]]
    octagon = cut(_octagon(0.26 * length), 8, 0.5)
    first, second = -0.055 * length, -0.055 * length - 0.26 * length
    drop = second - 0.035 * length
    glass = join(
        [
            moved(octagon, at(0, (first + second) / 2, 0)),
            moved(cut(pear, 8, 0.55), at(0, drop, 0)),
        ]
    )
    pins = join([_pin([0, 0, 0], [0, first, 0]), _pin([0, second, 0], [0, drop, 0], both=True)])
    return glass, pins


def swag(start: ArrayLike, end: ArrayLike, sag: float, spacing: float) -> tuple[Mesh, Mesh]:
    """String of beads that hangs between two points [3] with the sag in its middle, in metres."""
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    t = np.linspace(0, 1, 65)[:, None]
    line = start + t * (end - start) - [0, 1, 0] * (4 * sag * t * (1 - t))
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    count = max(1, round(length / spacing))
    points = resample(line, 2 * count + 1)
    size = 0.76 * length / count
    piece = bead(size)
    glass: list[Mesh] = []
    joints = [points[0]]
    for i in range(count):
        before, centre, after = points[2 * i : 2 * i + 3]
        axis = (after - before) / np.linalg.norm(after - before)
        glass.append(moved(piece, aimed(axis, centre)))
        joints += [centre - size / 2 * axis, centre + size / 2 * axis]
    joints.append(points[-1])
    pins = [_pin(joints[0], joints[1]), _pin(joints[-1], joints[-2])]
    pins += [_pin(joints[i], joints[i + 1], both=True) for i in range(2, 2 * count, 2)]
    return join(glass), join(pins)


def _pin(start: ArrayLike, end: ArrayLike, both: bool = False) -> Mesh:
    """Wire to a piece of glass at `end`, and from one at `start` where both are glass."""
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    axis = (end - start) / np.linalg.norm(end - start)
    # A tube's domed end stands out by half its radius.
    gap = (_CLEARANCE + _PIN / 2) * axis
    return strut(start + gap if both else start, end - gap, _PIN, 6)


def _octagon(length: float) -> Floats:
    half = length / 2
    lower = np.array([[0, -half], [0.45 * half, -0.9 * half], [0.95 * half, -0.35 * half]])
    return np.concatenate([lower, lower[::-1] * [1, -1]])
