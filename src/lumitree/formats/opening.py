"""The luminous opening of a photometric file: the surface that its light comes from.

Photometric files state the sides of the opening, and its shape by their signs or by zeros. The
frame is the luminaire file's, see `type_c`: x along C = 0, y up, z along C = 270.
"""

import dataclasses
import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import Outline
from lumitree.errors import LumitreeError

Array = NDArray[np.float64]
Shape = Literal["box", "ellipsoid", "cylinder"]
Sides = tuple[float, float, float]
_MAX_SIDE = 1e6
_CYLINDERS: tuple[Outline, ...] = ("cylinder-x", "cylinder-y", "cylinder-z")
# Points of the quadrature of a surface. Flat ones are cheap, since all directions share them.
_NUM_SIDE, _NUM_ROUND, _NUM_DISK, _NUM_ELLIPSOID = 20, 80, 512, 3072
_NUM_FLAT_SIDE, _NUM_FLAT_DISK = 64, 1 << 14
# Part of the light that may start outside of an opening, and rounds of the search for its box.
_OUTSIDE, _ROUNDS = 0.02, 4
# A side shorter than this part of the longest is none; axes that differ by less are a circle.
_THIN, _ROUND = 1e-3, 0.05

# Shapes of IES LM-63 by the signs of width, length and height: the shape; the axis of a cylinder
# (0: x, along C = 0; 1: up; 2: z, along C = 90); and a dimension that a zero repeats.
_WIDTH, _LENGTH, _HEIGHT = 0, 1, 2
_Rule = tuple[Shape, int, dict[int, int]]
_RULES: dict[tuple[int, int, int], _Rule] = {
    # Circle, ellipse, vertical cylinder: the first two as in 2002 and 2019, the others as in 1995.
    (-1, -1, 0): ("cylinder", 1, {}),
    (-1, -1, 1): ("cylinder", 1, {}),
    (-1, 0, 0): ("cylinder", 1, {_LENGTH: _WIDTH}),
    (-1, 0, 1): ("cylinder", 1, {_LENGTH: _WIDTH}),
    (0, -1, 0): ("cylinder", 1, {_WIDTH: _LENGTH}),
    (0, -1, 1): ("cylinder", 1, {_WIDTH: _LENGTH}),
    (-1, 1, 0): ("cylinder", 1, {}),
    (-1, 1, 1): ("cylinder", 1, {}),
    (1, -1, 0): ("cylinder", 1, {}),
    (1, -1, 1): ("cylinder", 1, {}),
    # Sphere and spheroid.
    (-1, -1, -1): ("ellipsoid", 1, {}),
    # Horizontal cylinders of 1995, along the length and along the width.
    (0, 1, -1): ("cylinder", 0, {_WIDTH: _HEIGHT}),
    (1, 0, -1): ("cylinder", 2, {_LENGTH: _HEIGHT}),
    # A vertical circle that faces C = 90; none of the tables has it.
    (0, -1, -1): ("cylinder", 2, {}),
}
# Signs that mean one shape until 1995, and another one since 2002.
_RULES_1995: dict[tuple[int, int, int], _Rule] = {
    (-1, 0, -1): ("ellipsoid", 1, {_LENGTH: _WIDTH}),
    (-1, 1, -1): ("ellipsoid", 1, {}),
    (1, -1, -1): ("ellipsoid", 1, {}),
}
_RULES_2002: dict[tuple[int, int, int], _Rule] = {
    (-1, 0, -1): ("cylinder", 0, {}),
    (-1, 1, -1): ("cylinder", 0, {}),
    (1, -1, -1): ("cylinder", 2, {}),
}


