"""`bulbs`: five clear bulbs with coil filaments on a brass and black steel frame, 0.33 m.

The frame of a bulb has its origin on its axis where the glass leaves the cap; it hangs to -y.
"""

import numpy as np

from lumitree.core.frames import rotation, similarity
from lumitree.luminaires.builtin.materials import (
    BLACK_STEEL,
    BRASS,
    GLASS,
    STEEL,
    TUNGSTEN,
    emitting,
)
from lumitree.luminaires.geometry import (
    Floats,
    Mesh,
    coil,
    join,
    lathe,
    offset,
    resample,
    smooth,
    sweep,
)
from lumitree.luminaires.model import Model, Part

_NUM_BULBS = 5
_ARM_RADIUS = 0.125  # from the lamp's axis to a bulb's, metres
_BULB_HEIGHT = -0.205  # y of a bulb's origin in the lamp, metres
_RADIANCE = (30.0, 20.0, 10.5)
_WALL = 0.0012  # of the glass, metres
_WIRE = 0.0006  # radius of the supports, metres
_FILAMENT = 0.0012  # radius of the filament's wire, metres
_CAGE = 0.0155  # radius of the cylinder the filament zigzags on, and distance of its legs, metres
_LEG_TOP, _LEG_BOTTOM = -0.054, -0.09  # straight part of the legs, metres


def build() -> Model:
    """The lamp's parts and materials."""
    step = 360 / _NUM_BULBS
    turns = tuple(similarity(rotation([0, 1, 0], step * index)) for index in range(_NUM_BULBS))
    hang = similarity(np.eye(3), translation=[_ARM_RADIUS, _BULB_HEIGHT, 0.0])
    sites = tuple(turn @ hang for turn in turns)
    parts = (
        Part("frame_body", _body(), "brass", (np.eye(4),)),
        Part("frame_arm", _arm(), "black", turns),
        Part("socket", _socket(), "brass", sites),
        Part("bulb_cap", _cap(), "steel", sites),
        Part("bulb_glass", _glass(), "glass", sites),
        Part("bulb_supports", _supports(), "steel", sites),
        Part("bulb_filament", _filament(), "filament", sites),
    )
    filament = emitting(TUNGSTEN, "filament", _RADIANCE)
    return Model(parts, (BRASS, BLACK_STEEL, STEEL, GLASS, filament))


def _body() -> Mesh:
    """Canopy at the ceiling, stem, and the turned hub that carries the arms."""
    canopy = [[0, -0.026], [0.012, -0.026], [0.014, -0.024], [0.03, -0.019], [0.044, -0.01]]
    canopy += [[0.048, -0.004], [0.048, 0], [0, 0]]
    knob = [[0, -0.236], [0.005, -0.236], [0.009, -0.229], [0.004, -0.218], [0.004, -0.212]]
    hub = [[0.016, -0.21], [0.026, -0.198], [0.027, -0.182], [0.02, -0.168], [0.009, -0.158]]
    collar = [[0.009, -0.146], [0.006, -0.142], [0, -0.142]]
    stem = [[0, -0.15], [0.005, -0.15], [0.005, -0.02], [0, -0.02]]
    return join(
        [
            lathe([*smooth(canopy[:-2], 2), *canopy[-2:]], 48),
            lathe(smooth(knob + hub + collar, 2), 48),
            lathe(stem, 32),
        ]
    )


def _arm() -> Mesh:
    """Swan-neck tube from the hub to the top of a socket, in the plane z = 0 of the lamp."""
    end = _BULB_HEIGHT + 0.05
    line = [[0.015, -0.19], [0.05, -0.19], [0.072, -0.165], [0.082, -0.12]]
    line += [[_ARM_RADIUS, -0.1], [_ARM_RADIUS, end + 0.02], [_ARM_RADIUS, end]]
    path = resample(smooth(line), 40)
    return sweep(np.column_stack([path, np.zeros(len(path))]), 0.0042, 16)


def _socket() -> Mesh:
    """Cup that the cap is screwed into, with a beaded rim."""
    inside = [[0, 0.032], [0.0156, 0.032], [0.0156, 0.005]]
    rim = [[0.0195, 0.005], [0.0205, 0.0065], [0.0195, 0.008], [0.0185, 0.0085]]
    outside = [[0.0185, 0.036], [0.016, 0.042], [0.009, 0.045], [0.0075, 0.052], [0, 0.052]]
    return lathe(inside + rim + outside, 48)


