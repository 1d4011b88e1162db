"""The light field as an emitter: directions towards it are sampled.

A ray from a receiver crosses cells of the grid. Its radiance is the sum over them of intensity
times length over volume. Nothing in the luminaire occludes it, because the intensities contain all
occlusion. The density of a direction is a sum over the same cells, so one traversal returns both,
in at most three times as many steps as the grid has cells a side.

A cell is sampled from a table that depends on the receiver, in proportion to the root mean square
of the light that it sends to the receiver's surroundings, a part of the samples by the flux of
cells; then a point of the cell, uniformly.

Receivers that are farther away get points of sums of cells (`light_levels`), whose tables and
intensities are small. Rays get the light of the field's own cells. Both weights are by the sum,
whose level is chosen at random for each of them: the mean over levels is the same.

A sampled point is used in two ways. Integrators that ask for directions alone get the radiance of
the whole ray through the point, over its density, for which a tenth of the directions is uniform
over the lamp's bounding sphere: no weight exceeds the radiance times 4π over that tenth. An
integrator that leaves the weights to the lamp gets the light of the sampled cell alone, without a
traversal; of several points one is chosen by its light. A path that samples its direction by the
BSDF then gets the rest (`received`).

Symbols
    x   receiver, outside the lamp's box (inside it, see `light_inside`)
    C   cells        R   bins of direction a side
    I   radiant intensity of a cell             f   BSDF times cosine
    p   probability with which a cell is sampled
    V   volume of the part of a cell that is inside the lamp's box. A cell adds
        p (r₁³ - r₀³) / 3V to the density of a direction whose ray is in it from r₀ to r₁
    a   p / V: points at a distance r are sampled with density a r² per steradian and length
    b   density of a direction by the BSDF, divided by a length: per steradian and length.
        With the balance heuristic a sampled point has the weight I f / (V (a r² + b)), and a point
        of a ray that was sampled by the BSDF has a part b / (a r² + b) of its light

Where the lamp's own emitters are in the scene, its straight light is traced (`straight_light`), and
the field gives the bent light alone.
"""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.light_field import LightField
from lumitree.core.alias_table import AliasTable
from lumitree.core.device import on_device, parameter
from lumitree.core.octahedral import bin_of
from lumitree.octree.build import morton
from lumitree.rendering.sampling.cell_table import cell_rows
from lumitree.rendering.sampling.emitted_light import EmittedLight, emitted_light
from lumitree.rendering.sampling.emitter_sampling import UNIFORM_FRACTION, Target
from lumitree.rendering.sampling.light_bins import smooth_bin
from lumitree.rendering.sampling.proxy import cone_pdf, sample_cone
from lumitree.rendering.sampling.receiver_cells import ReceiverCells
from lumitree.rendering.sampling.samples import divide_sample, resample, scrambled

# Cells of receivers, see `receiver_cells`.
_RECEIVERS, _ROUGH = (16, 4, 0.3), (4, 1, 1.2)
# Entries of the table, of 8 bytes: lamps with more cells have fewer rows.
_MAX_ENTRIES = 1 << 24
# Points that one is chosen of, at level 0 and at others. With more, a sample takes longer
# than its noise is worth.
_CANDIDATES, _FAR_CANDIDATES = 4, 2

_LIGHTS: weakref.WeakKeyDictionary[LightField, dict[tuple[object, ...], DeviceLightField]] = (
    weakref.WeakKeyDictionary()
)


def device_light_field(
    asset: Asset, *, bent: bool = False, rough: bool = False
) -> DeviceLightField:
    """Device copy of an asset's light field, or of its bent light, shared by its instances.

    A `rough` one has a small table, which is soon made.
    """
    assert asset.light_field is not None
    lights = _LIGHTS.setdefault(asset.light_field, {})
    key = str(mi.variant()), asset.light_factors, bent, rough
    if key not in lights:
        field = asset.light_field.bent_light if bent else asset.light_field
        light = DeviceLightField(
            field,
            asset.frame.half_extents,
            asset.light_factors,
            None if bent else emitted_light(asset, levels=not rough),
            _ROUGH if rough else _RECEIVERS,
        )
        # Mitsuba creates plugins in parallel: of two copies, the first is kept.
        return lights.setdefault(key, light)
    return lights[key]


