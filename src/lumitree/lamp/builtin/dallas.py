"""`dallas`: eight clear bulbs below a black steel hoop, 0.65 m.

A stand-in for the paper's Dallas, not its model: like that one, it emits mostly along
caustic paths, through clear bulbs with coiled filaments.
"""

import numpy as np

from lumitree.lamp.builtin.fittings import band, canopy, rod, strut
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
from lumitree.lamp.meshes import Mesh, join, lathe, moved, smooth
from lumitree.lamp.parts import Geometry, Part

_NUM_BULBS = 8
_HOOP = 0.29  # radius, metres
_HOOP_TOP = -0.36  # y, metres
_HUB = -0.2  # y where the rods meet, metres
_RADIANCE = (20.0, 12.6, 6.2)
_DROP = ((0, -0.148), (0.017, -0.148), (0.036, -0.134), (0.0345, -0.092), (0.026, -0.05))
_CAGE = Filament(
    8, cage=0.0145, spacing=0.0105, top=-0.056, bottom=-0.11, coil=0.0026, pitch=0.006, samples=11
)
_BULB = HangingBulb(_DROP, _CAGE)


def build() -> Geometry:
    """The lamp's parts and materials."""
    sites = [place @ at(0, _HOOP_TOP - 0.088) for place in around(_NUM_BULBS, _HOOP)]
    whole = (np.eye(4),)
    parts = (
        Part("frame_black", _hoop(), "black", whole),
        Part("frame_brass", _brass(), "brass", whole),
        Part("socket", join([socket(), rod(0.07, 0.04, 0.0075)]), "brass", tuple(sites)),
        *_BULB.parts("bulb", sites, "glass", "filament"),
    )
    filament = emitting(TUNGSTEN, "filament", _RADIANCE)
    return Geometry(parts, (BRASS, BLACK_STEEL, STEEL, GLASS, filament))


def _hoop() -> Mesh:
    """The hoop, four rods up to the hub, and the stem."""
    start, end = np.array([0.012, _HUB, 0, 1]), np.array([_HOOP, _HOOP_TOP + 0.012, 0, 1])
    rods = [strut((turn @ start)[:3], (turn @ end)[:3], 0.0035) for turn in around(4, first=22.5)]
    hoop = band(_HOOP - 0.005, _HOOP + 0.005, _HOOP_TOP - 0.036, _HOOP_TOP)
    return join([hoop, rod(-0.02, _HUB, 0.005), canopy(0.062, 0.024), *rods])


def _brass() -> Mesh:
    """Hub, the eyes of the rods, and two beads around the hoop."""
    hub = [[0, -0.032], [0.006, -0.032], [0.01, -0.024], [0.005, -0.017], [0.014, -0.013]]
    hub += [[0.022, -0.004], [0.022, 0.006], [0.012, 0.014], [0.008, 0.026], [0, 0.026]]
    knob = [[0, -0.004], [0.006, -0.004], [0.007, 0.004], [0.0052, 0.014], [0, 0.016]]
    eye = lathe(smooth(knob, 3), 24)
    eyes = [moved(eye, place) for place in around(4, _HOOP, _HOOP_TOP, first=22.5)]
    edges = [_HOOP_TOP - 0.0015, _HOOP_TOP - 0.0385]
    beads = [band(_HOOP - 0.0065, _HOOP + 0.0065, y - 0.0005, y + 0.0045) for y in edges]
    return join([moved(lathe(smooth(hub, 3), 48), at(0, _HUB)), *eyes, *beads])
