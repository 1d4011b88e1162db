"""The light field of a lamp with several sources, each with its pose, opening and intensities.

Each light source emits from its luminous opening with the intensities of its photometric file, as
`light_field` describes. Light that leaves the lamp may start anywhere on its ray. Where an opening
is nearer to a face of the box than the middle of the last cells, its light starts before or behind
it, at the nearest point of the ray that can be the mean of cells. Along an axis over which an
opening extends far, each cell has the part of the opening inside it, which blurs its edges by a
cell; along another axis the mean position of the cells is the opening's.

Symbols
    C   cells           R   bins of direction a side
    B   coarse bins of direction, in which the light starts in the same cells
    N   points of an opening
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np

from lumitree.asset.asset import Asset, light_field_asset
from lumitree.asset.light_field import make_light_field
from lumitree.core.frames import LocalFrame
from lumitree.core.octahedral import middle_directions, solid_angles
from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.errors import LumitreeError
from lumitree.formats.light_field import (
    MAX_BINS,
    POINT_SIZE,
    Array,
    Codes,
    StartCells,
    intensity_by_bin,
)
from lumitree.formats.opening import Opening
from lumitree.formats.type_c import IntensityDistribution

_MAX_DEPTH = 6
# Bins a side of flat openings and of those with a volume, and how many at once.
_COARSE, _COARSE_OF_VOLUME, _BINS_AT_ONCE = 32, 16, 32
# Points a side of an opening with a volume, and how many cells a side it may have.
_POINTS_OF_VOLUME, _MAX_SPAN = 20, 17
# Points of a flat opening a cell and side, and at most a side.
_PER_CELL, _MAX_SIDE = 2, 128
# Cells that an opening must extend over, so that its edges are exact within a cell.
_WIDE = 2
_MIN_EXTENT = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class LightSource:
    """A luminous opening in a lamp.

    Attributes:
        distribution: its intensities; the opening of the distribution is not used.
        opening: the luminous opening.
        pose: [4, 4] rotation and translation from the frame of distribution and opening (y up, C =
            0 along x) to the frame of the lamp's file.
        lumens: luminous flux, lm.
    """

    distribution: IntensityDistribution
    opening: Opening
    pose: Array
    lumens: float

    @property
    def name(self) -> str:
        """Name of its photometry."""
        return self.distribution.name

    def at(self, direction: Array) -> Array:
        """Intensity [...], cd, in directions [..., 3] of the lamp's file, of the distribution."""
        turned = (self.pose[:3, :3] != np.eye(3)).any()
        return self.distribution.at(direction @ self._turn if turned else direction)

    def corners(self) -> Array:
        """[8, 3] of the box of the opening, in the frame of the lamp's file, m."""
        signs = np.indices((2, 2, 2)).reshape(3, -1).T - 0.5
        return signs * self._sides @ self._turn.T + self.pose[:3, 3]

    @property
    def _turn(self) -> Array:
        return np.ascontiguousarray(self.pose[:3, :3])

    @property
    def _sides(self) -> Array:
        sides = np.array(self.opening.sides)
        return sides if sides.max() >= _MIN_EXTENT else np.full(3, POINT_SIZE)

    def surface(self, cell: float) -> tuple[Array, Array | None, Array]:
        """Points [N, 3] in the frame of the lamp's file, m, area vectors [N, 3], and widths [3].

        Without area vectors each point stands for an equal area, and light of all directions leaves
        from all points evenly. Widths are the extent of the part of the surface of a point.
        """
        turn, sides = self._turn, self._sides
        opening = Opening((float(sides[0]), float(sides[1]), float(sides[2])))
        opening = dataclasses.replace(self.opening, sides=opening.sides)
        if opening.is_flat or max(self.opening.sides) < _MIN_EXTENT:
            points, widths, areas = *_flat_points(opening, cell), None
        else:
            points, areas = opening.surface()
            widths, areas = sides / _POINTS_OF_VOLUME, areas @ turn.T
        return points @ turn.T + self.pose[:3, 3], areas, np.abs(turn) @ widths


