"""Incandescent bulbs: glass, cap, socket, supports and coiled filament.

The frame of a hanging bulb has its origin on its axis where the glass leaves the cap, and the bulb
hangs to -y. The frame of a flame bulb has its origin where the glass leaves the candle, and the
bulb stands to +y. Walls are solid and nothing touches them: see `lumitree.lamp.builtin`.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lumitree.lamp.builtin.layout import polar
from lumitree.lamp.meshes import (
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
from lumitree.lamp.parts import Part

# Outline of the glass inside the screw cap, which has 0.6 mm of clearance around it.
NECK = ((0.0125, -0.024), (0.0118, -0.004), (0.0118, 0.015), (0.0, 0.015))
_SUPPORT = 0.0006  # radius of the support wires, metres
_STEM_FOOT = -0.044  # y of the lowest point of the stem inside a bulb, metres


@dataclasses.dataclass(frozen=True)
class Filament:
    """A coiled wire in a zigzag of upright legs around a cylinder, lengths in metres.

    Attributes:
        legs: their number, a multiple of 4.
        cage: radius of the cylinder.
        spacing: distance of neighbouring legs along the cylinder.
        top, bottom: y of the ends of the legs' straight part.
        coil: radius of the coil.
        pitch: length of the coil for one turn.
        samples: points for one turn.
        wire: radius of the wire.
    """

    legs: int
    cage: float
    spacing: float
    top: float
    bottom: float
    coil: float = 0.003
    pitch: float = 0.0062
    samples: int = 14
    wire: float = 0.0012

    def azimuth(self, leg: float) -> float:
        """Azimuth in radians of a leg, counted from 0; of the turn between two at n + 1/2."""
        return (leg - (self.legs - 1) / 2) * self.spacing / self.cage


@dataclasses.dataclass(frozen=True)
class HangingBulb:
    """A screw bulb with its socket.

    `outside` are control points of the glass's outer profile below `NECK`, from the axis up;
    `inside` is the inner profile [N, 2] from axis to axis, where the wall, in metres, is not of one
    thickness. `stem` adds a glass stem.
    """

    outside: ArrayLike
    filament: Filament
    wall: float = 0.0012
    inside: ArrayLike | None = None
    stem: bool = True

    def parts(
        self, prefix: str, sites: Sequence[Floats], glass: str, filament: str
    ) -> tuple[Part, ...]:
        """Cap, glass, supports and filament at the sites, `world_from_bulb` [4, 4].

        Materials other than `glass` and `filament` are "steel".
        """
        places = tuple(sites)
        return (
            Part(f"{prefix}_cap", screw_cap(), "steel", places),
            Part(f"{prefix}_glass", self.glass(), glass, places),
            Part(f"{prefix}_supports", supports(self.filament), "steel", places),
            Part(f"{prefix}_filament", coiled(self.filament), filament, places),
        )

    def glass(self) -> Mesh:
        """Wall of the bulb and the solid stem inside it; closed surfaces."""
        outer = resample(smooth([*np.asarray(self.outside).tolist(), *NECK]), 34)
        if self.inside is None:
            inner = resample(offset(outer, self.wall), 34)
        else:
            inner = np.asarray(self.inside, np.float64)
        surfaces = [lathe(outer, 48, crease=90), lathe(inner[::-1], 48, crease=90)]
        if self.stem:
            stem = [[0, _STEM_FOOT], [0.004, -0.044], [0.003, -0.034], [0.0028, -0.014]]
            stem += [[0.0065, 0.0], [0.0065, 0.008], [0, 0.008]]
            surfaces.append(lathe(resample(smooth(stem), 20), 24, crease=90))
        return join(surfaces)


def socket() -> Mesh:
    """Cup that the cap is screwed into, with a beaded rim; it ends 52 mm above the glass."""
    inside = [[0, 0.032], [0.0156, 0.032], [0.0156, 0.005]]
    rim = [[0.0195, 0.005], [0.0205, 0.0065], [0.0195, 0.008], [0.0185, 0.0085]]
    outside = [[0.0185, 0.036], [0.016, 0.042], [0.009, 0.045], [0.0075, 0.052], [0, 0.052]]
    return lathe(inside + rim + outside, 48)


def screw_cap() -> Mesh:
    """Screw cap; the neck of the glass ends inside it."""
    inside = [[0, 0.02], [0.0126, 0.02], [0.0126, -0.003], [0.0134, -0.003]]
    angle = np.linspace(0, 4 * 2 * np.pi, 33)
    thread = np.column_stack([0.0138 - 0.0006 * np.cos(angle), np.linspace(0, 0.02, 33)])
    return lathe([*inside, *thread, [0.008, 0.026], [0, 0.026]], 48)


def coiled(filament: Filament) -> Mesh:
    """The filament's wire."""
    line = coil(_zigzag(filament), filament.coil, filament.pitch, filament.samples)
    return sweep(line, filament.wire, 6)


