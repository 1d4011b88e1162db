"""The emitters of a scene: which one next-event estimation samples, and calls of their methods.

Lamps are sampled by the light that they send to the receiver. Candidates come from a table, which
depends on the cell of the scene that the receiver is in. One of them is chosen in proportion to an
estimate of its irradiance at the receiver (resampled importance sampling, Talbot et al. 2005).
`LampKinds` records the code of a method once for each kind of lamp.

Symbols
    N       lamps               K       candidates
    x, n    receiver and its normal, 0 where light may come from all sides
    c, r    centre and radius of the sphere around a lamp's box
    d, ω    distance from c to x, and direction from c to x
    I       luminous intensity of a lamp towards ω: Σ ω_a² I_a over the three of the six axis
            directions a that ω is on the side of
    w       I cos θ' / max(d², r²/4), the estimate. cos θ' = (cos θ + s) / (1 + s), at least 0, with
            the angle θ between n and -ω and with s = min(r/d, 1); it is 0 only where the whole
            sphere is below the receiver's horizon
    p       probability of a lamp in the table of a cell: in proportion to I / max(d², r²/4 + h²/2)
            at the middle of the cell, whose half diagonal is h
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.alias_table import AliasTable
from lumitree.core.device import on_device, parameter
from lumitree.rendering.emitter import Instances, OtherEmitter, PlacedLamp, lamp_of, lamps_of
from lumitree.rendering.sampling import Reservoir, divide_sample

# Index of no lamp.
NO_LAMP = 0xFFFFFFFF
_CANDIDATES = 6
# Cells of the scene, and entries of the table, 8 bytes each, at most. More lamps have fewer cells.
_MAX_CELLS, _MAX_ENTRIES = 1 << 11, 1 << 22
# Part of a lamp's intensity that is the same in all directions, since I is smoothed.
_EVEN_PART = 0.1
# Added to s, so that rounding does not bring a lamp below the horizon; and least cos θ' within the
# sphere, where light may come from any side.
_SLACK, _LEAST_COSINE = 1e-3, 0.25
# Part of the samples for emitters that are no baked luminaires, where a scene has both. Whichever
# light the scene, this at most doubles the second moment of an estimate.
_OTHERS = 0.5
# Packets of four numbers of a lamp on the device: centre and radius; intensities towards +x, +y,
# +z; towards -x, -y, -z.
_PACKETS = 3


@dataclasses.dataclass(frozen=True, eq=False)
class Lamps:
    """Lamps among which one is chosen.

    Attributes:
        indices: [N] index of each lamp's emitter in the scene.
        centres: [N, 3], scene.
        radii: [N] of spheres around their boxes.
        intensities: [N, 6] luminous intensity towards +x, +y, +z, -x, -y and -z of the scene,
            smoothed; any unit.
        low, high: [3] corners of the scene's bounding box.
    """

    indices: NDArray[np.int64]
    centres: NDArray[np.float64]
    radii: NDArray[np.float64]
    intensities: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


class LampChoices:
    """Keeps the tables of the last lamps, which an integrator needs for each pass."""

    def __init__(self) -> None:
        self._last: tuple[list[bytes], LampChoice] | None = None

    def of(self, lamps: Lamps) -> LampChoice:
        """The choice among lamps."""
        numbers = [values.tobytes() for values in vars(lamps).values()]
        if self._last is None or self._last[0] != numbers:
            self._last = numbers, LampChoice(lamps)
        return self._last[1]


class LampChoice:
    """The table and the lamps, at least one, on the device."""

    def __init__(self, lamps: Lamps) -> None:
        count = len(lamps.radii)
        low, side, shape = _grid(lamps, min(_MAX_CELLS, max(1, _MAX_ENTRIES // count)))
        self._low, self._inverse = (
            parameter(mi.Vector3f, *each.tolist()) for each in (low, 1 / side)
        )
        self._shape = parameter(mi.Vector3u, *shape.tolist())
        even = lamps.intensities.mean(axis=1, keepdims=True)
        intensities = (1 - _EVEN_PART) * lamps.intensities + _EVEN_PART * even
        weights = _table(lamps, intensities, low, side, shape)
        self._table = AliasTable.of(weights)
        rows = np.zeros((count, 4 * _PACKETS))
        rows[:, :3], rows[:, 3] = lamps.centres, lamps.radii
        rows[:, 4:7], rows[:, 8:11] = intensities[:, :3], intensities[:, 3:]
        self._rows = on_device(mi.Float, rows)
        self._index_of = on_device(mi.UInt32, lamps.indices)
        lamp_of = np.full(int(lamps.indices.max()) + 1, NO_LAMP, np.uint32)
        lamp_of[lamps.indices] = np.arange(count)
        self._lamp_of = on_device(mi.UInt32, lamp_of)
        self._count = parameter(mi.UInt32, len(lamp_of))

    def sample(
        self,
        x: mi.Point3f,
        n: mi.Vector3f,
        excluded: mi.UInt32,
        sample: mi.Point2f,
        active: mi.Bool,
    ) -> tuple[mi.UInt32, mi.Float, mi.Float]:
        """Choose a lamp.

        Args:
            x, n: receivers, and their normals: unit vectors, or 0.
            excluded: index in the scene of a lamp that is not chosen, or `NO_LAMP`.

        Returns:
            Index in the scene; factor on its light, which then stands for the light of all lamps, 0
            where no candidate sends light; and p.
        """
        row, excluded_lamp = self._row(x), self._lamp(excluded, active)
        kept = mi.UInt32(0), mi.Float(1)
        reservoir = Reservoir.start(sample.x, _CANDIDATES, sample.y, kept)
        for _ in range(_CANDIDATES):
            lamp, pmf = self._table.sample(row, reservoir.place, active)
            weight = dr.select(lamp == excluded_lamp, 0, self._weight(lamp, x, n, active))
            reservoir.add(weight / pmf, (lamp, pmf))
        (lamp, pmf), found = reservoir.kept, mi.Bool(active) & (reservoir.weight > 0)
        factor = dr.select(found, reservoir.factor / pmf, 0)
        return dr.gather(mi.UInt32, self._index_of, lamp, found), factor, pmf

    def pmf(self, index: mi.UInt32, x: mi.Point3f, active: mi.Bool) -> mi.Float:
        """p of a lamp for receivers; 0 for an index that is no lamp's.

        It is not the probability of `sample`, which is also due to the choice among candidates.
        Weights of multiple importance sampling need no more than numbers that are the same for
        both ways to sample a direction, and near the probability.
        """
        lamp = self._lamp(index, active)
        return self._table.probability(self._row(x), lamp, mi.Bool(active) & (lamp != NO_LAMP))

    def _lamp(self, index, active):
        known = mi.Bool(active) & (index < self._count)
        return dr.select(known, dr.gather(mi.UInt32, self._lamp_of, index, known), NO_LAMP)

    def _row(self, x):
        """Row of the table for receivers; the nearest cell for those outside of the grid."""
        place = dr.maximum((mi.Vector3f(x) - self._low) * self._inverse, 0)
        cell = mi.Vector3u(dr.minimum(place, mi.Vector3f(self._shape)))
        cell = dr.minimum(cell, self._shape - 1)
        return (cell.x * self._shape.y + cell.y) * self._shape.z + cell.z

    def _weight(self, lamp, x, n, active):
        """w of a lamp."""
        centre, high, low = (
            dr.gather(mi.Vector4f, self._rows, _PACKETS * lamp + i, active) for i in range(_PACKETS)
        )
        offset = mi.Vector3f(x) - mi.Vector3f(centre.x, centre.y, centre.z)
        squared, radius = dr.maximum(dr.squared_norm(offset), dr.smallest(mi.Float)), centre.w
        inverse = dr.rsqrt(squared)
        direction = offset * inverse
        squares, towards = dr.square(direction), direction > 0
        intensity = squares.x * dr.select(towards.x, high.x, low.x)
        intensity += squares.y * dr.select(towards.y, high.y, low.y)
        intensity += squares.z * dr.select(towards.z, high.z, low.z)
        spread = dr.minimum(radius * inverse + _SLACK, 1)
        cosine = dr.select(dr.squared_norm(n) > 0, -dr.dot(n, direction), 1)
        least = dr.select(squared < dr.square(radius), _LEAST_COSINE * (1 + spread), 0)
        weight = intensity * dr.maximum(cosine + spread, least)
        weight /= (1 + spread) * dr.maximum(squared, dr.square(radius) / 4)
        return dr.select(active, weight, 0)


def _grid(
    lamps: Lamps, cells: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Corner [3] of the grid, sides [3] of its cells, and its shape [3].

    It covers the part of the scene's box that is no farther from the lamps than their extent.
    """
    reach = lamps.radii[:, None]
    low, high = (lamps.centres - reach).min(axis=0), (lamps.centres + reach).max(axis=0)
    extent = (high - low).max()
    low, high = np.maximum(low - extent, lamps.low), np.minimum(high + extent, lamps.high)
    size = np.maximum(high - low, 1e-3 * extent)
    # The shortest side first: the others share the cells that it leaves, rounded down.
    shape = np.ones(3, np.int64)
    for done, axis in enumerate(np.argsort(size)):
        rest = np.argsort(size)[done:]
        left = cells / shape.prod()
        side = (size[rest].prod() / left) ** (1 / len(rest))
        shape[axis] = max(1, int(size[axis] / side))
    return low, size / shape, shape