def bake_sources(sources: Sequence[LightSource], frame: LocalFrame, name: str) -> Asset:
    """Asset that emits what sources emit, with R = G = B.

    `frame` is without rotation, and its box contains the openings of the sources.
    """
    sources = [source for source in sources if source.lumens > 0]
    if not sources:
        raise LumitreeError(f"{name} emits nothing; expected intensities above 0")
    watts = _radiant_intensities(sources, frame, name)
    resolution = math.isqrt(watts.shape[1])
    depth, starts = _all_starts(sources, frame, resolution)
    used = np.unique(np.concatenate([codes for codes, _ in starts]))
    total = np.zeros((len(used), resolution**2))
    for (codes, shares), each in zip(starts, watts, strict=True):
        total[np.searchsorted(used, codes)] += _fine(shares, resolution) * each
    cells = StartCells(frame, depth).coordinates(used)
    intensity = np.broadcast_to(total[..., None], (*total.shape, 3))
    field = make_light_field(cells, intensity, depth, absolute=True)
    return light_field_asset(field, frame, name)


def _all_starts(
    sources: Sequence[LightSource], frame: LocalFrame, resolution: int
) -> tuple[int, list[tuple[Codes, Array]]]:
    """Depth of the grid, and the starts of each source, of which there are not too many."""
    depth = _estimated_depth(sources, frame, resolution)
    while depth > 1:
        limit = MAX_BINS // resolution**2
        starts = [_Starts(source, frame, depth).shares(limit) for source in sources]
        if len(np.unique(np.concatenate([codes for codes, _ in starts]))) <= limit:
            return depth, starts
        depth -= 1
    return 1, [_Starts(source, frame, 1).shares(8) for source in sources]


def _radiant_intensities(sources: Sequence[LightSource], frame: LocalFrame, name: str) -> Array:
    """Radiant intensity [S, R²] of each source, local units, whose flux is its lumens."""
    # Lamps in one direction with one photometry are common.
    keys = [(id(each.distribution), each.pose[:3, :3].tobytes()) for each in sources]
    different = dict(zip(keys, sources, strict=True))
    candela = {key: intensity_by_bin(source) for key, source in different.items()}
    resolution = math.isqrt(max(map(len, candela.values())))
    found = []
    for source, key in zip(sources, keys, strict=True):
        if len(candela[key]) < resolution**2:
            candela[key] = intensity_by_bin(source, (resolution,))
        values = candela[key]
        flux = float(values @ solid_angles(resolution))
        if not flux > 0:
            raise LumitreeError(f"a source of {name} emits nothing; expected intensities above 0")
        found.append(values * (source.lumens / flux / LUMENS_PER_WATT / frame.scale**2))
    return np.stack(found)


def _fine(values: Array, resolution: int) -> Array:
    """Values [C, Q²] of coarse bins repeated for all bins [C, R²] that they contain."""
    side = math.isqrt(values.shape[1])
    if side == resolution:
        return values
    times = resolution // side
    grid = values.reshape(len(values), side, side)
    return grid.repeat(times, axis=1).repeat(times, axis=2).reshape(len(values), -1)


def _estimated_depth(sources: Sequence[LightSource], frame: LocalFrame, resolution: int) -> int:
    """Largest depth at which there are probably not too many bins."""
    for depth in range(_MAX_DEPTH, 1, -1):
        cell = 2 * frame.scale / (1 << depth)
        spans = [np.sort(np.array(source.opening.sides) / cell + 1) for source in sources]
        cells = sum(float(span[1:].prod()) for span in spans)
        # The points of an opening with a volume are a fixed number.
        deep = [span.max() for span in spans if span.min() > 1]
        if cells * resolution**2 <= MAX_BINS and max(deep, default=0) <= _MAX_SPAN:
            return depth
    return 1


