"""`cluster`: thirteen globes of cast glass, clear and tinted, hanging in a bunch, 0.56 m.

A stand-in for the paper's Cluster, not its model: the tinted glass is filled with an absorbing
medium, so that it needs volumetric path tracing, and it is the brightest of the five.
"""

import numpy as np

from lumitree.lamp.builtin.fittings import canopy, rod
from lumitree.lamp.builtin.incandescent import Filament, HangingBulb, socket
from lumitree.lamp.builtin.layout import at
from lumitree.lamp.builtin.materials import (
    BLACK_STEEL,
    BRASS,
    STEEL,
    TUNGSTEN,
    emitting,
)
from lumitree.lamp.meshes import Floats, resample, smooth
from lumitree.lamp.parts import Geometry, Glass, Material, Medium, Part

_RADIANCE = (40.0, 27.0, 14.0)
_SPACING = 0.08  # of neighbouring cables, metres
_CENTRE_LEVEL = -0.44  # y of the origin of the globe in the middle, metres
_INNER_LEVELS = (-0.35, -0.272)  # of the six around it, in turn
_OUTER_LEVELS = (-0.428, -0.195)  # of the six between and outside these, in turn
_RADIUS, _CENTRE = 0.05, -0.066  # of a globe, metres
_CAVITY_RADIUS, _CAVITY_CENTRE = 0.031, -0.06
_TINTS = {
    # Absorption per metre; the wall is 1 to 2.5 cm thick.
    "clear": None,
    "amber": Medium(absorption=(2.0, 20.0, 70.0)),
    "smoke": Medium(absorption=(36.0, 40.0, 46.0)),
    "rose": Medium(absorption=(3.0, 34.0, 26.0)),
}


def build() -> Geometry:
    """The lamp's parts and materials."""
    groups = _sites()
    everywhere = tuple(site for sites in groups.values() for site in sites)
    parts = [
        Part("canopy", canopy(0.145, 0.026), "brass", (np.eye(4),)),
        Part("socket", socket(), "brass", everywhere),
    ]
    for level, y in enumerate((_CENTRE_LEVEL, *_INNER_LEVELS, *_OUTER_LEVELS)):
        places = [site for site in everywhere if site[1, 3] == y]
        columns = tuple(at(place[0, 3], 0, place[2, 3]) for place in places)
        parts.append(Part(f"cable_{level + 1}", rod(-0.01, y + 0.045, 0.0022), "black", columns))
    for tint, sites in groups.items():
        parts += _globe().parts(tint, sites, f"glass_{tint}", "filament")
    glasses = [Material(f"glass_{tint}", Glass(medium=_TINTS[tint])) for tint in _TINTS]
    filament = emitting(TUNGSTEN, "filament", _RADIANCE)
    return Geometry(tuple(parts), (BRASS, BLACK_STEEL, STEEL, *glasses, filament))


def _sites() -> dict[str, list[Floats]]:
    """Places of the globes by tint: a triangular lattice, so that cables pass between globes."""
    lattice = [at(0, _CENTRE_LEVEL)]
    for i in range(6):
        lattice.append(at(turn=60 * i) @ at(_SPACING, _INNER_LEVELS[i % 2]))
    for i in range(6):
        lattice.append(at(turn=60 * i + 30) @ at(_SPACING * 3**0.5, _OUTER_LEVELS[i % 2]))
    names = ["clear", "amber", "smoke", "clear", "rose", "smoke", "amber"]
    names += ["smoke", "clear", "rose", "amber", "clear", "amber"]
    sites: dict[str, list[Floats]] = {tint: [] for tint in _TINTS}
    for place, name in zip(lattice, names, strict=True):
        sites[name].append(place)
    return sites


def _globe() -> HangingBulb:
    """Ball of cast glass around a cavity that holds the filament."""
    filament = Filament(4, cage=0.0105, spacing=0.0115, top=-0.055, bottom=-0.072, coil=0.003)
    outside = _arc(_RADIUS, _CENTRE, 72)
    neck = [[0.0106, -0.03], [0.0106, -0.01], [0.0106, 0.0138], [0, 0.0138]]
    inside = resample(smooth([*_arc(_CAVITY_RADIUS, _CAVITY_CENTRE, 62), *neck]), 40)
    return HangingBulb(outside, filament, inside=inside, stem=False)


def _arc(radius: float, centre: float, until: float) -> list[list[float]]:
    """Profile of a sphere from its lowest point to an elevation in degrees."""
    angle = np.radians(np.linspace(-90, until, 16))
    points = np.column_stack([radius * np.cos(angle), centre + radius * np.sin(angle)])
    points[0, 0] = 0.0
    return points.tolist()
