"""Lamps of screw bulbs: `bulbs`, `dallas`, `cluster` and `arc`."""

import numpy as np

from lumitree.asset.geometry import Medium
from lumitree.asset.materials import MetallicRoughness
from lumitree.lamp.builtin.fittings import (
    BLACK_STEEL,
    BRASS,
    GLASS,
    OPAL_SHEET,
    STEEL,
    TUNGSTEN,
    Filament,
    HangingBulb,
    around,
    at,
    band,
    canopy,
    emitting,
    rod,
    rough_metal,
    socket,
    strut,
)
from lumitree.lamp.materials import WHITE, Material, glass
from lumitree.lamp.meshes import Floats, Mesh, join, lathe, moved, resample, smooth, sweep
from lumitree.lamp.parts import Geometry, Part

_BULBS_COUNT = 5
_ARM_RADIUS = 0.125  # from the lamp's axis to a bulb's, metres
_BULBS_HEIGHT = -0.205  # y of a bulb's origin in the lamp, metres
_BULBS_RADIANCE = (30.0, 20.0, 10.5)
_PEAR = ((0, -0.122), (0.024, -0.122), (0.038, -0.104), (0.0375, -0.072), (0.026, -0.046))
_PEAR_BULB = HangingBulb(_PEAR, Filament(4, cage=0.0155, spacing=0.0155, top=-0.054, bottom=-0.09))


def build_bulbs() -> Geometry:
    """`bulbs`: clear bulbs with coil filaments on a brass and black steel frame."""
    turns = tuple(around(_BULBS_COUNT))
    sites = tuple(turn @ at(_ARM_RADIUS, _BULBS_HEIGHT) for turn in turns)
    parts = (
        Part("frame_body", _bulbs_body(), "brass", (np.eye(4),)),
        Part("frame_arm", _bulbs_arm(), "black", turns),
        Part("socket", socket(), "brass", sites),
        *_PEAR_BULB.parts("bulb", sites, "glass", "filament"),
    )
    filament = emitting(TUNGSTEN, "filament", _BULBS_RADIANCE)
    return Geometry(parts, (BRASS, BLACK_STEEL, STEEL, GLASS, filament))


def _bulbs_body() -> Mesh:
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


def _bulbs_arm() -> Mesh:
    """Swan-neck tube from the hub to the top of a socket, in the plane z = 0 of the lamp."""
    end = _BULBS_HEIGHT + 0.05
    line = [[0.015, -0.19], [0.05, -0.19], [0.072, -0.165], [0.082, -0.12]]
    line += [[_ARM_RADIUS, -0.1], [_ARM_RADIUS, end + 0.02], [_ARM_RADIUS, end]]
    path = resample(smooth(line), 40)
    return sweep(np.column_stack([path, np.zeros(len(path))]), 0.0042, 16)


_DALLAS_COUNT = 8
_HOOP = 0.29  # radius, metres
_HOOP_TOP = -0.36  # y, metres
_HUB = -0.2  # y where the rods meet, metres
_DALLAS_RADIANCE = (20.0, 12.6, 6.2)
_DROP = ((0, -0.148), (0.017, -0.148), (0.036, -0.134), (0.0345, -0.092), (0.026, -0.05))
_CAGE = Filament(
    8, cage=0.0145, spacing=0.0105, top=-0.056, bottom=-0.11, coil=0.0026, pitch=0.006, samples=11
)
_DROP_BULB = HangingBulb(_DROP, _CAGE)


def build_dallas() -> Geometry:
    """`dallas`: it emits mostly along caustic paths, like the paper's Dallas."""
    sites = [place @ at(0, _HOOP_TOP - 0.088) for place in around(_DALLAS_COUNT, _HOOP)]
    whole = (np.eye(4),)
    parts = (
        Part("frame_black", _hoop(), "black", whole),
        Part("frame_brass", _brass(), "brass", whole),
        Part("socket", join([socket(), rod(0.07, 0.04, 0.0075)]), "brass", tuple(sites)),
        *_DROP_BULB.parts("bulb", sites, "glass", "filament"),
    )
    filament = emitting(TUNGSTEN, "filament", _DALLAS_RADIANCE)
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


_CLUSTER_RADIANCE = (40.0, 27.0, 14.0)
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


def build_cluster() -> Geometry:
    """`cluster`: its tinted glass has an absorbing medium. It is the brightest stand-in."""
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
        parts += _cast_globe().parts(tint, sites, f"glass_{tint}", "filament")
    glasses = [Material(f"glass_{tint}", glass(), medium=_TINTS[tint]) for tint in _TINTS]
    filament = emitting(TUNGSTEN, "filament", _CLUSTER_RADIANCE)
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