def _zigzag(filament: Filament) -> Floats:
    """Axis of the coil [N, 3]: legs joined by half circles, wrapped around the cylinder."""
    legs, spacing = filament.legs, filament.spacing
    turn = np.linspace(0, np.pi, 25)
    arc = spacing / 2 * np.column_stack([-np.cos(turn), np.sin(turn)])
    side = (legs - 1) / 2 * spacing
    pieces = [np.array([[-side, filament.top]])]
    for leg in range(legs - 1):
        end, sign = (filament.bottom, -1) if leg % 2 == 0 else (filament.top, 1)
        pieces.append(arc * [1, sign] + [(leg - (legs - 2) / 2) * spacing, end])
    pieces.append(np.array([[side, filament.top]]))
    flat = resample(np.concatenate(pieces), 50 * legs)
    return polar(flat[:, 0] / filament.cage, filament.cage, flat[:, 1])


def supports(filament: Filament) -> Mesh:
    """Two leads from the cap, and hooks from a button below the stem to the filament's turns."""
    button = lathe(smooth([[0, -0.05], [0.003, -0.05], [0.003, -0.0445], [0, -0.0445]], 2), 16)
    cage, legs = filament.cage, filament.legs
    foot = filament.bottom - filament.spacing / 2
    wires: list[Floats] = []
    for leg in (0, legs - 1):
        radius = [0.0085, 0.0085, cage, cage]
        wires.append(polar(filament.azimuth(leg), radius, [0.01, -0.024, -0.034, filament.top]))
    wires.append(polar(0.0, [0, 0], [-0.047, foot + 0.002]))
    for leg in range(0, legs // 2, 2):
        # One wire carries a lower turn and the one opposite it.
        yoke = filament.azimuth(legs - 1.5 - leg) * np.array([-1.0, -1.0, 0.0, 1.0, 1.0])
        wires.append(polar(yoke, [cage, cage / 2, 0, cage / 2, cage], [foot] * 5))
    for leg in range(1, legs - 2, 2):
        top = filament.top + filament.spacing / 2
        wires.append(polar(filament.azimuth(leg + 0.5), [0, 0.004, cage], [-0.047, -0.047, top]))
    tubes = [sweep(resample(smooth(wire), 24), _SUPPORT, 8) for wire in wires]
    return join([button, *tubes])


_FLAME = (
    (0, -0.012),
    (0.0062, -0.012),
    (0.0062, -0.001),
    (0.0105, 0.008),
    (0.0185, 0.022),
    (0.0185, 0.044),
    (0.0115, 0.061),
    (0.0055, 0.078),
    (0.0028, 0.09),
    (0, 0.09),
)


def flame_bulb(prefix: str, sites: Sequence[Floats], glass: str, filament: str) -> tuple[Part, ...]:
    """Candle bulb 0.1 m tall with supports of "steel"; sites are `world_from_flame` [4, 4]."""
    places = tuple(sites)
    return (
        Part(f"{prefix}_glass", _flame_glass(), glass, places),
        Part(f"{prefix}_supports", _flame_supports(), "steel", places),
        Part(f"{prefix}_filament", _flame_filament(), filament, places),
    )


def _flame_glass() -> Mesh:
    """Wall of the bulb: an outer and an inner closed surface."""
    outer = resample(smooth(_FLAME), 26)
    inner = resample(offset(outer, 0.0009), 26)
    return join([lathe(outer, 28, crease=90), lathe(inner[::-1], 28, crease=90)])


def _flame_filament() -> Mesh:
    """Coiled hairpin."""
    leg = [[0.0032, 0.014, 0], [0.0068, 0.026, 0], [0.0062, 0.042, 0]]
    mirrored = [[-x, y, z] for x, y, z in reversed(leg)]
    line = resample(smooth([*leg, [0.0, 0.052, 0], *mirrored]), 80)
    return sweep(coil(line, 0.0021, 0.0048, 12), 0.0009, 5)


def _flame_supports() -> Mesh:
    """Two leads and the post between them, from inside the neck."""
    lead = [[0.0028, -0.006, 0], [0.0028, 0.006, 0], [0.0032, 0.014, 0]]
    post = [[0, -0.006, 0], [0, 0.01, 0]]
    wires = [np.array(lead), np.array(lead) * [-1, 1, 1]]
    tubes = [sweep(resample(smooth(wire), 10), _SUPPORT, 8) for wire in wires]
    return join([*tubes, sweep(post, 0.0016, 12)])
