"""Lanterns: `portica`, an arcaded lantern, and `star`, a Moravian star of opal glass.

They stand in for the paper's Portica and Star, and are not its models.
"""

import dataclasses
import itertools

import numpy as np

from lumitree.asset.geometry import Medium
from lumitree.asset.materials import Diffuse, RoughDielectric
from lumitree.lamp.builtin.fittings import (
    BECKMANN,
    BRASS,
    BRONZE,
    GLASS,
    OPAL_SHEET,
    STEEL,
    TUNGSTEN,
    WAX,
    aimed,
    arch,
    around,
    at,
    band,
    candle,
    canopy,
    chain,
    drip_pan,
    emitting,
    flame_bulb,
    pane,
    pierced,
    rod,
    sheet,
    strut,
)
from lumitree.lamp.materials import Material
from lumitree.lamp.meshes import (
    Floats,
    Mesh,
    facets,
    join,
    lathe,
    moved,
    resample,
    smooth,
    sphere,
    sweep,
)
from lumitree.lamp.parts import Geometry, Part

_SIDES = 6
_CORNER = 0.19  # distance of the corners from the axis, metres
_APOTHEM = _CORNER * np.cos(np.pi / _SIDES)
_BOTTOM, _TOP = -0.78, -0.44  # y of the arcade, metres
_WIDTH = _CORNER - 0.014  # of a panel between the corner columns, metres
_NECK, _ROOF_TOP = 0.05, -0.29  # radius and height where the roof ends, metres
_PORTICA_RADIANCE = (22.0, 14.6, 7.8)
_CANDLES = 0.085  # distance of the outer candles from the axis, metres
_FLOOR = -0.745  # y of the foot of the candles, metres
_CANDLE = 0.075  # height, metres


def build_portica() -> Geometry:
    """`portica`: opaque, translucent and clear parts around the lights."""
    whole = (np.eye(4),)
    # A side's frame: x along it, z outwards, the origin on the lamp's axis.
    sides = tuple(turn @ at(turn=90.0) for turn in around(_SIDES, first=30.0))
    rails = ((_TOP - 0.02, _CORNER - 0.008), (_TOP + 0.008, _CORNER - 0.008))
    candles = [at(0, _FLOOR), *around(_SIDES, _CANDLES, _FLOOR)]
    flames = [place @ at(0, _CANDLE - 0.002) for place in candles]
    parts = (
        Part("side_panel", _panel(), "bronze", sides),
        Part("side_pane", _pane(), "glass", sides),
        Part("roof_sheet", _roof_sheet(), "opal_sheet", sides),
        Part("frieze_sheet", sheet(_trapezoid(*rails)), "opal_sheet", sides),
        Part("floor_sheet", _floor_sheet(), "opal_sheet", whole),
        Part("frame_bronze", _frame(), "bronze", whole),
        Part("frame_brass", _ornaments(), "brass", whole),
        Part("column", _column(), "bronze", tuple(around(_SIDES, _CORNER))),
        Part("pan", drip_pan(0.028), "brass", tuple(candles)),
        Part("candle", candle(_CANDLE), "wax", tuple(candles)),
        *flame_bulb("flame", flames, "glass", "filament"),
    )
    filament = emitting(TUNGSTEN, "filament", _PORTICA_RADIANCE)
    materials = (BRASS, BRONZE, STEEL, WAX, OPAL_SHEET, GLASS, filament)
    return Geometry(parts, materials)


def _opening() -> Floats:
    return arch(_WIDTH - 0.034, _BOTTOM + 0.035, _TOP - 0.115)


def _panel() -> Mesh:
    """Arched panel, with a raised moulding along the arch and a ledge below it."""
    half = _WIDTH / 2
    plate = pierced(_opening(), -half, half, _BOTTOM, _TOP - 0.02, 0.006)
    line = np.concatenate([_opening(), _opening()[:1]])
    line = resample(np.roll(line[:-1], -1, axis=0), 90) * [1.06, 1]
    moulding = sweep(np.column_stack([line, np.full(90, 0.003)]), 0.0028, 8)
    ledge = pane(
        [[-half, _BOTTOM], [half, _BOTTOM], [half, _BOTTOM + 0.022], [-half, _BOTTOM + 0.022]],
        0.016,
    )
    return moved(join([plate, moulding, ledge]), at(0, 0, _APOTHEM))


def _pane() -> Mesh:
    """Clear pane behind an arch, 1 mm clear of the panel."""
    spring = _TOP - 0.115
    outline = arch(_WIDTH - 0.026, _BOTTOM + 0.031, spring)
    return moved(pane(outline, 0.003), at(0, 0, _APOTHEM - 0.0055))


def _roof_sheet() -> Mesh:
    """Sloping opal sheet between two ribs of the roof."""
    low, high = (_TOP + 0.008, _CORNER - 0.004), (_ROOF_TOP, _NECK - 0.002)
    return sheet(_trapezoid(low, high))


def _trapezoid(low: tuple[float, float], high: tuple[float, float]) -> list[list[float]]:
    """Corners [4, 3] in a side's frame, from heights and distances of the corners from the axis."""
    slope = np.cos(np.pi / _SIDES)
    corners = []
    for (y, radius), sign in ((low, -1), (low, 1), (high, 1), (high, -1)):
        corners.append([sign * radius / 2, y, radius * slope])
    return corners


def _floor_sheet() -> Mesh:
    """Opal bottom of the lantern."""
    radius, angle = _CORNER - 0.01, -np.radians(60 * np.arange(_SIDES))
    points = [radius * np.cos(angle), np.full(_SIDES, _BOTTOM + 0.008), radius * np.sin(angle)]
    return sheet(np.column_stack(points))


