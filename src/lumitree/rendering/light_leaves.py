"""Importance sampling of a field's leaves, in the luminaire's local frame.

A direction from x is sampled in three steps: a group of neighbouring leaves, a leaf of the group, a
point in the leaf. The density of a direction sums over all leaves that its ray crosses, as its
radiance does, so one traversal returns both (`LightLeaves.record`). Only the leaves that the
traversal reaches before the ray is blocked count. A direction that was sampled by a leaf behind
them is rejected.

Groups are sampled from a table of the light that each group sends to each cell of the space around
the lamp. Cells are bins of direction from the lamp's centre, times shells of distance. The leaves
of a group are sampled in proportion to the root mean square of the light that leaves the lamp from
them. They stand in a list, each with a multiplicity, so that one look-up samples one. Rays that
leave the lamp are sampled in the same way, with the outermost shell.

Symbols
    x       the shading point
    r       distance from x
    p       probability with which a leaf is sampled
    V       volume of the part of a leaf that is inside the proxy box. A leaf adds
            p (r₁³ - r₀³) / 3V to the density of a direction whose ray is in it from r₀ to r₁
"""

from __future__ import annotations

import weakref

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter
from lumitree.core.octahedral import bin_density, bin_of, direction_in_bin
from lumitree.octree.build import boxes_inside, leaf_cells
from lumitree.octree.field import Field, Record
from lumitree.rendering.light_table import ReceiverCells
from lumitree.rendering.sampling import point_on_box, projected_areas, sample_row, scrambled

NUM_GROUPS = 64
# A leaf's number is p / 3V, with its group in place of the last bits.
_GROUP_MASK = NUM_GROUPS - 1
_DIGITS = 0xFFFFFFFF - _GROUP_MASK
# Cells a side of the grid whose cells are grouped.
_GRID = 32
# Mean multiplicity of a leaf in the list, and the part of it that is equal for all leaves: the few
# rays that a leaf's power is estimated with may have missed what makes it bright.
_MEAN_MULTIPLICITY, _EQUAL_PART = 4, 0.2
# Cells of receivers, see `receiver_cells`.
_NUM_SHELLS = 6
_SHELL_WIDTH = 0.25
_RESOLUTION = 16
_NUM_BINS = _RESOLUTION**2
# Rays per leaf that estimate the power of leaves, within bounds; and rays per cell of the table.
_RAYS_PER_LEAF, _MIN_RAYS, _MAX_RAYS = 8, 1 << 18, 1 << 21
_RAYS_PER_CELL = 1024
# A group's light in a cell counts as no less than this part of its mean over the cell's shell.
_FLOOR = 0.05

_TABLES: weakref.WeakKeyDictionary[Field, LightLeaves | None] = weakref.WeakKeyDictionary()


