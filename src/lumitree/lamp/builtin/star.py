"""`star`: Moravian star of opal glass with brass edges and twenty-six points, 0.75 m.

A stand-in for the paper's Star, not its model: the body is a hollow wall of glass filled with a
scattering medium, lit by a lamp in every point. What is seen from outside is no brighter than about
4.5; the lamps themselves are hidden in the body.
"""

import dataclasses
import itertools

import numpy as np

from lumitree.lamp.builtin.fittings import canopy, chain, strut
from lumitree.lamp.builtin.layout import aimed, at
from lumitree.lamp.builtin.materials import BECKMANN, BRASS, emitting
from lumitree.lamp.meshes import Floats, Mesh, facets, join, lathe, moved
from lumitree.lamp.parts import Diffuse, Geometry, Glass, Material, Medium, Part

_RADIANCE = (10.0, 7.2, 4.3)
_CORE = 0.105  # distance of the core's square faces from the centre, metres
_LONG, _SHORT = 0.3, 0.235  # distance of the tips of square and triangular points, metres
_LAMP_FROM, _LAMP_RADIUS = 0.085, 0.01  # start of a lamp on its point's axis, metres
_LONG_LAMP, _SHORT_LAMP = 0.125, 0.068  # length, metres
_INSIDE = 0.945  # size of the inner surface, as a share of the outer
_CENTRE = -0.44  # y, metres
_EDGE = 0.0022  # radius of the brass edges, metres
_CLEARANCE = 0.0012  # between the glass and the brass, metres
_RIDGE_FROM = 0.1  # share of a ridge, next to its foot, that has no brass
_FINIAL, _JOINT = 0.0055, 0.004  # radius of the balls on tips and at the feet of ridges, metres
_RAISED = 0.0078  # of the latter above the glass, metres
# Frosted, and about 1.6 mean free paths thick: denser, or smooth, it traps much of the light for
# longer than the paths of a capture.
_MILK = Medium(absorption=(0.0, 0.0, 0.0), scattering=(400.0, 400.0, 400.0))
_OPAL = Material("opal", Glass(ior=1.3, roughness=0.6, medium=_MILK, microfacets=BECKMANN))
_LAMP = Material("lamp", Diffuse((0.5, 0.5, 0.5)))


@dataclasses.dataclass(frozen=True)
class _Point:
    """A pyramid of the star, outer surface: unit axis [3], tip [3], corners of its base [N, 3]."""

    axis: Floats
    tip: Floats
    base: Floats


def build() -> Geometry:
    """The lamp's parts and materials."""
    points = _points()
    centre = at(0, _CENTRE)
    lamps = [centre @ aimed(point.axis, _LAMP_FROM * point.axis) for point in points]
    long = tuple(lamp for lamp, point in zip(lamps, points, strict=True) if len(point.base) == 4)
    short = tuple(lamp for lamp, point in zip(lamps, points, strict=True) if len(point.base) == 3)
    hanger = join([canopy(0.05, 0.022), chain(-0.02, _CENTRE + _LONG + 0.008, 0.028)])
    parts = (
        Part("body", _body(points), "opal", (centre,)),
        Part("edges", _edges(points), "brass", (centre,)),
        Part("stalks", _stalks(points), "brass", (centre,)),
        Part("hanger", hanger, "brass", (np.eye(4),)),
        Part("long_lamp", _lamp(_LONG_LAMP), "lamp", long),
        Part("short_lamp", _lamp(_SHORT_LAMP), "lamp", short),
    )
    return Geometry(parts, (BRASS, _OPAL, emitting(_LAMP, "lamp", _RADIANCE)))


