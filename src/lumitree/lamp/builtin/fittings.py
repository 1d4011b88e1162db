"""Fittings of lamps: places, materials, canopies, chains, candles, plates, and incandescent bulbs.

Lengths are in metres. Places are transforms `lamp_from_part` [4, 4]. The frame of a hanging bulb
has its origin on its axis where the glass leaves the cap, and the bulb hangs to -y. The frame of a
flame bulb has its origin where the glass leaves the candle, and the bulb stands to +y. Walls of
glass are solid and nothing touches them: see `lumitree.lamp.builtin`.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lumitree.asset.materials import Diffuse, MetallicRoughness, RoughConductor
from lumitree.core.frames import rotation, similarity
from lumitree.core.photometry import RGB
from lumitree.lamp.materials import WHITE, Material, glass
from lumitree.lamp.meshes import (
    Floats,
    Mesh,
    coil,
    facets,
    join,
    lathe,
    moved,
    offset,
    resample,
    skin,
    smooth,
    sweep,
)
from lumitree.lamp.parts import Part


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0, *, turn: float = 0.0) -> Floats:
    """Place [4, 4] at a point, metres, turned about y by `turn` degrees."""
    return similarity(rotation([0, 1, 0], turn), translation=[x, y, z])


def around(count: int, radius: float = 0.0, y: float = 0.0, first: float = 0.0) -> list[Floats]:
    """Places [4, 4] evenly on a horizontal circle about the y axis, with +x away from the axis.

    `first` is the azimuth of the first place, degrees, 0 at +x; lengths are in metres.
    """
    return [at(turn=first + 360 * i / count) @ at(radius, y) for i in range(count)]


def aimed(axis: ArrayLike, point: ArrayLike) -> Floats:
    """Place [4, 4] at a point [3], with +y turned the shortest way to `axis` [3]."""
    axis = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    pivot = np.cross([0.0, 1.0, 0.0], axis)
    length = float(np.linalg.norm(pivot))
    angle = np.degrees(np.arctan2(length, axis[1]))
    turn = rotation(pivot if length > 1e-9 else [1.0, 0.0, 0.0], angle)
    return similarity(turn, translation=point)


def polar(azimuth: Floats | float, radius: Floats | float | list, y: Floats | list) -> Floats:
    """Points [N, 3] at an azimuth (radians, 0 at +x), distance from the y axis, and height."""
    x, z = np.multiply(radius, np.cos(azimuth)), np.multiply(radius, -np.sin(azimuth))
    return np.column_stack([x, np.asarray(y), z])


# Rough surfaces of the built-in lamps keep the microfacets with which the lamps were measured.
BECKMANN = "beckmann"


def rough_metal(name: str, tint: RGB, roughness: float, conductor: str) -> Material:
    """A rough conductor; arguments as of `lamp.materials.metal`."""
    return Material(
        name,
        RoughConductor(
            material=conductor,
            distribution=BECKMANN,
            alpha=roughness**2,
            specular_reflectance=tint,
        ),
    )


GLASS = Material("glass", glass())
CRYSTAL = Material("crystal", glass(1.56))
WAX = Material("wax", Diffuse(reflectance=(0.82, 0.76, 0.64)))
OPAL_SHEET = Material(
    "opal_sheet",
    MetallicRoughness(base_color=(0.93, 0.88, 0.78), roughness=0.6, diff_trans=1.1, thin=True),
)
# Gold with a darker tint: Mitsuba has no data for brass.
BRASS = rough_metal("brass", (0.95, 0.86, 0.86), 0.45, "Au")
BRONZE = rough_metal("bronze", (0.3, 0.27, 0.25), 0.5, "Cu")
BLACK_STEEL = rough_metal("black", (0.15, 0.14, 0.13), 0.55, "Cr")
STEEL = rough_metal("steel", WHITE, 0.5, "Cr")
TUNGSTEN = rough_metal("tungsten", WHITE, 0.55, "W")


def emitting(material: Material, name: str, radiance: RGB) -> Material:
    """The material under another name, emitting `radiance`, W/(m² sr)."""
    return dataclasses.replace(material, name=name, radiance=radiance)


def canopy(radius: float, height: float) -> Mesh:
    """Domed rose under the ceiling at y = 0, with a collar on its axis; metres."""
    profile = [[0, -1.35], [0.12, -1.35], [0.14, -1.3], [0.14, -1.05], [0.2, -1.0], [0.5, -0.88]]
    profile += [[0.85, -0.55], [0.97, -0.3], [1, -0.25], [1, 0], [0, 0]]
    return lathe([*smooth(np.multiply(profile[:-2], [radius, height]), 3), [radius, 0], [0, 0]], 64)


def rod(top: float, bottom: float, radius: float) -> Mesh:
    """Upright rod on the y axis, metres."""
    return lathe([[0, bottom], [radius, bottom], [radius, top], [0, top]], 24)


def band(inner: float, outer: float, bottom: float, top: float, segments: int = 128) -> Mesh:
    """Flat hoop about the y axis with chamfered edges, metres."""
    bevel = 0.15 * min(outer - inner, top - bottom)
    corners = [[outer, bottom + bevel], [outer, top - bevel], [outer - bevel, top]]
    corners += [[inner + bevel, top], [inner, top - bevel], [inner, bottom + bevel]]
    corners += [[inner + bevel, bottom], [outer - bevel, bottom], corners[0]]
    return lathe(corners, segments)


def hoop(radius: float, wire: float, segments: int = 96) -> Mesh:
    """Round wire bent to a horizontal circle about the origin, metres."""
    angle = np.linspace(0, 2 * np.pi, 13) + np.pi / 2
    return lathe(np.column_stack([radius + wire * np.cos(angle), wire * np.sin(angle)]), segments)


def chain(top: float, bottom: float, link: float) -> Mesh:
    """Chain on the y axis between two heights, of oval links `link` long; metres."""
    wire = 0.075 * link
    count = max(2, round((top - bottom - link) / (0.78 * link)) + 1)
    angle = np.linspace(0, 2 * np.pi, 33)
    oval = np.column_stack([0.3 * np.sin(angle), 0.5 * np.cos(angle), 0 * angle])
    oval[:, 1] += 0.12 * np.sign(oval[:, 1]) * (np.abs(oval[:, 1]) > 0.1) - 0.12 * oval[:, 1] / 0.5
    ring = sweep(oval * link * [1, 0.93, 1], wire, 10)
    heights = np.linspace(top - link / 2, bottom + link / 2, count)
    return join([moved(ring, at(0, y, 0, turn=90 * (i % 2))) for i, y in enumerate(heights)])


def strut(start: ArrayLike, end: ArrayLike, radius: float, segments: int = 12) -> Mesh:
    """Straight round bar between two points [3], metres."""
    return sweep(np.array([start, end], np.float64), radius, segments)


def candle(height: float) -> Mesh:
    """Candle sleeve that stands on y = 0; a flame bulb's origin goes 2 mm below its top."""
    inside = [[0.0078, height - 0.02], [0, height - 0.02]]
    rim = [[0.0112, height - 0.002], [0.0105, height], [0.0088, height], [0.0078, height - 0.001]]
    foot = [[0, 0], [0.0112, 0]]
    return lathe([*foot, *rim, *inside], 32)


