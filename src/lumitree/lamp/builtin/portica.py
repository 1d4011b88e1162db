"""`portica`: six-sided arcaded lantern with opal roof, clear panes and seven flame bulbs, 0.83 m.

A stand-in for the paper's Portica, not its model: opaque, translucent and clear parts around
the lights.
"""

import numpy as np

from lumitree.lamp.builtin.fittings import band, candle, canopy, chain, drip_pan, rod, strut
from lumitree.lamp.builtin.incandescent import flame_bulb
from lumitree.lamp.builtin.layout import around, at
from lumitree.lamp.builtin.materials import (
    BRASS,
    BRONZE,
    GLASS,
    OPAL_SHEET,
    STEEL,
    TUNGSTEN,
    WAX,
    emitting,
)
from lumitree.lamp.builtin.panels import arch, pane, pierced, sheet
from lumitree.lamp.meshes import Floats, Mesh, join, lathe, moved, resample, smooth, sweep
from lumitree.lamp.parts import Geometry, Part

_SIDES = 6
_CORNER = 0.19  # distance of the corners from the axis, metres
_APOTHEM = _CORNER * np.cos(np.pi / _SIDES)
_BOTTOM, _TOP = -0.78, -0.44  # y of the arcade, metres
_WIDTH = _CORNER - 0.014  # of a panel between the corner columns, metres
_NECK, _ROOF_TOP = 0.05, -0.29  # radius and height where the roof ends, metres
_RADIANCE = (22.0, 14.6, 7.8)
_CANDLES = 0.085  # distance of the outer candles from the axis, metres
_FLOOR = -0.745  # y of the foot of the candles, metres
_CANDLE = 0.075  # height, metres


def build() -> Geometry:
    """The lamp's parts and materials."""
    whole = (np.eye(4),)
    # A side's frame: x along it, z outwards, the origin on the lamp's axis.
    sides = tuple(turn @ at(turn=90.0) for turn in around(_SIDES, first=30.0))
    candles = [at(0, _FLOOR), *around(_SIDES, _CANDLES, _FLOOR)]
    flames = [place @ at(0, _CANDLE - 0.002) for place in candles]
    parts = (
        Part("side_panel", _panel(), "bronze", sides),
        Part("side_pane", _pane(), "glass", sides),
        Part("roof_sheet", _roof_sheet(), "opal_sheet", sides),
        Part("frieze_sheet", _frieze_sheet(), "opal_sheet", sides),
        Part("floor_sheet", _floor_sheet(), "opal_sheet", whole),
        Part("frame_bronze", _frame(), "bronze", whole),
        Part("frame_brass", _ornaments(), "brass", whole),
        Part("column", _column(), "bronze", tuple(around(_SIDES, _CORNER))),
        Part("pan", drip_pan(0.028), "brass", tuple(candles)),
        Part("candle", candle(_CANDLE), "wax", tuple(candles)),
        *flame_bulb("flame", flames, "glass", "filament"),
    )
    filament = emitting(TUNGSTEN, "filament", _RADIANCE)
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


def _frieze_sheet() -> Mesh:
    """Opal strip between the rails of arcade and roof."""
    return sheet(_trapezoid((_TOP - 0.02, _CORNER - 0.008), (_TOP + 0.008, _CORNER - 0.008)))


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
            ends = np.array([here, following]) * radius + [0, y, 0]
            pieces.append(strut(ends[0], ends[1], thick))
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
    finial += [
        [0.006, _BOTTOM - 0.022],
        [0.022, _BOTTOM - 0.01],
        [0.03, _BOTTOM],
        [0.03, _BOTTOM + 0.004],
    ]
    finial += [[0, _BOTTOM + 0.004]]
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
    base = [
        [0, _BOTTOM - 0.012],
        [0.006, _BOTTOM - 0.012],
        [0.012, _BOTTOM],
        [0.0125, _BOTTOM + 0.016],
    ]
    base += [[0.009, _BOTTOM + 0.022], [0.0105, _BOTTOM + 0.028], [0.0075, _BOTTOM + 0.034]]
    capital = [[0.0066, _TOP - 0.06], [0.0095, _TOP - 0.056], [0.0068, _TOP - 0.05]]
    capital += [
        [0.008, _TOP - 0.04],
        [0.0125, _TOP - 0.03],
        [0.0125, _TOP - 0.022],
        [0, _TOP - 0.022],
    ]
    return lathe(resample(smooth([*base, *capital], 3), 70), 28, crease=50)