def _points() -> list[_Point]:
    """Pyramids on the 18 squares and 8 triangles of a rhombicuboctahedron."""
    long = 1 + np.sqrt(2)
    corners = [
        np.array(signs) * magnitudes
        for magnitudes in ([1, 1, long], [1, long, 1], [long, 1, 1])
        for signs in itertools.product((-1, 1), repeat=3)
    ]
    vertices = np.array(corners) * _CORE / long
    points = []
    for direction in itertools.product((-1, 0, 1), repeat=3):
        if not any(direction):
            continue
        axis = np.array(direction) / np.linalg.norm(direction)
        height = vertices @ axis
        face = vertices[height > height.max() - 1e-6]
        # Counter-clockwise, seen from the tip.
        side = face[0] - height.max() * axis
        angle = np.arctan2(face @ np.cross(axis, side), face @ side)
        tip = axis * (_LONG if len(face) == 4 else _SHORT)
        points.append(_Point(axis, tip, face[np.argsort(angle)]))
    return points


def _body(points: list[_Point]) -> Mesh:
    """Wall of the star: an outer surface, and a smaller one that faces the cavity."""
    triangles = np.concatenate(
        [
            [[corner, following, point.tip] for corner, following in _sides(point)]
            for point in points
        ]
    )
    return join([facets(triangles), facets(_INSIDE * triangles[:, ::-1])])


def _sides(point: _Point) -> list[tuple[Floats, Floats]]:
    return list(zip(point.base, np.roll(point.base, -1, axis=0), strict=True))


def _edges(points: list[_Point]) -> Mesh:
    """Brass along ridges and valleys, with balls where they meet, all just clear of the glass."""
    gap = _EDGE + _CLEARANCE
    pieces = []
    normals: dict[frozenset[int], list[Floats]] = {}
    corners = np.unique(np.concatenate([point.base for point in points]).round(9), axis=0)

    def index(corner: Floats) -> int:
        return int(np.linalg.norm(corners - corner, axis=1).argmin())

    for point in points:
        sides = _sides(point)
        outward = [_normal(corner, following, point.tip) for corner, following in sides]
        for i, (corner, following) in enumerate(sides):
            bisector = outward[i] + outward[i - 1]
            bisector *= gap / np.linalg.norm(bisector)
            ridge = corner + _RIDGE_FROM * (point.tip - corner)
            pieces.append(strut(ridge + bisector, point.tip + bisector, _EDGE))
            valley = frozenset((index(corner), index(following)))
            normals.setdefault(valley, []).append(outward[i])
        finial = point.tip + (_FINIAL + _CLEARANCE) * point.axis
        pieces.append(moved(_sphere(_FINIAL, 20), at(*finial)))
    for valley, (first, second) in normals.items():
        # At the same distance from the two planes that meet in the valley.
        raised = gap / (1 + first @ second) * (first + second)
        start, end = corners[sorted(valley)] + raised
        pieces.append(strut(start, end, _EDGE))
    joint = _sphere(_JOINT, 16)
    pieces += [
        moved(joint, at(*(corner * (1 + _RAISED / np.linalg.norm(corner))))) for corner in corners
    ]
    return join(pieces)


def _normal(a: Floats, b: Floats, c: Floats) -> Floats:
    normal = np.cross(b - a, c - a)
    return normal / np.linalg.norm(normal)


def _stalks(points: list[_Point]) -> Mesh:
    """Hub in the cavity, with a stalk to each lamp."""
    start, end = 0.005, _LAMP_FROM - 0.001
    stalks = [strut(start * point.axis, end * point.axis, 0.0012, 8) for point in points]
    return join([_sphere(0.014, 24), *stalks])


def _lamp(length: float) -> Mesh:
    """Tube with round ends, from the origin up."""
    angle = np.radians(np.linspace(-90, 90, 13))
    profile = _LAMP_RADIUS * np.column_stack([np.cos(angle), 1 + np.sin(angle)])
    profile[[0, -1], 0] = 0.0
    profile[7:, 1] += length - 2 * _LAMP_RADIUS
    return lathe(profile, 20)


def _sphere(radius: float, segments: int) -> Mesh:
    angle = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
    profile = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    profile[[0, -1], 0] = 0.0
    return lathe(profile, segments)
