"""`arc`: an arc floor lamp, an opal globe on a long curved arm of steel, 2.05 m.

Its bounding box is almost empty: what is lit by it usually stands in the box.
"""

import numpy as np

from lumitree.lamp.builtin.incandescent import Filament, HangingBulb, socket
from lumitree.lamp.builtin.layout import at
from lumitree.lamp.builtin.materials import (
    BECKMANN,
    BRASS,
    GLASS,
    OPAL_SHEET,
    STEEL,
    TUNGSTEN,
    emitting,
)
from lumitree.lamp.meshes import Floats, Mesh, join, lathe, moved, resample, smooth, sweep
from lumitree.lamp.parts import Geometry, Material, Metal, Part, Principled

_RADIANCE = (150.0, 102.0, 55.0)
_REACH = 1.2  # from the axis of the foot to the globe's, metres
_BULB_HEIGHT = 1.56  # y of the bulb's origin, metres
_FOOT_RADIUS, _FOOT_HEIGHT = 0.19, 0.07  # metres
_GLOBE_RADIUS, _GLOBE_CENTRE = 0.15, -0.064  # metres; y of the centre in the bulb's frame
_NECK_RADIUS, _NECK_TOP = 0.044, 0.092  # of the globe's opening, metres; y in the bulb's frame
_HOLDER_TOP = 0.112  # y in the bulb's frame, metres
_SLEEVE_TOP = 0.62  # y where the arm leaves its lower, thicker tube, metres
_BULB_OUTSIDE = ((0, -0.128), (0.022, -0.128), (0.041, -0.108), (0.0405, -0.074), (0.026, -0.046))
_BULB = HangingBulb(
    _BULB_OUTSIDE, Filament(4, cage=0.0165, spacing=0.0165, top=-0.056, bottom=-0.094)
)
_MARBLE = Material("marble", Principled((0.74, 0.72, 0.69), roughness=0.35))
_BRUSHED_STEEL = Material("brushed_steel", Metal((1.0, 1.0, 1.0), 0.4, "Cr", BECKMANN))


def build() -> Geometry:
    """The lamp's parts and materials."""
    bulb, whole = (at(_REACH, _BULB_HEIGHT),), (np.eye(4),)
    parts = (
        Part("foot", _foot(), "marble", whole),
        Part("arm", _arm(), "brushed_steel", whole),
        Part("ferrules", _ferrules(), "brass", whole),
        Part("holder", _holder(), "brass", bulb),
        Part("socket", socket(), "brass", bulb),
        Part("globe", _globe(), "opal_sheet", bulb),
        *_BULB.parts("bulb", bulb, "glass", "filament"),
    )
    filament = emitting(TUNGSTEN, "filament", _RADIANCE)
    materials = (_MARBLE, _BRUSHED_STEEL, BRASS, STEEL, OPAL_SHEET, GLASS, filament)
    return Geometry(parts, materials)


def _foot() -> Mesh:
    """Round block of marble with rounded edges."""
    radius, height = _FOOT_RADIUS, _FOOT_HEIGHT
    edge = [[radius - 0.004, 0], [radius, 0.004], [radius, height - 0.014]]
    edge += [[radius - 0.004, height - 0.004], [radius - 0.014, height]]
    return lathe([[0, 0], *edge, [0, height]], 128)


def _arm() -> Mesh:
    """Upright tube and the thinner arc that rises from it and ends above the globe."""
    end = _BULB_HEIGHT + _HOLDER_TOP - 0.01
    lower = resample(np.array([[0, _FOOT_HEIGHT - 0.01], [0, _SLEEVE_TOP]]), 8)
    line = [[0, _SLEEVE_TOP - 0.02], [0, 1.3], [0.05, 1.78], [0.42, 2.05], [0.88, 2.03]]
    line += [[1.14, 1.9], [_REACH, 1.76], [_REACH, end + 0.03], [_REACH, end]]
    upper = resample(smooth(line), 160)
    return join([sweep(_flat(lower), 0.0155, 32), sweep(_flat(upper), 0.0095, 24)])


def _flat(line: Floats) -> Floats:
    """Points [N, 3] in the plane z = 0."""
    return np.column_stack([line, np.zeros(len(line))])


def _ferrules() -> Mesh:
    """Rosette on the foot, and the collar in which the arc can be turned, with its knob."""
    y = _FOOT_HEIGHT - 0.003
    rosette = [[0, y], [0.05, y], [0.05, y + 0.006], [0.03, y + 0.012], [0.021, y + 0.03]]
    rosette += [[0.0185, y + 0.05], [0.0165, y + 0.052], [0, y + 0.052]]
    y = _SLEEVE_TOP
    collar = [[0, y - 0.05], [0.0185, y - 0.05], [0.02, y - 0.046], [0.02, y - 0.004]]
    collar += [[0.016, y + 0.004], [0.0115, y + 0.012], [0, y + 0.012]]
    knob = [[0, 0], [0.005, 0], [0.005, 0.022], [0.013, 0.024], [0.013, 0.036], [0.01, 0.039]]
    # It points away from the globe.
    turned = np.array([[0.0, -1, 0, -0.015], [1, 0, 0, y - 0.026], [0, 0, 1, 0], [0, 0, 0, 1]])
    return join(
        [
            lathe(rosette, 64),
            lathe(collar, 48),
            moved(lathe([*knob, [0, 0.039]], 32), turned),
        ]
    )


def _holder() -> Mesh:
    """Cap over the neck of the globe, with a stem to the socket; in the bulb's frame."""
    inner, outer = _NECK_RADIUS + 0.0015, _NECK_RADIUS + 0.004
    low, top = _NECK_TOP - 0.014, _HOLDER_TOP
    inside = [[0, top - 0.016], [inner - 0.004, top - 0.016], [inner, top - 0.02], [inner, low]]
    outside = [
        [outer, low],
        [outer, top - 0.018],
        [outer - 0.008, top - 0.006],
        [0.02, top - 0.002],
    ]
    outside += [[0.014, top + 0.012], [0.0115, top + 0.018], [0, top + 0.018]]
    stem = lathe([[0, 0.046], [0.0075, 0.046], [0.0075, top - 0.012], [0, top - 0.012]], 24)
    return join([lathe(inside + outside, 64), stem])


def _globe() -> Mesh:
    """Sheet of opal glass with a neck, open at the top; in the bulb's frame."""
    start = np.arcsin(_NECK_RADIUS / _GLOBE_RADIUS)
    angle = np.linspace(np.pi, start, 64)
    line = _GLOBE_RADIUS * np.column_stack([np.sin(angle), np.cos(angle)]) + [0, _GLOBE_CENTRE]
    line[0, 0] = 0.0
    return lathe([*line, [_NECK_RADIUS, _NECK_TOP]], 128, crease=90)
