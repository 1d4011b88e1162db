"""`neoclassical`: crystal chandelier of eighteen arms on two tiers, 0.95 m.

A stand-in for the paper's Neoclassical, not its model: gilt metal, flame bulbs on candles, and
faceted drops and strings of solid crystal. Every piece of cut crystal is closed and flat-shaded,
hangs on the y axis, and keeps clear of its metal pins.
"""

import numpy as np
from numpy.typing import ArrayLike

from lumitree.lamp.builtin.fittings import (
    BRASS,
    CRYSTAL,
    GLASS,
    STEEL,
    TUNGSTEN,
    WAX,
    aimed,
    around,
    at,
    band,
    candle,
    canopy,
    chain,
    drip_pan,
    emitting,
    flame_bulb,
    hoop,
    rod,
    strut,
)
from lumitree.lamp.meshes import (
    Mesh,
    facets,
    join,
    lathe,
    moved,
    resample,
    skin,
    smooth,
    sweep,
)
from lumitree.lamp.parts import Geometry, Part

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
    lower = 0.13 * length * np.array([[0, -1], [0.45, -0.9], [0.95, -0.35]])
    octagon = cut(np.concatenate([lower, lower[::-1] * [1, -1]]), 8, 0.5)
    first, second = -0.055 * length, -0.055 * length - 0.26 * length
    drop = second - 0.035 * length
    above = moved(octagon, at(0, (first + second) / 2, 0))
    glass = join([above, moved(cut(pear, 8, 0.55), at(0, drop, 0))])
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


_RADIANCE = (24.0, 16.0, 8.6)
_LOWER = (12, 0.36, -0.62)  # arms, radius and height of the foot of their candles, metres
_UPPER = (6, 0.2, -0.44)
_PAN = 0.042  # radius of the drip pans, metres
_CANDLE = 0.085  # height, metres
_CROWN = (0.1, -0.3)  # radius and height of the hoop that the long strings hang from, metres


def build_neoclassical() -> Geometry:
    """The lamp's parts and materials."""
    whole = (np.eye(4),)
    glass, pins = _centre_crystals()
    parts = [
        Part("centre_brass", _column(), "brass", whole),
        Part("centre_crystals", glass, "crystal", whole),
        Part("centre_pins", pins, "steel", whole),
    ]
    for name, (count, radius, y) in (("lower", _LOWER), ("upper", _UPPER)):
        first = 0.0 if name == "lower" else 15.0
        turns, sites = around(count, first=first), around(count, radius, y, first)
        glass, pins = _arm_crystals(name)
        parts += [
            Part(f"{name}_arm", _arm(radius, y), "brass", tuple(turns)),
            Part(f"{name}_pan", drip_pan(_PAN), "brass", tuple(sites)),
            Part(f"{name}_candle", candle(_CANDLE), "wax", tuple(sites)),
            Part(f"{name}_crystals", glass, "crystal", tuple(turns)),
            Part(f"{name}_pins", pins, "steel", tuple(turns)),
        ]
    flames = [
        place @ at(0, _CANDLE - 0.002) for place in (*around(*_LOWER), *around(*_UPPER, first=15.0))
    ]
    parts += flame_bulb("flame", flames, "glass", "filament")
    filament = emitting(TUNGSTEN, "filament", _RADIANCE)
    return Geometry(tuple(parts), (BRASS, STEEL, WAX, GLASS, CRYSTAL, filament))


def _column() -> Mesh:
    """Canopy, chain, turned shaft, and the hoops of the crown."""
    vase = [[0, -0.79], [0.012, -0.79], [0.02, -0.775], [0.012, -0.76], [0.03, -0.745]]
    vase += [[0.058, -0.72], [0.062, -0.69], [0.04, -0.665], [0.02, -0.65], [0.017, -0.63]]
    shaft = [[0.03, -0.62], [0.03, -0.61], [0.015, -0.6], [0.013, -0.56], [0.013, -0.525]]
    shaft += [[0.022, -0.515], [0.034, -0.495], [0.036, -0.475], [0.026, -0.455], [0.013, -0.445]]
    top = [[0.011, -0.41], [0.011, -0.36], [0.022, -0.35], [0.022, -0.342], [0.01, -0.33]]
    top += [[0.009, -0.29], [0.016, -0.282], [0.016, -0.272], [0.007, -0.262], [0, -0.262]]
    radius, y = _CROWN
    crown = [
        moved(hoop(radius, 0.0032), at(0, y)),
        band(radius - 0.003, radius + 0.003, y, y + 0.012),
    ]
    spoke = resample(
        smooth([[0.006, -0.31, 0], [0.04, -0.33, 0], [0.08, -0.32, 0], [radius, y, 0]]), 20
    )
    spokes = [moved(sweep(spoke, 0.0026, 10), place) for place in around(6)]
    profile = resample(smooth([*vase, *shaft, *top], 3), 110)
    pieces = [lathe(profile, 48, crease=60), canopy(0.065, 0.03), chain(-0.03, -0.262, 0.045)]
    return join([*pieces, *crown, *spokes])