class DeviceLightField:
    """Device copy of a light field, in the lamp's local frame.

    Args:
        gain: [3] factors on R, G and B, not all 0.
        emitted: what it emits, if it is on the device already.
        receivers: resolution, shells and their width, see `receiver_cells`.

    Attributes:
        emitted: what it emits, with the levels (`light_levels`) that receivers get.
    """

    def __init__(
        self,
        field: LightField,
        half_extents: NDArray[np.float64],
        gain: tuple[float, float, float] = (1.0, 1.0, 1.0),
        emitted: EmittedLight | None = None,
        receivers: tuple[int, int, float] = _RECEIVERS,
    ) -> None:
        # What receivers inside the box get (`light_inside`).
        self.inside: Any = None
        self.field = weakref.ref(field)
        self.emitted = emitted or EmittedLight(field, half_extents, gain, levels=True)
        self.cells, self.scale = self.emitted.cells, self.emitted.scale
        count, self._resolution = len(field.cells), field.resolution
        self._radius = parameter(mi.Float, float(np.linalg.norm(half_extents)))
        resolution, num_shells, width = receivers
        while resolution > 2 and resolution**2 * num_shells * count > _MAX_ENTRIES:
            resolution //= 2
        self.diffuse = dr.rcp(np.pi * self._radius)
        rows, parts, records, parents = [], [], [], []
        first = 0
        around: list[ReceiverCells] = []
        for level, flux in enumerate(self.emitted.by_cell):
            farthest, nearest = self.emitted.choice.shells(level, width, num_shells)
            shells = nearest - farthest + 1
            around.append(ReceiverCells(half_extents, resolution, shells, width, farthest))
            rows.append(self._rows(around[-1], first, flux))
            parts.append((around[-1].count + 1, len(flux)))
            records.append([first, farthest, nearest, _FAR_CANDIDATES if level else _CANDIDATES])
            codes = morton(self.emitted.levels[level])
            parents.append(first + np.searchsorted(codes, morton(field.cells >> level)))
            first += len(flux)
        # Other integrators, and the light inside, have level 0 alone.
        self._around = around[0]
        self._levels = on_device(mi.UInt32, records)
        self._parents = on_device(mi.UInt32, np.stack(parents, axis=1))
        self._num_levels = parameter(mi.UInt32, len(parents))
        self._table = AliasTable(itertools.chain(*rows), *parts)

    def _rows(
        self, around: ReceiverCells, first: int, flux: NDArray[np.float64]
    ) -> Iterator[NDArray[np.float64]]:
        """Rows of the table for the cells of a level, which begin with the cell `first`."""
        start, count = parameter(mi.UInt32, first), len(flux)
        corners = dr.gather(
            mi.Float, self.cells.corners, dr.arange(mi.UInt32, 6 * count) + 6 * start
        )

        def towards(cell, offset, _distance):
            index = bin_of(offset, self._resolution)
            return self.emitted.intensity(cell + start, index, True)

        return cell_rows(around, corners, towards, self.scale, flux)

    def _place(self, x: mi.Point3f, sample: mi.Float) -> tuple[mi.UInt32, mi.Vector4u, mi.UInt32]:
        """Level of a receiver, the level's record, and the row of the table."""
        level = self.emitted.choice.sample(x, sample)
        record = dr.gather(mi.Vector4u, self._levels, level)
        row = self._around.index(x, mi.Vector2u(record.y, record.z))
        return level, record, row

    def sample(
        self, x: mi.Point3f, sample: mi.Point2f, active: mi.Bool | bool = True
    ) -> mi.Vector3f:
        """Unit direction from a receiver at `x`."""
        uniform, rest = divide_sample(sample.x, UNIFORM_FRACTION)
        sample = mi.Point2f(rest, sample.y)
        cell, _ = self._table.sample(self._around.index(x), sample.x, active)
        point = self.cells.point(cell, scrambled(sample), active)
        return dr.select(
            uniform, sample_cone(x, self._radius, sample), dr.normalize(mi.Vector3f(point - x))
        )

    def eval(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        distance: mi.Float,
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
        row = self._around.index(x)
        bins = smooth_bin(-direction, self._resolution, entry if parallel else None)

        def visit(state, cell, start, length, active):
            radiance, density = state
            near = start + distance
            far = near + length
            per_volume = length * dr.rcp(dr.gather(mi.Float, self.cells.volume, cell, active))
            third = self._table.probability(row, cell, active) * per_volume / 3
            part = third * (near * near + near * far + far * far)
            light = self.emitted.intensity(cell, bins, active) * per_volume
            return (
                radiance + dr.select(active, light, 0),
                density + dr.select(active, part, 0),
            ), active

        state = (mi.Color3f(0), mi.Float(0))
        radiance, density = self.cells.octree.traverse(entry, direction, active, visit, state)
        density = dr.lerp(density, cone_pdf(x, self._radius), UNIFORM_FRACTION)
        return radiance, dr.select(active, density, 0)

    @dr.syntax
    def sample_point(
        self,
        x: mi.Point3f,
        sample: mi.Point2f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.Vector3f, Target]:
        """Direction towards a point of a cell of the receiver's level, and the point.

        Resampled importance sampling (Talbot et al. 2005): candidates come from the table, and one
        is chosen in proportion to what `contribution` has with a b of 1 / πR, about that of a
        diffuse surface; R is the radius of the lamp's bounding sphere. It counts for all, by their
        mean.
        """
        # Bits of the sample that the candidates do not depend on.
        random = scrambled(mi.Point2f(sample.y, sample.x))
        level, record, row = self._place(x, random.y)
        count, step = record.w, dr.rcp(mi.Float(record.w))
        candidate, place, choice = mi.UInt32(0), mi.Float(sample.x), random.x
        total, chosen = mi.Float(0), mi.Float(0)
        offset, target = mi.Vector3f(0, 0, 1), Target.at(mi.Float(1))
        found, pmf, found_bins = mi.UInt32(0), mi.Float(0), mi.UInt32(0)
        while dr.hint(active & (candidate < count), mode="symbolic"):
            cell, chance = self._table.sample(row, place, active, level)
            cell += record.x
            within = scrambled(mi.Point2f(place, sample.y))
            point, volume = self.cells.point_and_volume(cell, within, active)
            here = mi.Vector3f(point - x)
            bins = smooth_bin(-here, self._resolution)
            light = dr.sum(self.emitted.intensity(cell, bins, active))
            light /= chance * dr.squared_norm(here) + volume * self.diffuse
            total += light
            taken, choice = resample(choice, light, total)
            # The first one stays where no candidate sends light.
            taken |= candidate == 0
            chosen = dr.select(taken, light, chosen)
            offset = dr.select(taken, here, offset)
            found = dr.select(taken, cell, found)
            pmf = dr.select(taken, chance, pmf)
            found_bins = dr.select(taken, bins, found_bins)
            candidate += 1
            place += step
            place = dr.select(place < 1, place, place - 1)
        target.cell, target.pmf, target.bins = found, pmf, found_bins
        total *= step
        target.factor = dr.select(chosen > 0, total / chosen, 0)
        target.distance, target.total = dr.norm(offset), total
        return offset / target.distance, target

    def contribution(
        self, target: Target, other: mi.Float, active: mi.Bool | bool = True
    ) -> mi.Color3f:
        """I / (V (a r² + b)) of a point of `sample_point`, times the factor of its choice.

        Args:
            other: b.
        """
        volume = dr.gather(mi.Float, self.cells.volume, target.cell, active)
        density = target.pmf * dr.square(target.distance) + other * volume
        intensity = self.emitted.intensity(target.cell, target.bins, active)
        return dr.select(active, intensity * (target.factor / density), 0)

    def received(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        distance: mi.Float,
        inverse: mi.Float,
        end: mi.Float,
        active: mi.Bool | bool = True,
    ) -> mi.Color3f:
        """Part of the radiance from a direction that `contribution` leaves.

        In a cell from r₀ to r₁ with k² = a / b it is ∫ dr / (1 + k² r²), or atan(z) / k with
        z = k (r₁ - r₀) / (1 + k² r₀ r₁), times I / V. a is of the sum that the cell is a part of.

        Args:
            inverse: 1 / b; 0 for the whole radiance.
            end: distance from `entry` at which the ray ends.
        """
        # Other bits of the direction than the bins depend on.
        level, record, row = self._place(x, scrambled(mi.Point2f(direction.z, direction.x)).x)
        shared = mi.Bool(active) & (inverse > 0)
        bins = smooth_bin(-direction, self._resolution, entry)

        def visit(state, cell, start, length, active):
            near = start + distance
            shares = active & shared
            parent = dr.gather(mi.UInt32, self._parents, cell * self._num_levels + level, shares)
            chance = self._table.probability(row, parent - record.x, shares, level)
            volume = dr.gather(mi.Float, self.cells.volume, parent, shares)
            left = left_part(dr.select(shares, chance / volume, 0), inverse, near, length)
            left /= dr.gather(mi.Float, self.cells.volume, cell, active)
            radiance = left * self.emitted.intensity(cell, bins, active)
            return (state[0] + dr.select(active, radiance, 0),), active

        state, span = (mi.Color3f(0),), (mi.Float(0), end)
        return self.cells.octree.traverse(entry, direction, active, visit, state, span)[0]


def left_part(
    per_volume: mi.Float, inverse: mi.Float, near: mi.Float, length: mi.Float
) -> mi.Float:
    """∫ dr / (1 + k² r²) of `DeviceLightField.received` over a cell.

    Args:
        per_volume: p / V.
        inverse: 1 / b; where it is 0, the result is `length`.
        near, length: r₀ and r₁ - r₀.
    """
    k = dr.sqrt(per_volume * inverse)
    left = length * dr.rcp(dr.fma(k * k, near * (near + length), 1))
    z = k * left
    return left * dr.select(z > 1e-3, dr.atan(z) / z, 1)
