"""Leaves drawn by the light that they send to a point, in the luminaire's local frame.

A direction from x is drawn by drawing a leaf and a point in it. Its density sums over all leaves on
the line, the same that its radiance is made of: one traversal finds both (`LightLeaves.record`).
Only leaves that the traversal reaches before the light is blocked count, and a direction that was
drawn by another one, behind them, is rejected.

A leaf is drawn in two steps. First a group of neighbours, from a table that holds each group's part
of the light by cell of the space around the lamp: by direction from its centre and by distance.
Then one of the group's leaves, by the root mean square of what it sends out over all directions;
leaves stand in a list as often as their share says, so that one look-up draws one. Lines that leave
the lamp are drawn in the same way, with the farthest cells.

Symbols
    x       the shading point
    r       distance from x
    p       probability with which a leaf is drawn
    V       volume of the part of a leaf that is inside the proxy box. A leaf adds
            p (r₁³ - r₀³) / 3V to the density of a direction whose line is in it from r₀ to r₁
    R       radius of the bounding sphere
"""

import weakref
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device
from lumitree.octree.field import Field
from lumitree.octree.leaves import leaf_cells
from lumitree.rendering.octahedral import NUM_BINS, bin_density, bin_of, direction_in_bin
from lumitree.rendering.proxy import point_on_box, projected_areas

NUM_GROUPS = 64
# A leaf's number is p / 3V, with its group in place of the last bits.
_GROUP_MASK = NUM_GROUPS - 1
_DIGITS = 0xFFFFFFFF - _GROUP_MASK
# Cells a side of the grid whose cells are grouped.
_GRID = 32
# Mean number of a leaf's places in the list, and the part of them that all leaves have alike: a few
# lines may have missed what makes a leaf bright.
_PLACES, _ALIKE = 4, 0.2
# Shells of equal width in R / distance, in which parallax is linear; the last has no end.
_NUM_SHELLS = 6
_SHELL_WIDTH = 0.25
_NUM_CELLS = _NUM_SHELLS * NUM_BINS
# Lines a leaf that its power is found with, within bounds; and lines a cell for the table.
_LINES_PER_LEAF, _FEWEST_LINES, _MOST_LINES = 8, 1 << 18, 1 << 21
_LINES_PER_CELL = 1024
# No group is held to be darker than this part of its mean over the directions of a shell.
_FLOOR = 0.05


_TABLES: "weakref.WeakKeyDictionary[Field, LightLeaves | None]" = weakref.WeakKeyDictionary()


def light_leaves(field: Field) -> "LightLeaves | None":
    """What directions towards a field are sampled with; made on first use, shared by all instances.

    None where nothing emits.
    """
    if field not in _TABLES:
        cells, levels = leaf_cells(field.asset.children, field.asset.num_leaves)
        power = leaf_power(field, levels)
        _TABLES[field] = LightLeaves(field, cells, levels, power) if power.any() else None
    return _TABLES[field]


