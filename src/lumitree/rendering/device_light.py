"""The light field on the device: its cells are sampled, and rays get their light.

A ray from a receiver crosses cells of the grid. Its radiance is the sum over them of intensity
times length over volume. Nothing in the luminaire occludes it, because the intensities contain all
occlusion. The density of a direction is a sum over the same cells, so one traversal returns both,
in at most three times as many steps as the grid has cells a side.

A cell is sampled from a table that depends on the receiver (`light_table`); then a point of the
cell, uniformly. Receivers that are farther away get points of sums of cells (`light_levels`), whose
tables and intensities are small. Rays get the light of the cells of level 0. Sampled
points and rays of the BSDF are both weighted by the probability of the sum of cells, each at a
level that is random: the mean over levels is the same.

A sampled point is used in two ways. Integrators that sample directions alone get the radiance of
the whole ray through the point, over its density, for which a tenth of the directions is uniform
over the lamp's bounding sphere: no weight exceeds the radiance times 4π over that tenth. An
integrator that leaves the weights to the lamp gets the light of the sampled cell alone, without a
traversal; of several points one is chosen by its light. A path that samples its direction by the
BSDF then gets the rest (`CellLight.received`).

Receivers inside the lamp's box are among the cells. Their light of a cell depends on their distance
from it, because light may end within the lamp (`asset.light_field`): J and s are defined there.

Symbols
    x   receiver
    C   cells        R   bins of direction a side        Q   R / 2
    I   radiant intensity of a cell             f   BSDF times cosine
    p   probability with which a cell is sampled
    V   volume of the part of a cell that is inside the lamp's box. A cell adds
        p (r₁³ - r₀³) / 3V to the density of a direction whose ray is in it from r₀ to r₁
    a   p / V: points at a distance r are sampled with density a r² per steradian and length
    b   density, per steradian and length, that stands for the sampling of directions by the BSDF.
        With the balance heuristic a sampled point has the weight I f / (V (a r² + b)), and a point
        of a ray that was sampled by the BSDF has a part b / (a r² + b) of its light

Where the lamp's emitters are in the scene, its straight light is traced (`straight_light`), and the
field is the field of the bent light alone.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import (
    EXPONENT_OF_ONE,
    EXPONENT_SHIFT,
    MANTISSA,
    MANTISSA_SHIFTS,
    LightField,
    by_coarse_bin,
    by_fine_bin,
    dense,
    divided,
    pack_lit,
    parts_of_ending,
    unpack,
)
from lumitree.core.alias_table import AliasTable
from lumitree.core.device import as_rows, concatenate, on_device, parameter, random_numbers
from lumitree.core.octahedral import (
    bin_of,
    coarse_bin,
    coarse_solid_angles,
    direction_in_bin,
    octahedral,
    solid_angles,
)
from lumitree.core.photometry import luminance
from lumitree.octree.build import build_children, grid_boxes_inside, morton
from lumitree.octree.traversal import Octree
from lumitree.rendering.light_levels import (
    POINTS,
    level_limits,
    light_sums,
    points_around,
)
from lumitree.rendering.light_table import InsideReceivers, LevelChoice, ReceiverCells, cell_rows
from lumitree.rendering.sampling import (
    INSIDE,
    OUTSIDE,
    UNIFORM_FRACTION,
    Reservoir,
    Target,
    cone_pdf,
    cosine_weight,
    divide_sample,
    sample_cone,
    sample_row,
    scrambled,
)

# Cells of receivers, see `ReceiverCells`: with levels, and without.
RECEIVERS, _ROUGH = (16, 6, 1 / 3), (4, 1, 1.2)
# Entries of the table, of 8 bytes: lamps with more cells have fewer rows.
_MAX_ENTRIES = 1 << 24
# Candidates of which a point is chosen, at level 0 and at others. With more, a sample takes longer
# than its noise is worth, but for receivers near the box (`DeviceLight.row`).
_CANDIDATES, _FAR_CANDIDATES = 4, 2
# Cells of receivers a side in the box, and entries of their table: lamps with more cells have half
# as many cells of receivers a side.
_INSIDE_RESOLUTION, _MAX_INSIDE_ENTRIES = 8, 1 << 23
# Curves of J are looked up at this many distances, more densely where they are short.
_STEPS = 64
_NONE = 0xFFFFFFFF
# Cells whose bins are computed at once, which bounds the memory.
_CELLS_AT_ONCE = 1 << 10


class LightCells:
    """The parts of cells that are inside a lamp's box; light starts anywhere in them.

    Args:
        cells: [C, 3] coordinates, in Morton order.
        depth: the grid has 2**depth cells a side.
        more: lower and upper corners [.., 3] of boxes that follow the cells.

    Attributes:
        octree: of the cells, whose leaves are numbered as they are.
        corners: mi.Float [C × 2 × 3], lower and upper corner of each cell or box.
        volume: mi.Float [C].
    """

    def __init__(
        self,
        half_extents: NDArray[np.float64],
        cells: NDArray[np.integer],
        depth: int,
        more: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]] = (),
    ) -> None:
        children = build_children(cells.astype(np.int64), np.full(len(cells), depth))
        self.octree = Octree(children, depth, half_extents)
        boxes = grid_boxes_inside(half_extents, cells, depth), *more
        lower, upper = (np.concatenate(each) for each in zip(*boxes, strict=True))
        self.corners = on_device(mi.Float, np.stack([lower, upper], axis=1))
        volume = (upper - lower).prod(axis=1)
        boxes = lower, volume, upper - lower, np.zeros(len(lower))
        self._boxes = on_device(mi.Float, np.column_stack(boxes))
        self.volume = on_device(mi.Float, volume)

    def point(
        self, cell: mi.UInt32, within: mi.Point3f, active: mi.Bool | bool = True
    ) -> tuple[mi.Point3f, mi.Float]:
        """Point of a cell for numbers in [0, 1)³, and the volume of the cell."""
        # Four numbers are one load.
        lower, size = (dr.gather(mi.Vector4f, self._boxes, 2 * cell + i, active) for i in (0, 1))
        corner, side = mi.Point3f(lower.x, lower.y, lower.z), mi.Vector3f(size.x, size.y, size.z)
        return dr.fma(side, within, corner), lower.w


class Row(NamedTuple):
    """Row of the table for a receiver.

    Attributes:
        number: within the part of the table for the level.
        level: of the receiver.
        first: index of the first cell of the level.
        candidates: of which a point is chosen.
    """

    number: mi.UInt32
    level: mi.UInt32
    first: mi.UInt32
    candidates: mi.UInt32


class CellLight:
    """Light that cells send to receivers of one kind: outside the lamp's box, or inside.

    Attributes:
        cells: from which light starts.
        radius: of the lamp's bounding sphere.
        place: of the targets of `sample_point`.
    """

    cells: LightCells
    place: int

    def __init__(self, half_extents: NDArray[np.float64], resolution: int) -> None:
        self._resolution = resolution
        self.radius = parameter(mi.Float, float(np.linalg.norm(half_extents)))
        self._diffuse = dr.rcp(np.pi * self.radius)

    @property
    def table(self) -> AliasTable:
        """The table from which cells are sampled."""
        raise NotImplementedError

    def row(self, x: mi.Point3f, sample: mi.Float) -> Row:
        """Row of the table for a receiver and a sample in [0, 1)."""
        raise NotImplementedError

    def light(
        self, cell: mi.UInt32, bins: mi.UInt32, distance: mi.Float, active: mi.Bool
    ) -> mi.Color3f:
        """Radiant intensity of a cell in a bin of direction, for receivers at a distance."""
        raise NotImplementedError

    def parent(self, cell: mi.UInt32, row: Row, active: mi.Bool) -> mi.UInt32:
        """Index of the cell of the row's level that contains a cell of level 0."""
        return cell

    def smooth_light(
        self, cell: mi.UInt32, direction: mi.Vector3f, distance: mi.Float, active: mi.Bool
    ) -> mi.Color3f:
        """As `light`, linear between the middles of bins; has derivatives by the direction."""
        light = mi.Color3f(0)
        for bins, weight in bins_around(direction, self._resolution):
            light += weight * self.light(cell, bins, distance, active)
        return light

    @dr.syntax
    def sample_point(
        self,
        x: mi.Point3f,
        normal: mi.Vector3f,
        sample: mi.Point2f,
        active: mi.Bool | bool = True,
        smooth: bool = False,
    ) -> tuple[mi.Vector3f, Target]:
        """Direction towards a point of a cell of the receiver's level, and the point.

        Resampled importance sampling: the weight of a candidate is its `contribution` to a diffuse
        surface, about: with a b of 1 / πR, R the radius of the bounding sphere, times its cosine.

        Args:
            normal: as of `cosine_weight`.
            smooth: whether the weight is of `smooth_light`: 0 only where this has no derivatives.
        """
        # Bits of the sample that the candidates do not depend on.
        random = scrambled(mi.Point2f(sample.y, sample.x))
        row, candidate, target = self.row(x, random.y), mi.UInt32(0), Target.at(mi.Float(1))
        kept = mi.Vector3f(0, 0, 1), target.cell, target.pmf, target.bins
        reservoir = Reservoir.start(sample.x, row.candidates, random.x, kept)
        while dr.hint(active & (candidate < row.candidates), mode="symbolic"):
            cell, pmf = self.table.sample(row.number, reservoir.place, active, row.level)
            cell += row.first
            within = scrambled(mi.Point2f(reservoir.place, sample.y))
            point, volume = self.cells.point(cell, within, active)
            offset = mi.Vector3f(point - x)
            bins = smooth_bin(-offset, self._resolution)
            squared = dr.squared_norm(offset)
            far = dr.sqrt(squared)
            if dr.hint(smooth, mode="scalar"):
                light = dr.sum(self.smooth_light(cell, -offset, far, mi.Bool(active)))
            else:
                light = dr.sum(self.light(cell, bins, far, mi.Bool(active)))
            light *= cosine_weight(normal, offset, 0) / (pmf * squared + volume * self._diffuse)
            reservoir.add(light, (offset, cell, pmf, bins))
            candidate += 1
        direction, target.cell, target.pmf, target.bins = reservoir.kept
        target.place = mi.UInt32(self.place)
        target.factor, target.total = reservoir.factor, reservoir.mean
        target.distance = dr.norm(direction)
        return direction / target.distance, target

    def contribution(
        self, target: Target, other: mi.Float, active: mi.Bool | bool = True
    ) -> mi.Color3f:
        """I / (V (a r² + b)) of a point of `sample_point`, times the factor of its choice.

        Args:
            other: b.
        """
        volume = dr.gather(mi.Float, self.cells.volume, target.cell, active)
        density = target.pmf * dr.square(target.distance) + other * volume
        light = self.light(target.cell, target.bins, target.distance, mi.Bool(active))
        return dr.select(active & (density > 0), light * (target.factor / density), 0)

    def smooth_contribution(
        self, target: Target, offset: mi.Vector3f, active: mi.Bool
    ) -> mi.Color3f:
        """`contribution` of `smooth_light` for a b of 0, with derivatives by the offset.

        Args:
            offset: from the receiver to the point, local units.
        """
        distance = dr.norm(offset)
        light = self.smooth_light(target.cell, -offset, distance, active)
        density = target.pmf * dr.square(distance)
        return dr.select(active & (density > 0), light * (target.factor / density), 0)

    def received(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        inverse: mi.Float,
        end: mi.Float,
        active: mi.Bool | bool = True,
    ) -> mi.Color3f:
        """Part of the radiance from a direction that `contribution` leaves.

        In a cell from r₀ to r₁ with k² = a / b it is ∫ dr / (1 + k² r²), or atan(z) / k with
        z = k (r₁ - r₀) / (1 + k² r₀ r₁), times I / V. a is of the sum that the cell is a part of,
        and I is taken at the middle of the ray's way in the cell.

        Args:
            entry: point of the ray from which on it gets light.
            inverse: 1 / b; 0 for the whole radiance.
            end: distance from `entry` at which the ray terminates.
        """
        # Other bits of the direction than the bins depend on.
        row = self.row(x, scrambled(mi.Point2f(direction.z, direction.x)).x)
        shared = mi.Bool(active) & (inverse > 0)
        distance, bins = dr.norm(entry - x), smooth_bin(-direction, self._resolution, entry)

        def visit(state, cell, start, length, active):
            near = start + distance
            shares = active & shared
            parent = self.parent(cell, row, shares)
            pmf = self.table.probability(row.number, parent - row.first, shares, row.level)
            volume = dr.gather(mi.Float, self.cells.volume, parent, shares)
            left = left_part(dr.select(shares, pmf / volume, 0), inverse, near, length)
            left /= dr.gather(mi.Float, self.cells.volume, cell, active)
            light = left * self.light(cell, bins, near + length / 2, active)
            return (state[0] + dr.select(active, light, 0),), active

        state, span = (mi.Color3f(0),), (mi.Float(0), end)
        return self.cells.octree.traverse(entry, direction, active, visit, state, span)[0]