def _frame() -> Mesh:
    """Rails, ribs of the roof, cap, candle arms, and what the lantern hangs from."""
    pieces = [canopy(0.055, 0.024), chain(-0.02, -0.21, 0.04)]
    corners = [place[:3, 3] for place in around(_SIDES, 1.0)]
    for here, following in zip(corners, [*corners[1:], corners[0]], strict=True):
        for radius, y, thick in (
            (_CORNER + 0.002, _BOTTOM + 0.004, 0.0065),
            (_CORNER + 0.004, _TOP - 0.021, 0.006),
            (_CORNER + 0.006, _TOP + 0.009, 0.008),
        ):
            start, end = np.array([here, following]) * radius + [0, y, 0]
            pieces.append(strut(start, end, thick))
        eave, ridge = here * _CORNER + [0, _TOP + 0.01, 0], here * _NECK + [0, _ROOF_TOP, 0]
        pieces.append(strut(eave, ridge, 0.0045))
        candles = np.array([0.0, _FLOOR - 0.014, 0.0])
        pieces.append(strut(candles + 0.002 * here, candles + _CANDLES * here, 0.0035, 10))
    return join(pieces)


def _ornaments() -> Mesh:
    """Cap on the roof with its loop, the balls on the corners, and the finial below."""
    cap = [[0, _ROOF_TOP - 0.012], [0.052, -0.302], [0.06, -0.296], [0.06, -0.288], [0.04, -0.276]]
    cap += [[0.034, -0.25], [0.046, -0.243], [0.046, -0.236], [0.014, -0.226], [0.008, -0.218]]
    cap += [[0.012, -0.21], [0.008, -0.2], [0, -0.2]]
    finial = [[0, _BOTTOM - 0.05], [0.006, _BOTTOM - 0.05], [0.013, _BOTTOM - 0.036]]
    finial += [[0.006, _BOTTOM - 0.022], [0.022, _BOTTOM - 0.01], [0.03, _BOTTOM]]
    finial += [[0.03, _BOTTOM + 0.004], [0, _BOTTOM + 0.004]]
    ball = [[0, 0], [0.008, 0], [0.005, 0.006], [0.013, 0.016], [0.008, 0.028], [0.003, 0.036]]
    acorn = lathe(smooth([*ball, [0.002, 0.048], [0, 0.048]], 3), 24)
    balls = [moved(acorn, place) for place in around(_SIDES, _CORNER + 0.004, _TOP + 0.014)]
    stem = rod(_FLOOR - 0.005, _BOTTOM, 0.006)
    bodies = [lathe(resample(smooth(line, 3), 60), 48, crease=60) for line in (cap, finial)]
    return join(
        [*bodies, stem, *balls, moved(band(0.02, 0.024, 0, 0.004, 48), at(0, _BOTTOM + 0.01))]
    )


def _column() -> Mesh:
    """Corner column with base and capital."""
    base = [[0, _BOTTOM - 0.012], [0.006, _BOTTOM - 0.012], [0.012, _BOTTOM]]
    base += [[0.0125, _BOTTOM + 0.016]]
    base += [[0.009, _BOTTOM + 0.022], [0.0105, _BOTTOM + 0.028], [0.0075, _BOTTOM + 0.034]]
    capital = [[0.0066, _TOP - 0.06], [0.0095, _TOP - 0.056], [0.0068, _TOP - 0.05]]
    capital += [[0.008, _TOP - 0.04], [0.0125, _TOP - 0.03], [0.0125, _TOP - 0.022]]
    capital += [[0, _TOP - 0.022]]
    return lathe(resample(smooth([*base, *capital], 3), 70), 28, crease=50)


_STAR_RADIANCE = (10.0, 7.2, 4.3)
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
_OPAL = Material(
    "opal",
    RoughDielectric(int_ior=1.3, ext_ior=1.0, distribution=BECKMANN, alpha=0.36),
    medium=_MILK,
)
_LAMP = Material("lamp", Diffuse(reflectance=(0.5, 0.5, 0.5)))


@dataclasses.dataclass(frozen=True)
class _Point:
    """A pyramid of the star, outer surface: unit axis [3], tip [3], corners of its base [N, 3]."""

    axis: Floats
    tip: Floats
    base: Floats


def build_star() -> Geometry:
    """`star`: a hollow wall of scattering glass, with a lamp in every point.

    Radiance seen from outside is at most about 4.5; the lamps themselves are hidden in the body.

    """
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
    return Geometry(parts, (BRASS, _OPAL, emitting(_LAMP, "lamp", _STAR_RADIANCE)))


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
        pieces.append(moved(sphere(_FINIAL, 20), at(*finial)))
    for valley, (first, second) in normals.items():
        # At the same distance from the two planes that meet in the valley.
        raised = gap / (1 + first @ second) * (first + second)
        start, end = corners[sorted(valley)] + raised
        pieces.append(strut(start, end, _EDGE))
    joint = sphere(_JOINT, 16)
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
    return join([sphere(0.014, 24), *stalks])


def _lamp(length: float) -> Mesh:
    """Tube with round ends, from the origin up."""
    angle = np.radians(np.linspace(-90, 90, 13))
    profile = _LAMP_RADIUS * np.column_stack([np.cos(angle), 1 + np.sin(angle)])
    profile[[0, -1], 0] = 0.0
    profile[7:, 1] += length - 2 * _LAMP_RADIUS
    return lathe(profile, 20)