def _table(
    lamps: Lamps,
    intensities: NDArray[np.float64],
    low: NDArray[np.float64],
    side: NDArray[np.float64],
    shape: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Weights [S, N] of the table, by planes of cells."""
    found = []
    least = lamps.radii**2 / 4 + (side / 2) @ (side / 2) / 2
    for plane in range(shape[0]):
        y, z = np.meshgrid(*map(np.arange, shape[1:]), indexing="ij")
        cell = np.stack([np.full(y.size, plane), y.ravel(), z.ravel()], axis=1)
        offset = (low + (cell + 0.5) * side)[:, None] - lamps.centres
        squares = np.square(offset)
        sides = np.where(offset > 0, intensities[:, :3], intensities[:, 3:])
        distance = squares.sum(axis=2)
        weights = (squares * sides).sum(axis=2) / np.maximum(distance, 1e-30)
        weights /= np.maximum(distance, least)
        # Where no lamp sends light all are chosen alike.
        weights[~weights.any(axis=1)] = 1
        found.append(weights)
    return np.concatenate(found)


@dataclass
class Selected:
    """An emitter that was selected (a PyTree of Dr.Jit)."""

    # fmt: off
    index: mi.UInt32         # Index in the scene
    weight: mi.Float         # Factor on its light, which stands for all light; 0: there is none
    emitter_pmf: mi.Float    # Its probability for multiple importance sampling
    sample: mi.Point2f       # For the direction, in the unit square
    # fmt: on


class EmitterSelection:
    """Selection of emitters.

    With two baked luminaires or more, these are selected by their light for the receiver
    (`LampChoice`), and half of the samples are for all other emitters, by their sampling weights.
    Else all are selected by their sampling weights, as `mi.Scene.sample_emitter` does.

    Attributes:
        by_receiver: whether probabilities depend on the receiver.
    """

    def __init__(self, scene: mi.Scene, choices: LampChoices) -> None:
        self._scene, emitters = scene, scene.emitters()
        weights = np.array([emitter.sampling_weight() for emitter in emitters])
        self._total_weight = float(weights.sum())
        # If the weight of an emitter is 0, the rays of BSDFs find all of its light.
        lamps = {i: each for i, each in lamps_of(emitters).items() if weights[i] > 0}
        self.by_receiver = len(lamps) > 1
        if not self.by_receiver:
            return
        indices = np.array(list(lamps))
        centres, radii = zip(*(lamp.sphere for lamp in lamps.values()), strict=True)
        intensities = np.array([lamp.axis_intensities() for lamp in lamps.values()])
        intensities *= weights[indices, None]
        box = scene.bbox()
        low, high = (np.array(each, np.float64).ravel() for each in (box.min, box.max))
        self._lamps = choices.of(
            Lamps(indices, np.array(centres), np.array(radii), intensities, low, high)
        )
        weights[indices] = 0
        others = np.flatnonzero(weights)
        self._has_others = bool(len(others))
        # By the index of an emitter: its probability if it is no lamp.
        pmf = np.zeros(len(emitters))
        if self._has_others:
            self._others = AliasTable.of(weights[None, others])
            self._other_indices = on_device(mi.UInt32, others)
            pmf[others] = _OTHERS * weights[others] / weights.sum()
        numbers = np.array(dr.reinterpret_array(mi.UInt32, scene.emitters_dr()))
        # By the number of an emitter among all emitters of the process.
        index_of = np.full(numbers.max() + 1, NO_LAMP, np.uint32)
        pmf_of = np.zeros(numbers.max() + 1)
        index_of[numbers], pmf_of[numbers] = np.arange(len(emitters)), pmf
        self._index_of, self._pmf_of = on_device(mi.UInt32, index_of), on_device(mi.Float, pmf_of)
        self._lamp_fraction = 1 - _OTHERS if self._has_others else 1.0

    def sample(
        self,
        si: mi.SurfaceInteraction3f,
        normal: mi.Vector3f,
        owner: mi.UInt32,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Selected:
        """Select an emitter.

        Args:
            normal: towards the side that light comes from, unit length; 0 where it may come from
                both.
            owner: index of a lamp whose light the receiver gets otherwise.
        """
        sample = sampler.next_2d()
        if not self.by_receiver:
            index, weight, sample.x = self._scene.sample_emitter(sample.x, active)
            return Selected(index, weight, dr.rcp(weight), sample)
        choice, other = sampler.next_2d(), mi.Bool(False)
        if self._has_others:
            other, choice.x = divide_sample(choice.x, _OTHERS)
        lit = active & ~other
        index, weight, pmf = self._lamps.sample(si.p, normal, owner, choice, lit)
        weight, pmf = weight / self._lamp_fraction, pmf * self._lamp_fraction
        if self._has_others:
            entry, entry_pmf = self._others.sample(mi.UInt32(0), choice.x, active & other)
            found = dr.gather(mi.UInt32, self._other_indices, entry, active & other)
            index = dr.select(other, found, index)
            pmf = dr.select(other, _OTHERS * entry_pmf, pmf)
            weight = dr.select(other, dr.rcp(pmf), weight)
        return Selected(index, weight, pmf, sample)

    def pmf(
        self, emitter: mi.EmitterPtr, it: mi.Interaction3f, active: mi.Bool | bool = True
    ) -> mi.Float:
        """`Selected.emitter_pmf` that an emitter of the scene has for a receiver."""
        if not self.by_receiver:
            return emitter.sampling_weight() * dr.rcp(self._total_weight)
        number = dr.reinterpret_array(mi.UInt32, emitter)
        index = dr.gather(mi.UInt32, self._index_of, number, active)
        pmf = self._lamps.pmf(index, it.p, mi.Bool(active))
        return dr.gather(mi.Float, self._pmf_of, number, active) + self._lamp_fraction * pmf


class LampKinds:
    """The emitters of a scene by kind: lamps of a kind differ by numbers only.

    `dr.dispatch` records a function once for each emitter, which takes seconds of every image where
    there are hundreds. The numbers of lamps are read from a table here.

    Args:
        emitters, pointers: the two lists of them that a scene has.

    Attributes:
        tracked: whether a lamp has derivatives by its pose (`PlacedLamp.with_derivatives`).
    """

    def __init__(self, emitters: list[mi.Emitter], pointers: mi.EmitterPtr) -> None:
        lamps = lamps_of(emitters)
        self.tracked = any(lamp.moving for lamp in lamps.values())
        self._has_others = len(emitters) > len(lamps)
        numbers = np.array(dr.reinterpret_array(mi.UInt32, pointers))
        # One lamp of each kind, whose code is the same.
        kinds: dict[Hashable, tuple[int, PlacedLamp]] = {}
        # By the number of an emitter among all emitters of the process.
        kind_of = np.full(numbers.max(initial=0) + 1, -1)
        for index, lamp in lamps.items():
            kind = id(lamp.asset), lamp.sampling, lamp.shows_geometry, lamp.lights_inside
            kind_of[numbers[index]] = kinds.setdefault(kind, (len(kinds), lamp))[0]
        self._lamps = [
            lamp.with_derivatives() if self.tracked else lamp for _, lamp in kinds.values()
        ]
        # In forward mode derivatives pass through tables, and not through numbers that a function
        # captures.
        attached = any(lamp.attaches_gain for lamp in lamps.values())
        self._has_instances = len(lamps) > len(kinds) or self.tracked or attached
        if self._has_instances:
            kind_of[kind_of < 0] = len(kinds)
            self._kind_of = on_device(mi.UInt32, kind_of)
            self._instances = Instances({numbers[index]: each for index, each in lamps.items()})

    def call(self, method: str, emitter: mi.EmitterPtr, *args: Any) -> Any:
        """Call a method of `PlacedLamp` of emitters, or of `OtherEmitter`, by its name."""

        def of_any(emitter, *args):
            return getattr(lamp_of(emitter) or OtherEmitter(emitter), method)(*args)

        def of_other(_, pointer, *args):
            def record(emitter, *args):
                return getattr(OtherEmitter(None if lamp_of(emitter) else emitter), method)(*args)

            if self._has_others:
                return dr.dispatch(pointer, record, *args)
            return getattr(OtherEmitter(None), method)(*args)

        def of_kind(lamp: PlacedLamp):
            def record(number, _, *args):
                return getattr(self._instances.of(lamp, number), method)(*args)

            return record

        if not self._has_instances:
            return dr.dispatch(emitter, of_any, *args)
        number = dr.reinterpret_array(mi.UInt32, emitter)
        kind = dr.gather(mi.UInt32, self._kind_of, number)
        return dr.switch(kind, [*map(of_kind, self._lamps), of_other], number, emitter, *args)