class _Tables(NamedTuple):
    """Tables of a `DeviceLight`.

    Attributes:
        around: receivers of each level.
        records: first cell, farthest and nearest shell, and number of candidates of each level.
        parents: [C, levels] cell of each level that contains a cell of level 0.
        cells: the table, with a part for each level.
    """

    around: list[ReceiverCells]
    records: mi.UInt32
    parents: mi.UInt32
    cells: AliasTable


class DeviceLight(CellLight):
    """Device copy of a light field, in the lamp's local frame; its receivers are outside the box.

    Args:
        factors: [3] factors on R, G and B, not all 0.
        levels: whether there are levels beyond 0. Without them, the table is small.
        minor: whether it is the smaller part of the lamp's light: its points are chosen of half as
            many candidates.

    Attributes:
        scale: mi.Float, unit of intensities.
        cells: the cells of all levels (`light_levels`), the finest first.
        levels: coordinates of the cells of each level.
        choice: of the level of receivers.
        by_cell: [C] luminous flux of the cells of each level, any unit.
    """

    place = OUTSIDE

    def __init__(
        self,
        field: LightField,
        half_extents: NDArray[np.float64],
        factors: tuple[float, float, float] = (1.0, 1.0, 1.0),
        *,
        levels: bool = False,
        minor: bool = False,
    ) -> None:
        super().__init__(half_extents, field.resolution)
        self._minor = minor
        self._half_extents, self._receivers = half_extents, RECEIVERS if levels else _ROUGH
        bins = field.dense(luminance(unpack(field.intensity)))
        flux = np.asarray(bins * solid_angles(field.resolution), np.float64)
        by_cell = flux.sum(axis=1)
        sums = light_sums(field, half_extents, by_cell) if levels else []
        self.levels = [field.cells, *(level.cells for level in sums)]
        self.by_cell = [by_cell, *(level.flux for level in sums)]
        more = [(level.lower, level.upper) for level in sums]
        self.cells = LightCells(half_extents, field.cells, field.depth, more)
        # Sums may be larger than the unit of the field. A power of two changes no mantissa.
        largest = max((float(level.intensity.max()) for level in sums), default=1.0)
        unit = 2.0 ** max(math.ceil(math.log2(largest)), 0)
        packed = [field.dense(divided(field.intensity, unit))]
        packed += [pack_lit(level.intensity, unit) for level in sums]
        self._packed = on_device(mi.UInt32, np.concatenate(packed))
        self.scale = parameter(mi.Float, field.scale * unit * max(factors))
        self._colour = parameter(mi.Color3f, *(factor / max(factors) for factor in factors))
        cumulated = np.cumsum(flux, axis=1)
        self._num_levels = parameter(mi.UInt32, len(self.levels))
        self._bins_cumulated = on_device(mi.Float, cumulated / cumulated[:, -1:])
        self._cells_cumulated = on_device(mi.Float, np.cumsum(by_cell / by_cell.sum()))
        self._first_cells = np.cumsum([0, *map(len, self.levels)]).tolist()
        errors = self._level_errors() if levels else np.zeros(0)
        self.choice = LevelChoice(half_extents, level_limits(errors, field.depth))

    def _level_errors(self) -> NDArray[np.float64]:
        """Relative differences of the irradiance of levels beyond 0, as of `level_limits`."""
        points = points_around(self._half_extents)
        x, n = (on_device(mi.Point3f, np.tile(each, (2, 1))) for each in points)
        found = []
        for level in range(len(self.levels)):
            random = random_numbers(dr.width(x), level)
            light = self.irradiance(x, mi.Vector3f(n), random, mi.Bool(True), level)
            found.append(luminance(as_rows(light)).reshape(2, -1, POINTS).mean(axis=2))
        first, *sums = found
        # The product of two estimates has the square of the error, without the noise of points.
        squares = np.array([(each - first).prod(axis=0).mean() for each in sums])
        error = np.sqrt(np.maximum(squares, 0))
        # A lamp whose light is all straight has next to no bent light.
        return error / first.mean() if first.any() else np.zeros(len(sums))

    @functools.cached_property
    def _tables(self) -> _Tables:
        # Made on first use: light that is only looked at needs none.
        resolution, num_shells, width = self._receivers
        while resolution > 2 and resolution**2 * num_shells * len(self.levels[0]) > _MAX_ENTRIES:
            resolution //= 2
        around, rows, parts, records, parents = [], [], [], [], []
        for level, flux in enumerate(self.by_cell):
            first = self._first_cells[level]
            farthest, nearest = self.choice.shells(level, width, num_shells)
            shells = nearest - farthest + 1
            cells = ReceiverCells(self._half_extents, resolution, shells, width, farthest)
            around.append(cells)
            found, part = self._rows(cells, first, flux)
            rows.append(found)
            parts.append(part)
            candidates = (_FAR_CANDIDATES if level else _CANDIDATES) // (2 if self._minor else 1)
            records.append([first, farthest, nearest, candidates])
            codes = morton(self.levels[level])
            parents.append(first + np.searchsorted(codes, morton(self.levels[0] >> level)))
        return _Tables(
            around,
            on_device(mi.UInt32, records),
            on_device(mi.UInt32, np.stack(parents, axis=1)),
            AliasTable(concatenate(rows), *parts),
        )

    @property
    def table(self) -> AliasTable:
        return self._tables.cells

    def _rows(
        self, around: ReceiverCells, first: int, flux: NDArray[np.float64]
    ) -> tuple[mi.Float, tuple[int, int]]:
        """`cell_rows` of the cells of a level, which begin with the cell `first`."""
        start, count = parameter(mi.UInt32, first), len(flux)
        corners = dr.gather(
            mi.Float, self.cells.corners, dr.arange(mi.UInt32, 6 * count) + 6 * start
        )

        def towards(cell, offset, _distance):
            return self.intensity(cell + start, smooth_bin(offset, self._resolution), True)

        return cell_rows(around, corners, towards, self.scale, flux)

    def row(self, x: mi.Point3f, sample: mi.Float) -> Row:
        level = self.choice.sample(x, sample)
        record = dr.gather(mi.Vector4u, self._tables.records, level)
        around = self._tables.around[0]
        index = around.index(x, mi.Vector2u(record.y, record.z))
        # Rows fit less well near the box: in the last two shells, two and three times as many.
        shell, before = index // around.num_bins + record.y, RECEIVERS[1] - 3
        more = dr.maximum(shell, before) - (before - 1)
        return Row(index, level, record.x, record.w * more)

    def light(
        self, cell: mi.UInt32, bins: mi.UInt32, distance: mi.Float, active: mi.Bool
    ) -> mi.Color3f:
        return self.intensity(cell, bins, active)

    def parent(self, cell: mi.UInt32, row: Row, active: mi.Bool) -> mi.UInt32:
        index = cell * self._num_levels + row.level
        return dr.gather(mi.UInt32, self._tables.parents, index, active)

    def intensity(self, cell: mi.UInt32, index: mi.UInt32, active: mi.Bool | bool) -> mi.Color3f:
        """Radiant intensity of a bin of a cell of any level."""
        packed = dr.gather(mi.UInt32, self._packed, cell * self._resolution**2 + index, active)
        return self._colour * (self.scale * unpacked(packed))

    def sample(
        self, x: mi.Point3f, sample: mi.Point2f, active: mi.Bool | bool = True
    ) -> mi.Vector3f:
        """Unit direction from a receiver at `x`, for integrators that sample directions alone."""
        uniform, rest = divide_sample(sample.x, UNIFORM_FRACTION)
        sample = mi.Point2f(rest, sample.y)
        cell, _ = self.table.sample(self._tables.around[0].index(x), sample.x, active)
        point, _ = self.cells.point(cell, scrambled(sample), active)
        return dr.select(
            uniform, sample_cone(x, self.radius, sample), dr.normalize(mi.Vector3f(point - x))
        )

    def eval(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        active: mi.Bool | bool = True,
        *,
        parallel: bool = False,
    ) -> tuple[mi.Color3f, mi.Float]:
        """Radiance from a direction, and the density with which `sample` returns it.

        Args:
            x: the receiver, as `sample` was given it.
            entry: a point of the ray outside the lamp's box or on it.
            parallel: whether many rays may have one direction, as in an orthographic image.

        Returns:
            Radiance; and density per steradian, 0 where `active` is false.
        """
        row, distance = self._tables.around[0].index(x), dr.norm(entry - x)
        bins = smooth_bin(-direction, self._resolution, entry if parallel else None)

        def visit(state, cell, start, length, active):
            radiance, density = state
            near = start + distance
            far = near + length
            per_volume = length * dr.rcp(dr.gather(mi.Float, self.cells.volume, cell, active))
            third = self.table.probability(row, cell, active) * per_volume / 3
            added = third * (near * near + near * far + far * far)
            light = self.intensity(cell, bins, active) * per_volume
            return (
                radiance + dr.select(active, light, 0),
                density + dr.select(active, added, 0),
            ), active

        state = (mi.Color3f(0), mi.Float(0))
        radiance, density = self.cells.octree.traverse(entry, direction, active, visit, state)
        density = dr.lerp(density, cone_pdf(x, self.radius), UNIFORM_FRACTION)
        return radiance, dr.select(active, density, 0)

    @dr.syntax
    def irradiance(
        self, x: mi.Point3f, n: mi.Vector3f, random: mi.PCG32, active: mi.Bool, level: int = 0
    ) -> mi.Color3f:
        """Irradiance of receivers outside the box that nothing shadows: Σ I cos θ / r².

        Each cell of a level has its light in one random point. The mean over the points is its
        light.
        """
        first, end = (parameter(mi.UInt32, each) for each in self._first_cells[level : level + 2])
        total, cell = mi.Color3f(0), dr.zeros(mi.UInt32, dr.width(x)) + first
        # A sum, for derivatives in reverse.
        while dr.hint(active & (cell < end), max_iterations=-1):
            within = mi.Point3f(random.next_float32(), random.next_float32(), random.next_float32())
            point, _ = self.cells.point(cell, within, active)
            offset = mi.Vector3f(point - x)
            projected = dr.dot(n, offset)
            faces = active & (projected > 0)
            light = mi.Color3f(0)
            for bins, weight in bins_around(-offset, self._resolution):
                light += weight * self.intensity(cell, bins, faces)
            squared = dr.squared_norm(offset)
            total += dr.select(faces, light * projected * dr.rsqrt(squared) / squared, 0)
            cell += 1
        return total

    def sample_ray(
        self,
        choice: mi.Float,
        sample1: mi.Point2f,
        sample2: mi.Point2f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Color3f]:
        """Ray along which light leaves the lamp: a point of it inside the box, direction, and flux.

        The direction is a unit vector along which the light travels. The mean of the flux (local
        units) over all samples is the lamp's flux.
        """
        bins = self._resolution**2
        cells = len(self.levels[0])
        cell = sample_row(self._cells_cumulated, mi.UInt32(0), cells, choice, active)
        index = sample_row(self._bins_cumulated, cell * bins, bins, sample1.x, active)
        point, _ = self.cells.point(cell, scrambled(sample2), active)
        # Other bits of the same samples, which the point does not depend on.
        jitter = scrambled(mi.Point2f(sample2.y, sample1.y))
        spread = scrambled(mi.Point2f(sample1.y, sample2.y)) - 0.5
        # As of `smooth_bin`: a bin has a part of the light of directions in its neighbours.
        sample = mi.Point2f(jitter.x + spread.x, jitter.y + spread.y)
        direction, density = direction_in_bin(index, sample, self._resolution)

        def pmf(cumulated, first, index):
            upper = dr.gather(mi.Float, cumulated, first + index, active)
            inner = active & (index > 0)
            return upper - dr.gather(mi.Float, cumulated, first + index - 1, inner)

        sampled = pmf(self._cells_cumulated, mi.UInt32(0), cell)
        sampled *= pmf(self._bins_cumulated, cell * bins, index)
        flux = self.intensity(cell, index, active) / (sampled * density)
        return point, direction, dr.select(active & (sampled > 0), flux, 0)