def light_leaves(field: Field) -> LightLeaves | None:
    """Tables to sample directions towards a field; made on first use, shared by all instances.

    None if nothing emits.
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
        half_extents = field.asset.frame.half_extents
        self._half = parameter(mi.Point3f, *half_extents.tolist())
        self._around = ReceiverCells(half_extents, _RESOLUTION, _NUM_SHELLS, _SHELL_WIDTH)
        emits = np.flatnonzero(power > 0)
        cells, levels, power = cells[emits], levels[emits], power[emits]
        group = _group(cells, levels, power)
        multiplicity = _multiplicity(power, group)
        order = np.argsort(group, kind="stable")
        self._list = on_device(
            mi.UInt32, np.repeat(_keys(cells, levels)[order], multiplicity[order])
        )
        lengths = np.bincount(group, multiplicity, NUM_GROUPS).astype(np.uint32)
        starts = np.cumsum(lengths) - lengths
        self._ranges = on_device(mi.UInt32, np.stack([starts, lengths], axis=1))
        lower, upper = boxes_inside(half_extents, cells, levels)
        volumes = np.maximum(upper - lower, 0).prod(axis=1)
        third = multiplicity / lengths[group] / (3 * volumes)
        packed = np.zeros(field.asset.num_leaves, np.uint32)
        packed[emits] = (third.astype(np.float32).view(np.uint32) & _DIGITS) | group
        self._packed = on_device(mi.UInt32, packed)
        # The first table, for estimating the second: each group has the same part in all cells.
        everywhere = np.bincount(group, power, NUM_GROUPS)
        self._set_table(np.tile(everywhere, (self._around.count, 1)))
        self._set_table(self._tabulate(field))

    def _set_table(self, light):
        """Distributions of groups by cell, and of bins and groups for rays, from light."""
        light = light.reshape(_NUM_SHELLS, _NUM_BINS, NUM_GROUPS)
        light = np.maximum(light, _FLOOR * light.mean(axis=1, keepdims=True))
        shares = light / light.sum(axis=2, keepdims=True)
        self._share = on_device(mi.Float, shares)
        self._cumulated = on_device(mi.Float, np.cumsum(shares, axis=2))
        _, density = direction_in_bin(
            dr.arange(mi.UInt32, _NUM_BINS), mi.Point2f(0.5), _RESOLUTION, bevelled=False
        )
        power = light[0] / np.array(density)[:, None]
        self._ray_choice = mi.DiscreteDistribution(on_device(mi.Float, power))
        self._ray_share = on_device(mi.Float, power / power.sum())

    def _tabulate(self, field):
        """Light [cells, groups] that each group sends to each cell around the lamp."""
        cell = dr.arange(mi.UInt32, self._around.count * _RAYS_PER_CELL) // _RAYS_PER_CELL
        rng = mi.PCG32(len(cell), 1)
        uniform = lambda: mi.Point2f(rng.next_float32(), rng.next_float32())  # noqa: E731
        x = self._around.point(cell, uniform(), rng.next_float32())
        offset = self.sample(x, uniform(), True) - x
        reach = dr.norm(offset)
        direction = offset / reach
        density, blocked = field.cross(x, direction, True, *self.record(x, 0.0))
        light = dr.zeros(mi.Float, self._around.count * NUM_GROUPS)
        weight = dr.select(
            is_reached(reach, blocked), dr.squared_norm(x) * dr.rcp(density * _RAYS_PER_CELL), 0
        )
        weight = dr.select(dr.isfinite(weight), weight, 0)

        def accumulate(_, leaf, start, length, active, emission):
            group = dr.gather(mi.UInt32, self._packed, leaf, active) & _GROUP_MASK
            index = cell * NUM_GROUPS + group
            dr.scatter_reduce(dr.ReduceOp.Add, light, weight * dr.mean(emission), index, active)
            return ()

        dr.eval(field.integrate(x, direction, True, accumulate, ()), light)
        return np.array(light, np.float64).reshape(self._around.count, NUM_GROUPS)

    def sample(self, x: mi.Point3f, sample: mi.Point2f, active: mi.Bool | bool) -> mi.Point3f:
        """Point inside a leaf for a sample in the unit square."""
        row = self._around.index(x) * NUM_GROUPS
        group = sample_row(self._cumulated, row, NUM_GROUPS, sample.x, active)
        return self._point_of_group(group, sample, active)

    def _point_of_group(self, group, sample, active):
        """Point inside a leaf of a group; the leaf by the sample's y, the rest by all its bits."""
        span = dr.gather(mi.Vector2u, self._ranges, group, active)
        place = span.x + dr.minimum(mi.UInt32(sample.y * mi.Float(span.y)), span.y - 1)
        key = dr.gather(mi.UInt32, self._list, place, active)
        level = (31 - dr.lzcnt(key)) // 3
        mask = (1 << level) - 1
        cell = mi.Point3f(mi.Point3u(key, key >> level, key >> (2 * level)) & mask)
        side = 2 * dr.rcp(mi.Float(1 << level))
        lower = dr.maximum(cell * side - 1, -self._half)
        upper = dr.minimum((cell + 1) * side - 1, self._half)
        return dr.lerp(lower, upper, scrambled(sample))

    def record(
        self, x: mi.Point3f, offset: mi.Float | float
    ) -> tuple[Record, tuple[mi.Float, mi.Float]]:
        """Record for `Field.integrate` or `Field.cross`, and what it starts with.

        Its result is the density of the ray's direction from `x`, and the distance from the
        ray's origin at which the last leaf ends that was reached.

        Args:
            x: the shading point; outside the proxy.
            offset: distance from it to the ray's origin.
        """

        def part(start, length):
            near = start + offset
            far = near + length
            return length * (near * near + near * far + far * far)

        return self._record(self._share, self._around.index(x) * NUM_GROUPS, part)

    def sample_ray(
        self, choice: mi.Float, sample1: mi.Point2f, sample2: mi.Point2f
    ) -> tuple[mi.Point3f, mi.Vector3f]:
        """Point inside a leaf, and direction of travel, of a ray that leaves the lamp."""
        index = self._ray_choice.sample(choice)
        direction, _ = direction_in_bin(index // NUM_GROUPS, sample1, _RESOLUTION, bevelled=False)
        return self._point_of_group(index % NUM_GROUPS, sample2, True), direction

    def record_ray(self, direction: mi.Vector3f) -> tuple[Record, tuple[mi.Float, mi.Float]]:
        """As `record`, for the density of `sample_ray` over projected area and solid angle.

        Args:
            direction: of travel of the light, opposite to the traversal's.
        """
        of_bin = bin_density(direction, _RESOLUTION)

        def part(_, length):
            return 3 * length * of_bin

        row = bin_of(direction, _RESOLUTION, bevelled=False) * NUM_GROUPS
        return self._record(self._ray_share, row, part)

    def _record(self, shares, row, part):
        """Record that sums share · p / 3V · part over leaves, and the end of the last one."""

        def add(state, leaf, start, length, active, emission=None):
            density, end = state
            packed = dr.gather(mi.UInt32, self._packed, leaf, active)
            share = dr.gather(mi.Float, shares, row + (packed & _GROUP_MASK), active)
            share *= dr.reinterpret_array(mi.Float, packed & _DIGITS)
            density = density + dr.select(active, share * part(start, length), 0)
            return density, dr.select(active, start + length, end)

        return add, (mi.Float(0), mi.Float(-dr.inf))


def is_reached(reach: mi.Float, end: mi.Float) -> mi.Bool:
    """Whether a point of a leaf at distance `reach` is no farther than where the ray is blocked."""
    return reach <= end + 1e-5 * (1 + dr.abs(reach))


def leaf_power(field: Field, levels: NDArray[np.int64]) -> NDArray[np.float64]:
    """Light [M], up to a factor, that leaves the lamp from each leaf: root mean square over rays.

    So leaves that are bright in a few directions count, and hidden ones do not.
    """
    asset = field.asset
    half = mi.Vector3f(*asset.frame.half_extents.tolist())
    rays = int(np.clip(_RAYS_PER_LEAF * asset.num_leaves, _MIN_RAYS, _MAX_RAYS))
    rng = mi.PCG32(rays)
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
    """Group [M] of each leaf: boxes of grid cells; boxes of the largest `_spread` are halved."""
    grid = np.clip((cells + 0.5) * (_GRID / (1 << levels))[:, None], 0, _GRID - 1).astype(np.int64)
    occupied, owner = np.unique(grid @ [1, _GRID, _GRID**2], return_inverse=True)
    boxes = np.stack([occupied % _GRID, occupied // _GRID % _GRID, occupied // _GRID**2], axis=1)
    power = np.bincount(owner, power).astype(np.float64)
    groups = [np.arange(len(occupied))]
    spread = [_spread(boxes, power)]
    while len(groups) < NUM_GROUPS and max(spread) > 0:
        chosen = int(np.argmax(spread))
        members = groups[chosen]
        axis = np.ptp(boxes[members], axis=0).argmax()
        members = members[np.argsort(boxes[members, axis], kind="stable")]
        middle = int(np.searchsorted(np.cumsum(power[members]), power[members].sum() / 2)) + 1
        middle = min(middle, len(members) - 1)
        halves = members[:middle], members[middle:]
        groups[chosen : chosen + 1] = halves
        spread[chosen : chosen + 1] = [_spread(boxes[half], power[half]) for half in halves]
    label = np.zeros(len(occupied), np.int64)
    for index, members in enumerate(groups):
        label[members] = index
    return label[owner]


def _spread(boxes, power):
    """Light of grid cells times the extent of the box that they span."""
    return power.sum() * np.linalg.norm(np.ptp(boxes, axis=0)) if len(boxes) > 1 else 0.0


def _multiplicity(power: NDArray[np.float64], group: NDArray[np.int64]) -> NDArray[np.int64]:
    """Multiplicity [M] of each leaf in the list, by its part of its group's power."""
    order = np.argsort(group, kind="stable")
    members, light = np.bincount(group), np.bincount(group, power)
    parts = _EQUAL_PART + (1 - _EQUAL_PART) * members[group] * power / light[group]
    # Rounded so that the sums over neighbours, and over groups, are right.
    rounded = np.diff(np.floor(_MEAN_MULTIPLICITY * np.cumsum(parts[order]) + 0.5), prepend=0.0)
    multiplicity = np.empty(len(power), np.int64)
    multiplicity[order] = np.maximum(rounded, 0)
    return multiplicity


def _keys(cells: NDArray[np.int64], levels: NDArray[np.int64]) -> NDArray[np.uint32]:
    """Level and cell of each leaf in one number: 1, then z, y, x with as many bits as the level."""
    x, y, z = cells.T
    return ((1 << 3 * levels) | (z << 2 * levels) | (y << levels) | x).astype(np.uint32)