def _arm(radius: float, y: float) -> Mesh:
    """S-shaped arm with a scroll, from the shaft to the drip pan, in the plane z = 0."""
    foot = y - 0.02
    root = y - 0.075 if y < -0.5 else y - 0.045
    line = [[0.03, root], [0.12 * radius + 0.03, root + 0.03], [0.38 * radius, root + 0.05]]
    line += [[0.55 * radius, root - 0.05], [0.8 * radius, root - 0.075], [radius, root - 0.035]]
    line += [[radius, foot - 0.012], [radius, foot]]
    path = resample(smooth(line), 56)
    thick = np.interp(np.linspace(0, 1, 56), [0, 0.5, 1], [0.0075, 0.0055, 0.0042])
    arm = sweep(np.column_stack([path, np.zeros(56)]), thick, 14)
    angle = np.linspace(0, 3.4 * np.pi, 48)
    size = np.linspace(0.03, 0.006, 48) * (0.55 + radius)
    at_x, at_y = 0.47 * radius, root + 0.032 + 0.02 * radius
    scroll = np.column_stack([at_x - size * np.cos(angle), at_y + size * np.sin(angle), 0 * angle])
    return join([arm, sweep(scroll, np.linspace(0.0042, 0.0026, 48), 8)])


def _arm_crystals(tier: str) -> tuple[Mesh, Mesh]:
    """Drops below a pan, the strings to the next arm and to the crown; glass and pins."""
    count, radius, y = _LOWER if tier == "lower" else _UPPER
    first = 0.0 if tier == "lower" else 15.0
    this, following = around(count, radius, y, first)[:2]
    # The caller turns everything by `first` once more.
    back = at(turn=-first)
    drop = pendant(0.075 if tier == "lower" else 0.062)
    sets = []
    for place in around(8, _PAN - 0.001, 0.004, first=22.5):
        site = back @ this @ place
        sets.append(tuple(moved(mesh, site) for mesh in drop))
    rim = [0.0, 0.004, 0.0]
    left = (back @ this @ at(*rim) @ at(0, 0, -_PAN + 0.002))[:3, 3]
    right = (back @ following @ at(*rim) @ at(0, 0, _PAN - 0.002))[:3, 3]
    sets.append(swag(left, right, 0.05, 0.015))
    crown = [_CROWN[0], _CROWN[1] - 0.003, 0.0]
    # The long strings pass below the upper tier's.
    sag = 0.1 if tier == "lower" else 0.06
    sets.append(swag(crown, [radius - _PAN, y + 0.006, 0.0], sag, 0.016))
    return join([glass for glass, _ in sets]), join([pins for _, pins in sets])


def _centre_crystals() -> tuple[Mesh, Mesh]:
    """Drops of the crown, strings to the vase, and the ball below; glass and pins."""
    radius, y = _CROWN
    sets = []
    for place in around(18, radius, y - 0.003, first=5.0):
        sets.append(tuple(moved(mesh, place) for mesh in pendant(0.06)))
    glass = [mesh for mesh, _ in sets]
    glass.append(moved(ball(0.03), at(0, -0.835)))
    spear = [[0, -0.075], [0.004, -0.066], [0.011, -0.02], [0.008, -0.006], [0, 0]]
    glass.append(moved(cut(spear, 8), at(0, -0.873)))
    pins = [mesh for _, mesh in sets]
    pins += [rod(-0.785, -0.8035, 0.004), rod(-0.8662, -0.8718, 0.001)]
    return join(glass), join(pins)