class InsideLight(CellLight):
    """Device copy of the light of a light field for receivers inside the box.

    Args:
        field: of the light. Without its part `inside`, receivers get the light that leaves the box.
        outside: of the same field.
    """

    place = INSIDE

    def __init__(
        self,
        field: LightField,
        half_extents: NDArray[np.float64],
        outside: DeviceLight,
        factors: tuple[float, float, float],
    ) -> None:
        super().__init__(half_extents, field.resolution)
        inside, self._outside = field.inside, outside
        found = field.cells if inside is None else inside.cells
        count = len(found)
        self._coarse = field.resolution // 2
        self.cells = LightCells(half_extents, found, field.depth)
        rows = np.full(count, _NONE, np.uint32)
        rows[np.searchsorted(morton(found), morton(field.cells))] = np.arange(len(field.cells))
        self._rows = on_device(mi.UInt32, rows)
        outgoing = field.dense(luminance(unpack(field.intensity))) * solid_angles(field.resolution)
        flux = np.zeros(count)
        flux[rows != _NONE] = field.scale * outgoing.sum(axis=1)
        self._has_curves = inside is not None
        if inside is not None:
            bins = self._coarse**2
            packed, scale = ending_by_bin(field)
            self._packed = on_device(mi.UInt32, packed)
            self._rows_of_reach = on_device(mi.UInt32, dense(inside.lit, bins, inside.reach))
            self._factors = parameter(mi.Color3f, *(scale * factor for factor in factors))
            # By the square root of distance.
            self._steps = parameter(mi.Float, (_STEPS - 1) / math.sqrt(inside.distances[-1]))
            at = inside.distances[-1] * np.linspace(0, 1, _STEPS) ** 2
            curves = [np.interp(at, inside.distances, each) for each in inside.reach_curves]
            self._reach = on_device(mi.Float, np.stack(curves))
            ending = dense(inside.lit, bins, luminance(unpack(inside.intensity)))
            flux += inside.scale * (ending * coarse_solid_angles(field.resolution)).sum(axis=1)
        many = _INSIDE_RESOLUTION**3 * count > _MAX_INSIDE_ENTRIES
        self._receivers = InsideReceivers(half_extents, _INSIDE_RESOLUTION // (2 if many else 1))

        def towards(cell, offset, distance):
            bins = smooth_bin(offset, self._resolution)
            return self.light(cell, bins, distance, mi.Bool(True))

        # All light of a cell may end before the first distance.
        flux = np.maximum(flux, 1e-6 * flux.max())
        cell_size = 2.0**-field.depth
        self._table = AliasTable(
            *cell_rows(
                self._receivers,
                self.cells.corners,
                towards,
                outside.scale,
                flux,
                softening=cell_size,
            )
        )

    @property
    def table(self) -> AliasTable:
        return self._table

    def row(self, x: mi.Point3f, sample: mi.Float) -> Row:
        # As many candidates as of receivers that are nearest to the box.
        return Row(self._receivers.index(x), mi.UInt32(0), mi.UInt32(0), mi.UInt32(3 * _CANDIDATES))

    def light(
        self, cell: mi.UInt32, bins: mi.UInt32, distance: mi.Float, active: mi.Bool
    ) -> mi.Color3f:
        row = dr.gather(mi.UInt32, self._rows, cell, active)
        leaves = active & (row != _NONE)
        light = dr.select(leaves, self._outside.intensity(row, bins, leaves), 0)
        if not self._has_curves:
            return light
        packed = dr.gather(mi.UInt32, self._packed, cell * self._resolution**2 + bins, active)
        entry = cell * self._coarse**2 + coarse_bin(bins, self._resolution)
        reach = dr.gather(mi.UInt32, self._rows_of_reach, entry, active)
        # Linear between two columns of its curve.
        at = dr.minimum(dr.sqrt(distance) * self._steps, _STEPS - 1.001)
        step = mi.UInt32(at)
        first = reach * _STEPS + step
        low, high = (dr.gather(mi.Float, self._reach, first + i, active) for i in (0, 1))
        return light + self._factors * unpacked(packed) * dr.lerp(low, high, at - mi.Float(step))


def left_part(
    per_volume: mi.Float, inverse: mi.Float, near: mi.Float, length: mi.Float
) -> mi.Float:
    """∫ dr / (1 + k² r²) of `CellLight.received` over a cell.

    Args:
        per_volume: p / V.
        inverse: 1 / b; where it is 0, the result is `length`.
        near, length: r₀ and r₁ - r₀.
    """
    k = dr.sqrt(per_volume * inverse)
    left = length * dr.rcp(dr.fma(k * k, near * (near + length), 1))
    z = k * left
    return left * dr.select(z > 1e-3, dr.atan(z) / z, 1)


def ending_by_bin(field: LightField) -> tuple[NDArray[np.uint32], float]:
    """J of a light field in the bins of I, as `parts_of_ending` divides it.

    Returns:
        RGB9_E5 numbers [C', R²] of the cells of `field.inside`, and their scale.
    """
    inside = field.inside
    assert inside is not None
    leaving = np.zeros((len(inside.cells), field.resolution**2), np.float32)
    rows = np.searchsorted(morton(inside.cells), morton(field.cells))
    leaving[rows] = field.dense(field.scale * luminance(unpack(field.intensity)))
    packed = dense(inside.lit, (field.resolution // 2) ** 2, inside.intensity)
    solid_angle = by_coarse_bin(solid_angles(field.resolution)[None])
    # A part is at most about 4 times the mean.
    scale, ending = 8 * inside.scale, np.zeros_like(leaving, np.uint32)
    for start in range(0, len(leaving), _CELLS_AT_ONCE):
        at = slice(start, start + _CELLS_AT_ONCE)
        # Light ends in few of the directions.
        ends, coarse = packed[at] != 0, by_coarse_bin(leaving[at])
        mean = inside.scale * unpack(packed[at][ends])
        angles = np.broadcast_to(solid_angle, coarse.shape)[ends]
        parts = parts_of_ending(coarse[ends], luminance(mean), angles)
        words = np.zeros(coarse.shape, np.uint32)
        words[ends] = pack_lit(parts[..., None] * mean[:, None], scale)
        ending[at] = by_fine_bin(words)
    return ending, scale


def smooth_bin(
    direction: mi.Vector3f, resolution: int, origin: mi.Point3f | None = None
) -> mi.UInt32:
    """A bin at random, so that the mean over bins is linear between their middles.

    Args:
        direction: of any length; the random numbers are made of its bits.
        origin: of a ray whose direction many rays may have: the numbers are of both.
    """
    random = scrambled(mi.Point2f(direction.x, direction.y))
    if origin is not None:
        # Three numbers in [0, 1) from the point, by which the others are turned.
        first = scrambled(mi.Point2f(origin.x, origin.y))
        other = scrambled(mi.Point2f(first.z, origin.z))
        random += other
        random -= dr.floor(random)
    return bin_of(direction, resolution, mi.Vector2f(random.x, random.y) - 0.5)


def bins_around(direction: mi.Vector3f, resolution: int) -> list[tuple[mi.UInt32, mi.Float]]:
    """The four bins whose middles are around a direction, and their weights.

    The weights are the probabilities with which `smooth_bin` returns the bins.
    """
    place = (octahedral(direction, resolution) + 1) * (resolution / 2) - 0.5
    fraction = place - dr.floor(place)
    found = []
    for x in (0, 1):
        for y in (0, 1):
            weight = (fraction.x if x else 1 - fraction.x) * (fraction.y if y else 1 - fraction.y)
            found.append((bin_of(direction, resolution, mi.Vector2f(x, y) - fraction), weight))
    return found


def unpacked(packed: mi.UInt32) -> mi.Color3f:
    """Colours of RGB9_E5 numbers."""
    # As `asset.light_field.unpack`: a power of two is a number whose mantissa's 23 bits are 0.
    exponent = (packed >> EXPONENT_SHIFT) + (127 - EXPONENT_OF_ONE)
    unit = dr.reinterpret_array(mi.Float, exponent << 23)
    mantissas = (packed >> shift & MANTISSA for shift in MANTISSA_SHIFTS)
    return mi.Color3f(*(mi.Float(each) for each in mantissas)) * unit