@dataclasses.dataclass(frozen=True)
class Opening:
    """A luminous opening, centred at the origin.

    Attributes:
        sides: [3] of its bounding box along x, y and z, m; 0 for a flat opening, a line or a point.
        shape: "box" fills the bounding box; "ellipsoid" and "cylinder" are inscribed.
        axis: 0, 1 or 2, along which a cylinder extends. A disk is a cylinder without length.
        heights: of the luminous sides of a box or a vertical cylinder that face C = 0, 90, 180 and
            270, m, from its lower face up; the height of a cylinder is linear between them. None
            if all sides are luminous up to the upper face.

    Raises:
        LumitreeError: a side is negative, not finite or above 1e6 m, or a height exceeds its side.
    """

    sides: Sides = (0.0, 0.0, 0.0)
    shape: Shape = "box"
    axis: int = 1
    heights: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse sides out of range."""
        if not all(0 <= side <= _MAX_SIDE for side in self.sides):
            raise LumitreeError(f"the opening is {self.sides} m; expected 0 to {_MAX_SIDE:g}")
        if self.heights and not all(0 <= height <= self.sides[1] for height in self.heights):
            raise LumitreeError(
                f"its sides are luminous up to {self.heights} m; expected 0 to {self.sides[1]:g}"
            )

    def __str__(self) -> str:
        x, up, z = self.sides
        if max(self.sides) == 0:
            return "point"
        flat = "disk" if self.is_round else "ellipse"
        name = {
            "box": "rectangle" if self.is_flat else "box",
            "ellipsoid": flat if self.is_flat else "ellipsoid",
            "cylinder": f"cylinder, axis {('C0', 'up', 'C90')[self.axis]}",
        }[self.shape]
        if self.shape == "cylinder" and self.sides[self.axis] == 0:
            name = flat if self.axis == 1 else f"disk that faces {('C0', '', 'C90')[self.axis]}"
        return f"{name}, {x:.4g} x {z:.4g} x {up:.4g} m (C0, C90, up)"

    @property
    def outline(self) -> Outline:
        """Its shape in its bounding box; a point is seen as a ball."""
        if max(self.sides) == 0:
            return "ellipsoid"
        return _CYLINDERS[self.axis] if self.shape == "cylinder" else self.shape

    def scaled(self, factor: float) -> "Opening":
        """The opening with all lengths times a factor."""
        x, up, z = (factor * side for side in self.sides)
        heights = None
        if self.heights is not None:
            c0, c90, c180, c270 = (factor * height for height in self.heights)
            heights = (c0, c90, c180, c270)
        return dataclasses.replace(self, sides=(x, up, z), heights=heights)

    @property
    def is_flat(self) -> bool:
        """Whether it has no volume: a surface, a line or a point."""
        return min(self.sides) == 0

    @property
    def is_round(self) -> bool:
        """Whether it is a disk, an ellipsoid or a cylinder whose horizontal section is a circle."""
        x, _, z = self.sides
        return self.shape != "box" and self.axis == 1 and math.isclose(x, z, rel_tol=1e-6)

    def projected_area(self, direction: Array) -> Array:
        """Area [...], m², seen from where light in unit directions [..., 3] arrives."""
        x, up, z = self.sides
        dx, dy, dz = across = np.abs(np.moveaxis(direction, -1, 0))
        if self.shape == "ellipsoid":
            return np.pi / 4 * np.linalg.norm(direction * [up * z, x * z, x * up], axis=-1)
        c0, c90, c180, c270 = self.heights or 4 * (up,)
        if self.shape == "box":
            facing_x = z * np.where(direction[..., 0] > 0, c0, c180)
            facing_z = x * np.where(direction[..., 2] < 0, c90, c270)
            return facing_x * dx + x * z * dy + facing_z * dz
        # A cylinder: its cap, and the outline of its side.
        first, second = (each for each in range(3) if each != self.axis)
        width, depth = self.sides[first], self.sides[second]
        azimuth = np.rad2deg(np.arctan2(-direction[..., 2], direction[..., 0])) % 360
        height = np.interp(azimuth, 90 * np.arange(5), (c0, c90, c180, c270, c0))
        length = height if self.axis == 1 else self.sides[self.axis]
        side = np.hypot(width * across[second], depth * across[first])
        return np.pi / 4 * width * depth * across[self.axis] + length * side

    def surface(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points [N, 3] of the surface, m, and their areas times outward normals [N, 3].

        The areas are relative to each other. The normals of a flat opening have no meaning; the
        lengths of the vectors are still the areas.
        """
        half = np.array(self.sides) / 2
        if self.is_flat:
            # A cylinder along its missing side is a disk.
            is_disk = self.shape == "ellipsoid" or (
                self.shape == "cylinder" and self.sides[self.axis] == 0
            )
            points = _disk(_NUM_FLAT_DISK) if is_disk else _square(_NUM_FLAT_SIDE)
            # The unit shape lies in the plane of the first two axes that have a length.
            order = sorted(range(3), key=lambda axis: (self.sides[axis] == 0, axis))
            placed = np.zeros((len(points), 3))
            placed[:, order[:2]] = points
            return placed * half, np.broadcast_to([0.0, 1.0, 0.0], placed.shape)
        unit, areas = {"box": _box, "ellipsoid": _ellipsoid, "cylinder": _cylinder}[self.shape]()
        if self.shape == "cylinder":
            # The unit cylinder extends along y.
            order = [
                self.axis if axis == 1 else 1 if axis == self.axis else axis for axis in (0, 1, 2)
            ]
            unit, areas = unit[:, order], areas[:, order]
        unit, areas = self._lowered(unit, areas)
        # A map by factors a, b, c maps an area vector by bc, ca, ab.
        return unit * half, areas * (half.prod() / half)

    def _lowered(
        self, unit: NDArray[np.float64], areas: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points and areas of the unit shape whose sides are luminous up to `heights`."""
        if self.heights is None:
            return unit, areas
        upright = areas[:, 1] == 0
        azimuth = np.rad2deg(np.arctan2(-areas[:, 2], areas[:, 0])) % 360
        part = np.interp(azimuth, 90 * np.arange(5), (*self.heights, self.heights[0]))
        part = np.where(upright, part / self.sides[1], 1.0)[:, None]
        lower = np.where(upright[:, None] & (np.arange(3) == 1), (unit + 1) * part - 1, unit)
        return lower, areas * part


POINT = Opening()


def opening_around(points: Array, flux: Array) -> tuple[Opening, Array]:
    """The smallest upright box or ellipsoid from which 98 % of light starts, and its centre [3].

    Args:
        points: [N, 3] where light starts, m.
        flux: [N] of the light, above 0.
    """
    # From the middle half of the light outwards, so that a far part with little light is outside.
    centre = np.array([_quantile(each, flux, 0.5) for each in points.T])
    half = np.array([_quantile(each, flux, 0.5) for each in np.abs(points - centre).T])
    low = high = centre
    for _ in range(_ROUNDS):
        half = np.maximum(half, max(_THIN * half.max(), 1e-12))
        away = np.abs((points - centre) / half).max(axis=1)
        kept = points[away <= _quantile(away, flux, 1 - _OUTSIDE)]
        low, high = kept.min(axis=0), kept.max(axis=0)
        centre, half = (low + high) / 2, (high - low) / 2
    sides = high - low
    thick = sides > _THIN * sides.max()
    if not thick.any():
        return POINT, centre
    # The ellipsoid has the proportions of the box.
    away = np.linalg.norm((points - centre)[:, thick] / half[thick], axis=1)
    radius, dimensions = _quantile(away, flux, 1 - _OUTSIDE), int(thick.sum())
    # The volume of the unit ball in its box.
    volume = {1: 1.0, 2: np.pi / 4, 3: np.pi / 6}[dimensions] * radius**dimensions
    shape: Shape = "box"
    if dimensions > 1 and volume < 1:
        shape, sides = "ellipsoid", np.minimum(radius * sides, np.ptp(points, axis=0))
    x, y, z = np.where(thick, sides, 0.0).tolist()
    if shape == "ellipsoid" and abs(x - z) <= _ROUND * (x + z) / 2:
        x = z = (x + z) / 2
    return Opening((x, y, z), shape), centre


def _quantile(values: Array, flux: Array, part: float) -> float:
    """The smallest of some values [N] up to which there is a part of the flux [N]."""
    order = np.argsort(values)
    held = np.cumsum(flux[order])
    return float(values[order[np.searchsorted(held, part * held[-1])]])


def lm63_opening(
    width: float, length: float, height: float, year: int, metres: float = 1.0
) -> Opening | None:
    """The opening that an IES LM-63 file states; None if its signs have no meaning in any edition.

    The width is along C = 90, the length along C = 0, each with its sign, in units of `metres`. The
    tables of 1995 and of 2002 differ for three patterns of signs.
    """
    given = [width, length, height]
    signs = (_sign(width), _sign(length), _sign(height))
    sides = [abs(side) * metres for side in given]
    if min(signs) >= 0:
        return Opening((sides[_LENGTH], sides[_HEIGHT], sides[_WIDTH]))
    rules = _RULES | (_RULES_1995 if year <= 1995 else _RULES_2002)
    if signs not in rules:
        return None
    shape, axis, repeated = rules[signs]
    for missing, source in repeated.items():
        sides[missing] = sides[source]
    return Opening((sides[_LENGTH], sides[_HEIGHT], sides[_WIDTH]), shape, axis)


def lm63_dimensions(opening: Opening) -> tuple[float, float, float]:
    """Width, length and height, m, with the signs of the editions of 2002 and 2019."""
    length, height, width = opening.sides
    if opening.shape == "ellipsoid":
        return -width, -length, -height
    if opening.shape == "cylinder":
        negative = {0: (_WIDTH, _HEIGHT), 1: (_WIDTH, _LENGTH), 2: (_LENGTH, _HEIGHT)}[opening.axis]
        width, length, height = (
            -side if dimension in negative else side
            for dimension, side in enumerate((width, length, height))
        )
    return width, length, height


def _sign(value: float) -> int:
    return int(value > 0) - int(value < 0)


def _centres(count: int) -> NDArray[np.float64]:
    """[count] centres of equal intervals of [-1, 1]."""
    return (np.arange(count) + 0.5) / count * 2 - 1


def _square(side: int = _NUM_SIDE) -> NDArray[np.float64]:
    """Points [N, 2] of the square [-1, 1]²."""
    return np.stack(np.meshgrid(_centres(side), _centres(side)), axis=-1).reshape(-1, 2)


def _disk(count: int = _NUM_DISK) -> NDArray[np.float64]:
    """Points [N, 2] of the unit disk, each for an equal area: Vogel's spiral."""
    index = np.arange(count)
    angle, radius = index * np.pi * (3 - math.sqrt(5)), np.sqrt((index + 0.5) / count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def _box() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and area vectors [N, 3] of the cube [-1, 1]³."""
    square = _square()
    points, areas = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            points.append(np.insert(square, axis, side, axis=1))
            areas.append(np.broadcast_to(side * np.eye(3)[axis], (len(square), 3)))
    return np.concatenate(points), np.concatenate(areas)


def _ellipsoid() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and area vectors [N, 3] of the unit sphere, each for an equal area."""
    y = _centres(_NUM_ELLIPSOID)
    angle, radius = np.arange(_NUM_ELLIPSOID) * np.pi * (3 - math.sqrt(5)), np.sqrt(1 - y * y)
    points = np.stack([radius * np.cos(angle), y, radius * np.sin(angle)], axis=-1)
    return points, points


def _cylinder() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and area vectors [N, 3] of the cylinder of radius 1 and length 2 along y."""
    angle, y = np.meshgrid(2 * np.pi * np.arange(_NUM_ROUND) / _NUM_ROUND, _centres(_NUM_SIDE))
    normal = np.stack([np.cos(angle), np.zeros_like(y), np.sin(angle)], axis=-1).reshape(-1, 3)
    round_area = 2 * np.pi * 2 / len(normal)
    points = [normal + np.outer(y.ravel(), [0, 1, 0])]
    areas = [normal * round_area]
    disk = _disk()
    for side in (-1.0, 1.0):
        points.append(np.insert(disk, 1, side, axis=1))
        cap = np.array([0, side, 0]) * np.pi / len(disk)
        areas.append(np.broadcast_to(cap, (len(disk), 3)))
    return np.concatenate(points), np.concatenate(areas)