def drip_pan(radius: float) -> Mesh:
    """Turned dish with a cup for a candle; the candle stands at y = 0, metres."""
    under = [[0, -0.022], [0.3, -0.02], [0.26, -0.012], [0.5, -0.008], [0.85, -0.002], [1, 0.006]]
    lip = [[1.02, 0.0075], [1.0, 0.0085], [0.86, 0.002]]
    over = [[0.55, -0.002], [0.45, 0.0], [0.42, 0.012], [0.46, 0.02], [0.4, 0.021], [0.36, 0.006]]
    profile = np.array([*under, *lip, *over, [0, 0.004]]) * [radius, 1]
    return lathe(resample(smooth(profile, 3), 34), 36)


def arch(width: float, bottom: float, spring: float) -> Floats:
    """Outline [N, 2] of an opening whose round head begins at `spring`, counter-clockwise; m."""
    angle = np.radians(np.linspace(0, 180, 33))
    head = width / 2 * np.column_stack([np.cos(angle), np.sin(angle)]) + [0, spring]
    return np.concatenate([[[-width / 2, bottom], [width / 2, bottom]], head])


def sheet(outline: ArrayLike) -> Mesh:
    """Single sheet [N, 3] within a flat convex outline, faced where it is counter-clockwise."""
    outline = np.asarray(outline, np.float64)
    centre = np.broadcast_to(outline.mean(axis=0), outline.shape)
    return facets(np.stack([centre, outline, np.roll(outline, -1, axis=0)], axis=1))