class LightLeaves:
    """The list of a field's leaves and the table of their groups.

    Args:
        field: must emit something.
        cells, levels: [M, 3], [M] where its leaves are, see `leaf_cells`.
        power: [M] root mean square light of its leaves, see `leaf_power`.
    """

    def __init__(
        self,
        field: Field,
        cells: NDArray[np.int64],
        levels: NDArray[np.int64],
        power: NDArray[np.float64],
    ) -> None:
        self._radius = float(np.linalg.norm(field.asset.half_extents))
        self._half = mi.Point3f(*field.asset.half_extents.tolist())
        shines = np.flatnonzero(power > 0)
        cells, levels, power = cells[shines], levels[shines], power[shines]
        group = _group(cells, levels, power)
        places = _places(power, group)
        order = np.argsort(group, kind="stable")
        self._list = on_device(mi.UInt32, np.repeat(_keys(cells, levels)[order], places[order]))
        lengths = np.bincount(group, places, NUM_GROUPS).astype(np.uint32)
        starts = np.cumsum(lengths) - lengths
        self._ranges = on_device(mi.UInt32, np.stack([starts, lengths], axis=1))
        third = places / lengths[group] / (3 * _volumes(cells, levels, field.asset.half_extents))
        packed = np.zeros(field.asset.num_leaves, np.uint32)
        packed[shines] = (third.astype(np.float32).view(np.uint32) & _DIGITS) | group
        self._packed = on_device(mi.UInt32, packed)
        # To begin with the groups have the same parts everywhere.
        everywhere = np.bincount(group, power, NUM_GROUPS)
        self._set_table(np.tile(everywhere, (_NUM_CELLS, 1)))
        self._set_table(self._tabulate(field))

    def _set_table(self, light):
        """Choices of a group by cell, and of bin and group for lines, by light [cells, groups]."""
        light = light.reshape(_NUM_SHELLS, NUM_BINS, NUM_GROUPS)
        light = np.maximum(light, _FLOOR * light.mean(axis=1, keepdims=True))
        shares = light / light.sum(axis=2, keepdims=True)
        self._share = on_device(mi.Float, shares)
        self._cumulated = on_device(mi.Float, np.cumsum(shares, axis=2))
        _, density = direction_in_bin(dr.arange(mi.UInt32, NUM_BINS), mi.Point2f(0.5))
        power = light[0] / np.array(density)[:, None]
        self._line_choice = mi.DiscreteDistribution(on_device(mi.Float, power))
        self._line_share = on_device(mi.Float, power / power.sum())

    def _tabulate(self, field):
        """Light [cells, groups] that each group sends to each cell around the lamp."""
        cell = dr.arange(mi.UInt32, _NUM_CELLS * _LINES_PER_CELL) // _LINES_PER_CELL
        rng = mi.PCG32(len(cell), 1)
        uniform = lambda: mi.Point2f(rng.next_float32(), rng.next_float32())  # noqa: E731
        x = self._point_in_cell(cell, uniform(), rng.next_float32())
        offset = self.sample(x, uniform(), True) - x
        reach = dr.norm(offset)
        direction = offset / reach
        density, stop = field.cross(x, direction, True, *self.record(x, 0.0))
        light = dr.zeros(mi.Float, _NUM_CELLS * NUM_GROUPS)
        weight = dr.select(
            is_reached(reach, stop), dr.squared_norm(x) * dr.rcp(density * _LINES_PER_CELL), 0
        )
        weight = dr.select(dr.isfinite(weight), weight, 0)

        def share_out(_, leaf, start, length, active, emission):
            group = dr.gather(mi.UInt32, self._packed, leaf, active) & _GROUP_MASK
            index = cell * NUM_GROUPS + group
            dr.scatter_reduce(dr.ReduceOp.Add, light, weight * dr.mean(emission), index, active)
            return ()

        dr.eval(field.integrate(x, direction, True, share_out, ()), light)
        return np.array(light, np.float64).reshape(_NUM_CELLS, NUM_GROUPS)

    def _point_in_cell(self, cell, sample, shell_sample):
        """Random point of a cell around the lamp, outside the proxy box."""
        direction, _ = direction_in_bin(cell % NUM_BINS, sample)
        nearness = (mi.Float(cell // NUM_BINS) + shell_sample) * _SHELL_WIDTH
        surface = dr.min(self._half / dr.abs(direction))
        # Beyond 50 R nothing changes any more but the rounding.
        distance = dr.maximum(self._radius / dr.maximum(nearness, 0.02), 1.001 * surface)
        return mi.Point3f(direction * distance)

    def _row(self, x):
        """Where the table's row for the cell of a point begins."""
        x = mi.Vector3f(x)
        nearness = self._radius * dr.rsqrt(dr.squared_norm(x)) / _SHELL_WIDTH
        shell = mi.UInt32(dr.minimum(nearness, _NUM_SHELLS - 1))
        return (shell * NUM_BINS + bin_of(x)) * NUM_GROUPS

    def sample(self, x: Any, sample: Any, active: Any) -> Any:
        """Point (mi.Point3f) inside a leaf for a sample in the unit square."""
        row = self._row(x)

        def below(index):
            return dr.gather(mi.Float, self._cumulated, row + index, active) <= sample.x

        group = dr.binary_search(0, NUM_GROUPS - 1, below)
        return self._point_of_group(group, sample, active)

    def _point_of_group(self, group, sample, active):
        """Point inside a leaf of a group; the leaf by the sample's y, the rest by all its bits."""
        span = dr.gather(mi.Vector2u, self._ranges, group, active)
        place = span.x + dr.minimum(mi.UInt32(sample.y * mi.Float(span.y)), span.y - 1)
        key = dr.gather(mi.UInt32, self._list, place, active)
        level = (31 - dr.lzcnt(key)) // 3
        mask = (1 << level) - 1
        cell = mi.Point3f(mi.Point3u(key, key >> level, key >> (2 * level)) & mask)
        bits = (dr.reinterpret_array(mi.UInt32, each) for each in (sample.x, sample.y))
        u, v = mi.sample_tea_32(*bits)
        w, _ = mi.sample_tea_32(v, u)
        within = mi.Point3f(mi.Float(u >> 8), mi.Float(v >> 8), mi.Float(w >> 8)) * 2.0**-24
        side = 2 * dr.rcp(mi.Float(1 << level))
        lower = dr.maximum(cell * side - 1, -self._half)
        upper = dr.minimum((cell + 1) * side - 1, self._half)
        return dr.lerp(lower, upper, within)

    def record(self, x: Any, offset: Any) -> tuple[Any, tuple[Any, Any]]:
        """Record for `Field.integrate` or `Field.cross`, and what it starts with.

        Its result is the density of the line's direction from `x`, and the distance from the
        line's origin at which the last leaf ends that was reached.

        Args:
            x: mi.Point3f, the shading point; outside the proxy.
            offset: distance from it to the line's origin.
        """

        def part(start, length):
            near = start + offset
            far = near + length
            return length * (near * near + near * far + far * far)

        return self._record(self._share, self._row(x), part)

    def sample_line(self, choice: Any, sample1: Any, sample2: Any) -> tuple[Any, Any]:
        """Point inside a leaf and direction of travel of a line that leaves the lamp."""
        index = self._line_choice.sample(choice)
        direction, _ = direction_in_bin(index // NUM_GROUPS, sample1)
        return self._point_of_group(index % NUM_GROUPS, sample2, True), direction

    def record_line(self, direction: Any) -> tuple[Any, tuple[Any, Any]]:
        """As `record`, for the density of `sample_line` over projected area and solid angle.

        Args:
            direction: in which light travels, opposite to the line's own.
        """
        of_bin = bin_density(direction)

        def part(_, length):
            return 3 * length * of_bin

        return self._record(self._line_share, bin_of(direction) * NUM_GROUPS, part)

    def _record(self, shares, row, part):
        """Record that sums share · p / 3V · part over leaves, and finds the last one's end."""

        def add(state, leaf, start, length, active, emission=None):
            density, stop = state
            packed = dr.gather(mi.UInt32, self._packed, leaf, active)
            share = dr.gather(mi.Float, shares, row + (packed & _GROUP_MASK), active)
            share *= dr.reinterpret_array(mi.Float, packed & _DIGITS)
            density = density + dr.select(active, share * part(start, length), 0)
            return density, dr.select(active, start + length, stop)

        return add, (mi.Float(0), mi.Float(-dr.inf))


def is_reached(reach: Any, stop: Any) -> Any:
    """Whether a point in a leaf at distance `reach` lies before the distance where light stops."""
    return reach <= stop + 1e-5 * (1 + dr.abs(reach))


def leaf_power(field: Field, levels: NDArray[np.int64]) -> NDArray[np.float64]:
    """Light [M], up to a factor, that leaves the lamp from each leaf: root mean square over lines.

    So a leaf that is bright in few directions counts, and one that is hidden does not.
    """
    asset = field.asset
    half = mi.Vector3f(*asset.half_extents.tolist())
    lines = int(np.clip(_LINES_PER_LEAF * asset.num_leaves, _FEWEST_LINES, _MOST_LINES))
    rng = mi.PCG32(lines)
    uniform = lambda: mi.Point2f(rng.next_float32(), rng.next_float32())  # noqa: E731
    direction = mi.warp.square_to_uniform_sphere(uniform())
    weights = projected_areas(half, direction)
    origin = mi.Point3f(point_on_box(half, weights, -direction, uniform()))
    projected = dr.sum(weights)
    square = dr.zeros(mi.Float, max(asset.num_leaves, 1))

    def record(_, leaf, start, length, active, emission):
        value = dr.square(dr.mean(emission)) * projected
        dr.scatter_reduce(dr.ReduceOp.Add, square, value, leaf, active)
        return ()

    dr.eval(field.integrate(origin, direction, True, record, ()), square)
    # The integral of squares is over the leaf's projected area; an estimator's second moment has
    # that area as a factor once more.
    side = 2.0 / (1 << levels)
    return np.sqrt(np.array(square, np.float64)[: asset.num_leaves]) * side


def _group(
    cells: NDArray[np.int64], levels: NDArray[np.int64], power: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Group [M] of each leaf: boxes of grid cells, halved where most light is spread most."""
    grid = np.clip((cells + 0.5) * (_GRID / (1 << levels))[:, None], 0, _GRID - 1).astype(np.int64)
    occupied, owner = np.unique(grid @ [1, _GRID, _GRID**2], return_inverse=True)
    places = np.stack([occupied % _GRID, occupied // _GRID % _GRID, occupied // _GRID**2], axis=1)
    power = np.bincount(owner, power)
    groups = [np.arange(len(occupied))]
    worth = [_worth(places, power)]
    while len(groups) < NUM_GROUPS and max(worth) > 0:
        chosen = int(np.argmax(worth))
        members = groups[chosen]
        axis = np.ptp(places[members], axis=0).argmax()
        members = members[np.argsort(places[members, axis], kind="stable")]
        middle = int(np.searchsorted(np.cumsum(power[members]), power[members].sum() / 2)) + 1
        middle = min(middle, len(members) - 1)
        halves = members[:middle], members[middle:]
        groups[chosen : chosen + 1] = halves
        worth[chosen : chosen + 1] = [_worth(places[half], power[half]) for half in halves]
    label = np.zeros(len(occupied), np.int64)
    for index, members in enumerate(groups):
        label[members] = index
    return label[owner]


def _worth(places, power):
    """Light of grid cells times how far they are apart."""
    return power.sum() * np.linalg.norm(np.ptp(places, axis=0)) if len(places) > 1 else 0.0


def _places(power: NDArray[np.float64], group: NDArray[np.int64]) -> NDArray[np.int64]:
    """How often [M] each leaf stands in the list, by its part of its group."""
    order = np.argsort(group, kind="stable")
    members, light = np.bincount(group), np.bincount(group, power)
    parts = _ALIKE + (1 - _ALIKE) * members[group] * power / light[group]
    # Rounded so that the sums over neighbours, and over groups, are right.
    rounded = np.diff(np.floor(_PLACES * np.cumsum(parts[order]) + 0.5), prepend=0.0)
    places = np.empty(len(power), np.int64)
    places[order] = np.maximum(rounded, 0)
    return places


def _volumes(
    cells: NDArray[np.int64], levels: NDArray[np.int64], half: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Volume [M] of the part of each leaf that is inside the proxy box."""
    side = 2.0 / (1 << levels)[:, None]
    lower, upper = np.maximum(cells * side - 1, -half), np.minimum((cells + 1) * side - 1, half)
    return np.maximum(upper - lower, 0).prod(axis=1)


def _keys(cells: NDArray[np.int64], levels: NDArray[np.int64]) -> NDArray[np.uint32]:
    """Level and cell of each leaf in one number: 1, then z, y, x with as many bits as the level."""
    x, y, z = cells.T
    return ((1 << 3 * levels) | (z << 2 * levels) | (y << levels) | x).astype(np.uint32)
