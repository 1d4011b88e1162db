"""`bulbs`: five clear bulbs with coil filaments on a brass and black steel frame, 0.33 m."""

import numpy as np

from lumitree.lamp.builtin.incandescent import Filament, HangingBulb, socket
from lumitree.lamp.builtin.layout import around, at
from lumitree.lamp.builtin.materials import (
    BLACK_STEEL,
    BRASS,
    GLASS,
    STEEL,
    TUNGSTEN,
    emitting,
)
from lumitree.lamp.meshes import (
    Mesh,
    join,
    lathe,
    resample,
    smooth,
    sweep,
)
from lumitree.lamp.parts import Geometry, Part

_NUM_BULBS = 5
_ARM_RADIUS = 0.125  # from the lamp's axis to a bulb's, metres
_BULB_HEIGHT = -0.205  # y of a bulb's origin in the lamp, metres
_RADIANCE = (30.0, 20.0, 10.5)
_PEAR = ((0, -0.122), (0.024, -0.122), (0.038, -0.104), (0.0375, -0.072), (0.026, -0.046))
_BULB = HangingBulb(_PEAR, Filament(4, cage=0.0155, spacing=0.0155, top=-0.054, bottom=-0.09))


def build() -> Geometry:
    """The lamp's parts and materials."""
    turns = tuple(around(_NUM_BULBS))
    sites = tuple(turn @ at(_ARM_RADIUS, _BULB_HEIGHT) for turn in turns)
    parts = (
        Part("frame_body", _body(), "brass", (np.eye(4),)),
        Part("frame_arm", _arm(), "black", turns),
        Part("socket", socket(), "brass", sites),
        *_BULB.parts("bulb", sites, "glass", "filament"),
    )
    filament = emitting(TUNGSTEN, "filament", _RADIANCE)
    return Geometry(parts, (BRASS, BLACK_STEEL, STEEL, GLASS, filament))


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