def pane(outline: ArrayLike, thickness: float) -> Mesh:
    """Closed plate within a convex outline [N, 2], counter-clockwise; metres."""
    front = _raised(np.asarray(outline, np.float64), thickness / 2)
    back = front * [1, 1, -1]
    centre = front.mean(axis=0)
    after, behind = np.roll(front, -1, axis=0), np.roll(back, -1, axis=0)
    middle = np.broadcast_to(centre, front.shape)
    fan = [np.stack([middle, front, after], axis=1)]
    fan.append(np.stack([middle * [1, 1, -1], behind, back], axis=1))
    rim = [np.stack([front, back, behind], axis=1), np.stack([front, behind, after], axis=1)]
    return facets(np.concatenate(fan + rim))


def pierced(
    opening: ArrayLike, left: float, right: float, bottom: float, top: float, thickness: float
) -> Mesh:
    """Closed rectangular plate with an opening, star-shaped about its mean point; metres.

    The outline [N, 2] is counter-clockwise, the thickness along z.
    """
    inner = np.asarray(opening, np.float64)
    centre = inner.mean(axis=0)
    corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
    inner, outer = _matched(inner, corners, centre)
    half = thickness / 2
    loops = [_raised(outer, half), _raised(inner, half), _raised(inner, -half)]
    loops += [_raised(outer, -half), _raised(outer, half)]
    # From the outer rim inwards over the front, through the opening, and back outside.
    mesh = skin(
        np.stack(loops), np.zeros((len(loops), len(inner), 3)), np.ones(len(loops) - 1, bool)
    )
    return facets(mesh.vertices[mesh.faces])


def _matched(inner: Floats, corners: Floats, centre: Floats) -> tuple[Floats, Floats]:
    """Points of both outlines in the same directions from the centre, at all their corners."""
    angles = [np.arctan2(*(line - centre).T[::-1]) for line in (inner, corners)]
    directions = np.unique(np.concatenate(angles).round(9))
    return _seen(inner, centre, directions), _seen(corners, centre, directions)


def _seen(outline: Floats, centre: Floats, directions: Floats) -> Floats:
    """Points [M, 2] of a closed outline in directions from the centre, radians."""
    start = outline - centre
    step = np.roll(start, -1, axis=0) - start
    ray = np.column_stack([np.cos(directions), np.sin(directions)])[:, None]
    det = ray[..., 0] * step[:, 1] - ray[..., 1] * step[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (start[:, 0] * step[:, 1] - start[:, 1] * step[:, 0]) / det
        along = (start[:, 0] * ray[..., 1] - start[:, 1] * ray[..., 0]) / det
    hit = (reach > 0) & (along > -1e-6) & (along < 1 + 1e-6)
    reach = np.where(hit, reach, np.inf).min(axis=1)
    return centre + reach[:, None] * ray[:, 0]


def _raised(outline: Floats, z: float) -> Floats:
    return np.column_stack([outline, np.full(len(outline), z)])


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
        """Cap, glass, supports and filament at the sites, `world_from_bulb` [4, 4]."""
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


_FLAME = ((0, -0.012), (0.0062, -0.012), (0.0062, -0.001), (0.0105, 0.008), (0.0185, 0.022))
_FLAME += ((0.0185, 0.044), (0.0115, 0.061), (0.0055, 0.078), (0.0028, 0.09), (0, 0.09))


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