def _cap() -> Mesh:
    """Screw cap; the neck of the glass ends inside it with 0.6 mm of clearance."""
    inside = [[0, 0.02], [0.0126, 0.02], [0.0126, -0.003], [0.0134, -0.003]]
    angle = np.linspace(0, 4 * 2 * np.pi, 33)
    thread = np.column_stack([0.0138 - 0.0006 * np.cos(angle), np.linspace(0, 0.02, 33)])
    return lathe([*inside, *thread, [0.008, 0.026], [0, 0.026]], 48)


def _glass() -> Mesh:
    """Wall of the bulb and the solid stem inside it; three closed surfaces."""
    pear = [[0, -0.122], [0.024, -0.122], [0.038, -0.104], [0.0375, -0.072], [0.026, -0.046]]
    neck = [[0.0125, -0.024], [0.0118, -0.004], [0.0118, 0.015], [0, 0.015]]
    outer = resample(smooth(pear + neck), 34)
    inner = resample(offset(outer, _WALL), 34)
    stem = [[0, -0.044], [0.004, -0.044], [0.003, -0.034], [0.0028, -0.014], [0.0065, 0.0]]
    stem += [[0.0065, 0.008], [0, 0.008]]
    return join(
        [
            lathe(outer, 48, crease=90),
            lathe(inner[::-1], 48, crease=90),
            lathe(resample(smooth(stem), 20), 24, crease=90),
        ]
    )


def _filament() -> Mesh:
    """Coiled wire in a zigzag of four legs around the stem."""
    return sweep(coil(_zigzag(), 0.003, 0.0062, 14), _FILAMENT, 6)


def _zigzag() -> Floats:
    """Axis of the coil [N, 3]: legs joined by half circles, wrapped around a cylinder."""
    turn = np.linspace(0, np.pi, 25)
    arc = _CAGE / 2 * np.column_stack([-np.cos(turn), np.sin(turn)])
    pieces = [np.array([[-1.5 * _CAGE, _LEG_TOP]])]
    for leg in range(3):
        end, sign = (_LEG_BOTTOM, -1) if leg % 2 == 0 else (_LEG_TOP, 1)
        pieces.append(arc * [1, sign] + [(leg - 1) * _CAGE, end])
    pieces.append(np.array([[1.5 * _CAGE, _LEG_TOP]]))
    flat = resample(np.concatenate(pieces), 200)
    return _around(flat[:, 0] / _CAGE, _CAGE, flat[:, 1])


def _supports() -> Mesh:
    """Two leads from the cap, and hooks from a button below the stem to the filament's turns."""
    button = lathe(smooth([[0, -0.05], [0.003, -0.05], [0.003, -0.0445], [0, -0.0445]], 2), 16)
    foot = _LEG_BOTTOM - _CAGE / 2
    wires: list[Floats] = []
    for azimuth in (-1.5, 1.5):
        radius = [0.0085, 0.0085, _CAGE, _CAGE]
        wires.append(_around(azimuth, radius, [0.01, -0.024, -0.034, _LEG_TOP]))
    wires.append(_around(0.0, [0, 0], [-0.047, foot + 0.002]))
    yoke = np.array([-1.0, -1.0, 0.0, 1.0, 1.0])
    wires.append(_around(yoke, [_CAGE, _CAGE / 2, 0, _CAGE / 2, _CAGE], [foot] * 5))
    wires.append(_around(0.0, [0, 0.004, _CAGE], [-0.047, -0.047, _LEG_TOP + _CAGE / 2]))
    tubes = [sweep(resample(smooth(wire), 24), _WIRE, 8) for wire in wires]
    return join([button, *tubes])


def _around(azimuth: Floats | float, radius: Floats | float | list, y: Floats | list) -> Floats:
    """Points [N, 3] at an azimuth (radians, 0 at +x), distance from the y axis, and height."""
    x, z = np.multiply(radius, np.cos(azimuth)), np.multiply(radius, -np.sin(azimuth))
    return np.column_stack([x, np.asarray(y), z])