class _Starts:
    """Where the light of a source starts in a grid of 2**depth cells a side."""

    def __init__(self, source: LightSource, frame: LocalFrame, depth: int) -> None:
        self._cells = StartCells(frame, depth)
        cell = 2 / self._cells.side
        points, self._areas, widths = source.surface(cell * frame.scale)
        self._points, widths = (points - frame.centre) / frame.scale, widths / frame.scale
        extent = np.ptp(self._points, axis=0) + widths
        wide = extent > _WIDE * cell
        x, y, z = (
            min(float(width), cell) if many else None
            for width, many in zip(widths, wide, strict=True)
        )
        self._widths = (x, y, z)
        # Positions that can be the mean of the cells around them.
        middles, half = self._cells.middles, frame.half_extents
        self._low = np.where(wide, -half, [each[0] for each in middles])
        self._high = np.where(wide, half, [each[-1] for each in middles])
        inside = ((self._points >= self._low) & (self._points <= self._high)).all()
        directions = middle_directions(_COARSE if self._areas is None else _COARSE_OF_VOLUME)
        # Without a direction, all are alike.
        self._directions = directions[:1] if inside and self._areas is None else directions

    def shares(self, limit: int) -> tuple[Codes, Array]:
        """Indices [C] of cells, and the part [C, B or 1] of the light of each coarse bin there.

        If there are more than `limit` cells, some are returned, without light.
        """
        column = np.full(self._cells.side**3, -1)
        codes = np.zeros(0, np.int64)
        shares = np.zeros((len(self._directions), 0))
        for first, projected, start in self._parts():
            count = len(start)
            for code, weight in self._cells.around(start, self._widths):
                values = np.broadcast_to(weight * projected, code.shape)
                code, row = code[values > 0], np.nonzero(values > 0)[0]
                fresh = np.unique(code[column[code] < 0])
                column[fresh] = len(codes) + np.arange(len(fresh))
                codes = np.concatenate([codes, fresh])
                if len(codes) > limit:
                    return codes, np.zeros((len(codes), 1))
                shares = np.pad(shares, ((0, 0), (0, len(fresh))))
                place = row * len(codes) + column[code]
                total = np.bincount(place, values[values > 0], count * len(codes))
                shares[first : first + count] += total.reshape(count, -1)
        return codes, (shares / shares.sum(axis=1, keepdims=True)).T

    def _parts(self) -> Iterator[tuple[int, Array, Array]]:
        """Directions in groups: the first, relative flux [B, N] of points, starts [B, N, 3]."""
        for first in range(0, len(self._directions), _BINS_AT_ONCE):
            along = self._directions[first : first + _BINS_AT_ONCE]
            if self._areas is None:
                projected = np.ones((len(along), len(self._points)))
            else:
                projected = np.maximum(along @ self._areas.T, 0)
            yield first, projected, self._starts(along)

    def _starts(self, along: Array) -> Array:
        """Points [B, N, 3] on the rays through the points, the nearest ones between the middles."""
        near, far = -np.inf, np.inf
        for axis in range(3):
            slope = np.where(np.abs(along[:, axis]) < 1e-9, 1e-9, along[:, axis])[:, None]
            first = (self._low[axis] - self._points[:, axis]) / slope
            second = (self._high[axis] - self._points[:, axis]) / slope
            near = np.maximum(near, np.minimum(first, second))
            far = np.minimum(far, np.maximum(first, second))
        # A ray that misses them keeps its point.
        step = np.where(near <= far, np.clip(0, near, far), 0)
        return self._points + step[..., None] * along[:, None]


def _flat_points(opening: Opening, cell: float) -> tuple[Array, Array]:
    """Points [N, 3] of a flat opening, each for an equal area, and the widths [3] of this area."""
    sides = np.array(opening.sides)
    order = sorted(range(3), key=lambda axis: (sides[axis] == 0, axis))
    counts = np.clip(np.ceil(_PER_CELL * sides / cell), 1, _MAX_SIDE).astype(int)
    is_round = opening.shape != "box" and (opening.shape == "ellipsoid" or sides[opening.axis] == 0)
    if is_round:
        count = int(2 * counts[order[0]] * counts[order[1]])
        index = np.arange(count)
        angle, radius = index * np.pi * (3 - math.sqrt(5)), np.sqrt((index + 0.5) / count)
        placed = np.zeros((count, 3))
        placed[:, order[0]], placed[:, order[1]] = radius * np.cos(angle), radius * np.sin(angle)
        return placed * sides / 2, sides * math.sqrt(np.pi / 4 / count)
    axes = [(np.arange(count) + 0.5) / count - 0.5 for count in counts]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) * sides
    return points, sides / counts