def _cast_globe() -> HangingBulb:
    """Ball of cast glass around a cavity that holds the filament."""
    filament = Filament(4, cage=0.0105, spacing=0.0115, top=-0.055, bottom=-0.072, coil=0.003)
    outside = _sphere_profile(_RADIUS, _CENTRE, 72)
    neck = [[0.0106, -0.03], [0.0106, -0.01], [0.0106, 0.0138], [0, 0.0138]]
    inside = resample(smooth([*_sphere_profile(_CAVITY_RADIUS, _CAVITY_CENTRE, 62), *neck]), 40)
    return HangingBulb(outside, filament, inside=inside, stem=False)


def _sphere_profile(radius: float, centre: float, until: float) -> list[list[float]]:
    """Profile of a sphere from its lowest point to an elevation in degrees."""
    angle = np.radians(np.linspace(-90, until, 16))
    points = np.column_stack([radius * np.cos(angle), centre + radius * np.sin(angle)])
    points[0, 0] = 0.0
    return points.tolist()


_ARC_RADIANCE = (150.0, 102.0, 55.0)
_REACH = 1.2  # from the axis of the foot to the globe's, metres
_ARC_BULB_HEIGHT = 1.56  # y of the bulb's origin, metres
_FOOT_RADIUS, _FOOT_HEIGHT = 0.19, 0.07  # metres
_GLOBE_RADIUS, _GLOBE_CENTRE = 0.15, -0.064  # metres; y of the centre in the bulb's frame
_NECK_RADIUS, _NECK_TOP = 0.044, 0.092  # of the globe's opening, metres; y in the bulb's frame
_HOLDER_TOP = 0.112  # y in the bulb's frame, metres
_SLEEVE_TOP = 0.62  # y where the arm leaves its lower, thicker tube, metres
_BULB_OUTSIDE = ((0, -0.128), (0.022, -0.128), (0.041, -0.108), (0.0405, -0.074), (0.026, -0.046))
_ARC_BULB = HangingBulb(
    _BULB_OUTSIDE, Filament(4, cage=0.0165, spacing=0.0165, top=-0.056, bottom=-0.094)
)
_MARBLE = Material("marble", MetallicRoughness(base_color=(0.74, 0.72, 0.69), roughness=0.35))
_BRUSHED_STEEL = rough_metal("brushed_steel", WHITE, 0.4, "Cr")


def build_arc() -> Geometry:
    """`arc`: its bounding box is almost empty, so what it illuminates usually stands in the box."""
    bulb, whole = (at(_REACH, _ARC_BULB_HEIGHT),), (np.eye(4),)
    parts = (
        Part("foot", _foot(), "marble", whole),
        Part("arm", _arc_arm(), "brushed_steel", whole),
        Part("ferrules", _ferrules(), "brass", whole),
        Part("holder", _holder(), "brass", bulb),
        Part("socket", socket(), "brass", bulb),
        Part("globe", _opal_globe(), "opal_sheet", bulb),
        *_ARC_BULB.parts("bulb", bulb, "glass", "filament"),
    )
    filament = emitting(TUNGSTEN, "filament", _ARC_RADIANCE)
    materials = (_MARBLE, _BRUSHED_STEEL, BRASS, STEEL, OPAL_SHEET, GLASS, filament)
    return Geometry(parts, materials)


def _foot() -> Mesh:
    """Round block of marble with rounded edges."""
    radius, height = _FOOT_RADIUS, _FOOT_HEIGHT
    edge = [[radius - 0.004, 0], [radius, 0.004], [radius, height - 0.014]]
    edge += [[radius - 0.004, height - 0.004], [radius - 0.014, height]]
    return lathe([[0, 0], *edge, [0, height]], 128)


def _arc_arm() -> Mesh:
    """Upright tube and the thinner arc that rises from it and ends above the globe."""
    end = _ARC_BULB_HEIGHT + _HOLDER_TOP - 0.01
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
    knob = moved(lathe([*knob, [0, 0.039]], 32), turned)
    return join([lathe(rosette, 64), lathe(collar, 48), knob])


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


def _opal_globe() -> Mesh:
    """Sheet of opal glass with a neck, open at the top; in the bulb's frame."""
    start = np.arcsin(_NECK_RADIUS / _GLOBE_RADIUS)
    angle = np.linspace(np.pi, start, 64)
    line = _GLOBE_RADIUS * np.column_stack([np.sin(angle), np.cos(angle)]) + [0, _GLOBE_CENTRE]
    line[0, 0] = 0.0
    return lathe([*line, [_NECK_RADIUS, _NECK_TOP]], 128, crease=90)
