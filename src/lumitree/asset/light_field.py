"""The light field of a luminaire: its light for receivers outside its box, and for those inside.

Inside the box there is also light that leaves a cell and ends on the luminaire itself: it lights
what stands in its way. The part of it that gets farther than a distance r is its reach. A receiver
at distance r from a point of a cell gets I + J s. The parts of I and J that are not straight
(`LightField`) are stored beside them, with a reach for each.

Only bins that have light are stored, with a bit mask of these bins. A colour has 32 bits: red,
green and blue with a common exponent (RGB9_E5).

Symbols
    C   cells           R   bins of direction a side, see `core.octahedral`
    B   bins of all cells in which anything is emitted
    Q   bins a side inside the box, R / 2
    E   entries: bins of all cells inside the box in which there is any light
    K   distances
    I   radiant intensity of a cell that leaves the box
    J   radiant intensity of a cell that ends on the luminaire
    s   reach: part of J that gets farther than r
"""

import dataclasses
import functools
import string
from typing import Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from lumitree.core.reading import expect, expect_arrays, expect_range
from lumitree.core.seeds import MAX_SEED
from lumitree.errors import LumitreeError, shown
from lumitree.octree.build import morton

_FIELD, _INSIDE = "light field", "light inside the box"
Number = TypeVar("Number", bound=np.generic)

# Luminous openings by shape; a cylinder by its axis.
Outline = Literal["box", "ellipsoid", "cylinder-x", "cylinder-y", "cylinder-z"]
OUTLINES: tuple[Outline, ...] = get_args(Outline)
# A cell is named by 10 bits a coordinate, and a device array of all bins has at most 2³¹.
MAX_DEPTH, MAX_RESOLUTION = 7, 512
MAX_BINS = 1 << 28
# Limits of `TracedPaths`.
MAX_PATHS, MAX_SEEDS = 1 << 50, 1 << 12
# An entry inside the box names a curve by 8 bits.
MAX_CURVES, MAX_DISTANCES = 256, 64
# Red, green and blue of 9 bits with a common exponent of 5 bits, as OpenGL's RGB9_E5. Colours
# are at most 1, so the exponent's offset is 31 in place of 15: darker colours can be stored.
_EXPONENT_OFFSET, _MANTISSA_BITS, _EXPONENT_BITS = 31, 9, 5
# Where the mantissas and the exponent are in a number, and a mantissa's bits. The unit of the
# mantissas is 2 to the power of the exponent less `EXPONENT_OF_ONE`.
MANTISSA_SHIFTS = (0, _MANTISSA_BITS, 2 * _MANTISSA_BITS)
EXPONENT_SHIFT = 3 * _MANTISSA_BITS
MANTISSA = (1 << _MANTISSA_BITS) - 1
EXPONENT_OF_ONE = _MANTISSA_BITS + _EXPONENT_OFFSET - 1


@dataclasses.dataclass(frozen=True)
class TracedPaths:
    """The light paths that a light field was estimated from.

    Attributes:
        count: number of paths that were started, 1 to 2⁵⁰.
        seeds: root seeds of their random numbers, in increasing order, at most 4096.
        luminaire: fingerprint of the luminaire, 64 hexadecimal digits.
        noise: relative standard error of the luminous intensity in the bins of direction, summed
            over all cells; root mean square over the sphere. None if it is not known.

    Raises:
        LumitreeError: a member has a wrong type or range.
    """

    count: int
    seeds: tuple[int, ...]
    luminaire: str
    noise: float | None = None

    def __post_init__(self) -> None:
        """Check the members."""
        what = "record of light paths"
        expect_range(what, "count", self.count, int, 1, MAX_PATHS)
        if self.noise is not None:
            expect_range(what, "noise", self.noise, float, 0, 1e300)
        seeds = self.seeds
        expect(
            what,
            type(seeds) is tuple
            and 1 <= len(seeds) <= MAX_SEEDS
            and all(type(seed) is int and 0 <= seed <= MAX_SEED for seed in seeds)
            and list(seeds) == sorted(set(seeds)),
            f"seeds {shown(seeds, 60)}, expected increasing integers from 0 to {MAX_SEED}",
        )
        digits = self.luminaire
        expect(
            what,
            type(digits) is str and len(digits) == 64 and set(digits) <= set(string.hexdigits[:16]),
            f"luminaire {shown(digits, 80)}, expected 64 hexadecimal digits",
        )


@dataclasses.dataclass(frozen=True, eq=False)
class LightInside:
    """Light that ends on a luminaire, by cell, direction and distance.

    Curves are linear between the distances, and constant beyond the last.

    Attributes:
        cells: uint8 [C, 3], coordinates of the cells that light leaves, in Morton order: the cells
            of the light field, and others whose light all ends on the luminaire.
        lit: uint8 [C, ⌈Q² / 8⌉], which bins of each cell have an entry; the first bin in the
            highest bit.
        intensity: uint32 [E], J by cell and then by bin: RGB9_E5 numbers (`unpack`) times `scale`.
            Local units, as in the light field.
        bent: uint32 [E], the part of J that is not straight, likewise; in no channel more than J.
        reach: uint8 [E], row of J in `reach_curves`.
        bent_reach: uint8 [E], row of the bent part in `reach_curves`.
        distances: float32 [K], increasing from 0, local units.
        reach_curves: float32 [.., K], s, 0 to 1, not increasing, the last 0.
        scale: factor of `intensity`.

    Raises:
        LumitreeError: a member has a wrong type, shape or range.
    """

    cells: NDArray[np.uint8]
    lit: NDArray[np.uint8]
    intensity: NDArray[np.uint32]
    bent: NDArray[np.uint32]
    reach: NDArray[np.uint8]
    bent_reach: NDArray[np.uint8]
    distances: NDArray[np.float32]
    reach_curves: NDArray[np.float32]
    scale: float

    def __post_init__(self) -> None:
        """Refuse what a renderer could not use safely."""
        # Arrays of a file may have no dimensions, and so no length.
        cells, distances = self.cells.shape[:1], self.distances.shape
        reach_curves = np.float32, (*self.reach_curves.shape[:1], *distances)
        expect_arrays(
            _INSIDE,
            {
                "cells": (self.cells, np.uint8, (*cells, 3)),
                "lit": (self.lit, np.uint8, (*cells, *self.lit.shape[1:])),
                "intensity": (self.intensity, np.uint32, (self.intensity.size,)),
                "bent": (self.bent, np.uint32, self.intensity.shape),
                "reach": (self.reach, np.uint8, self.intensity.shape),
                "bent_reach": (self.bent_reach, np.uint8, self.intensity.shape),
                "distances": (self.distances, np.float32, (self.distances.size,)),
                "reach_curves": (self.reach_curves, *reach_curves),
            },
        )
        _check_bins(_INSIDE, self)
        steps, curves = self.distances, self.reach_curves
        expect(
            _INSIDE,
            2 <= len(steps) <= MAX_DISTANCES
            and np.isfinite(steps).all()
            and steps[0] == 0
            and (np.diff(steps) > 0).all(),
            f"distances are no increasing numbers from 0, 2 to {MAX_DISTANCES}",
        )
        expect(
            _INSIDE,
            1 <= len(curves) <= MAX_CURVES and (curves >= 0).all() and (curves <= 1).all(),
            f"reach curves are not 1 to {MAX_CURVES} of numbers from 0 to 1",
        )
        expect(
            _INSIDE,
            (self.reach < len(curves)).all() and (self.bent_reach < len(curves)).all(),
            "a reach curve is named that is not there",
        )
        expect(
            _INSIDE,
            (np.diff(curves, axis=1) <= 0).all() and not curves[:, -1].any(),
            "a reach increases, or its last value is not 0",
        )

    def check_beside(self, cells: NDArray[np.uint8], depth: int, resolution: int) -> None:
        """Refuse it beside a light field that it does not fit; arguments as its members."""
        bins = (resolution // 2) ** 2
        count = len(self.cells)
        expect_arrays(_INSIDE, {"lit": (self.lit, np.uint8, (count, -(-bins // 8)))})
        expect(_INSIDE, count * bins <= MAX_BINS, f"{count} cells of {bins} bins")
        expect(_INSIDE, (self.cells < 1 << depth).all(), "a cell is outside the grid")
        known = np.isin(morton(cells), morton(self.cells)).all()
        expect(_INSIDE, known, "a cell of the light field is missing")
        padding = (1 << -bins % 8) - 1
        expect(_INSIDE, not (self.lit & padding).any(), "a bin beyond the last has an entry")

    @property
    def num_bytes(self) -> int:
        """Bytes of all arrays."""
        return sum(each.nbytes for each in vars(self).values() if isinstance(each, np.ndarray))


@dataclasses.dataclass(frozen=True, eq=False)
class LightField:
    """Radiant intensity by direction of the cells of a grid over the cube [-1, 1]³.

    A cell stands for all light whose last vertex in the luminaire is in it. Null interactions are
    no vertices: light that passed nothing else since its emitter is *straight*. Occlusion,
    refraction and scattering inside the luminaire are contained in its intensity. The light starts
    anywhere in the part of the cell that is inside the luminaire's box, with equal probability.

    Attributes:
        cells: uint8 [C, 3], coordinates of the cells that emit, 0 to 2**depth - 1; in Morton order.
        lit: uint8 [C, R² / 8], which bins of each cell emit; the first bin in the highest bit.
        intensity: uint32 [B], radiant intensity of the bins that emit, by cell and then by bin:
            RGB9_E5 numbers (`unpack`) times `scale`. Local units: radiance times local area.
        bent: uint32 [B], the part of each intensity that is not straight, likewise; in no channel
            more than `intensity`.
        depth: the grid has 2**depth cells a side, 1 to 7.
        resolution: R, a power of two from 4 to 512.
        scale: the largest intensity that occurs.
        traced: the light paths that it was estimated from; None if they are not known.
        inside: light that ends on the luminaire, for receivers inside its box. None if none does,
            as in a photometric file.
        absolute: whether a photometric file or a ray file states the intensities, so that they do
            not depend on the size of the lamp.
        outline: the luminous opening, which images show; it fills the lamp's box. None if the light
            is known by cells only.

    Raises:
        LumitreeError: a member has a wrong type, shape or range.
    """

    cells: NDArray[np.uint8]
    lit: NDArray[np.uint8]
    intensity: NDArray[np.uint32]
    bent: NDArray[np.uint32]
    depth: int
    resolution: int
    scale: float
    traced: TracedPaths | None = None
    inside: LightInside | None = None
    absolute: bool = False
    outline: Outline | None = None

    def __post_init__(self) -> None:
        """Refuse what a renderer could not use safely."""
        depth, resolution = self.depth, self.resolution
        expect_range(_FIELD, "depth", depth, int, 1, MAX_DEPTH)
        expect(
            _FIELD,
            type(resolution) is int
            and 4 <= resolution <= MAX_RESOLUTION
            and resolution & (resolution - 1) == 0,
            f"resolution {resolution!r}, expected a power of two from 4 to {MAX_RESOLUTION}",
        )
        # Arrays of a file may have no dimensions, and so no length.
        cells, bins = self.cells.shape[:1], resolution**2
        expect_arrays(
            _FIELD,
            {
                "cells": (self.cells, np.uint8, (*cells, 3)),
                "lit": (self.lit, np.uint8, (*cells, bins // 8)),
                "intensity": (self.intensity, np.uint32, (self.intensity.size,)),
                "bent": (self.bent, np.uint32, self.intensity.shape),
            },
        )
        count = len(self.cells)
        expect(_FIELD, count > 0 and count * bins <= MAX_BINS, f"{count} cells of {bins} bins")
        expect(_FIELD, (self.cells < 1 << depth).all(), "a cell is outside the grid")
        _check_bins(_FIELD, self)
        # A renderer divides by the flux of a cell.
        expect(_FIELD, self.lit.any(axis=1).all(), "a cell emits nothing")
        emits = (self.intensity & ((1 << EXPONENT_SHIFT) - 1)).all()
        expect(_FIELD, emits, "an intensity is 0")
        known = self.outline is None or self.outline in OUTLINES
        expect(_FIELD, known, f"outline {self.outline!r}, expected one of {OUTLINES}")
        if self.inside is not None:
            self.inside.check_beside(self.cells, depth, resolution)

    def __repr__(self) -> str:
        return (
            f"LightField({len(self.cells):,} cells of {self.resolution**2:,} directions, "
            f"{self.num_bytes:,} bytes)"
        )

    @property
    def has_straight_light(self) -> bool:
        """Whether some of its light is known to be straight."""
        return not np.array_equal(self.bent, self.intensity)

    @functools.cached_property
    def bent_light(self) -> "LightField":
        """The field with its bent light only."""
        bins = self.resolution**2
        bent = self.dense(self.bent)
        if not bent.any():
            # A field has light: here the least that can be stored.
            bent[0, 0] = 1
        emits = np.flatnonzero(bent.any(axis=1))
        bent, inside = bent[emits], self.inside
        if inside is not None:
            inside = dataclasses.replace(inside, intensity=inside.bent, reach=inside.bent_reach)
        found = bent[bent != 0]
        return dataclasses.replace(
            self,
            cells=self.cells[emits],
            lit=np.packbits(bent.reshape(-1, bins) != 0, axis=1),
            intensity=found,
            bent=found,
            inside=inside,
        )

    @property
    def num_bytes(self) -> int:
        """Bytes of all arrays."""
        inside = 0 if self.inside is None else self.inside.num_bytes
        arrays = self.cells, self.lit, self.intensity, self.bent
        return sum(each.nbytes for each in arrays) + inside

    def dense(self, values: NDArray[Number]) -> NDArray[Number]:
        """Values [B] of the bins that emit, by cell and bin [C, R²]; 0 in other bins."""
        return dense(self.lit, self.resolution**2, values)


def make_light_field(
    cells: NDArray[np.integer],
    intensity: NDArray[np.floating],
    depth: int,
    traced: TracedPaths | None = None,
    *,
    bent: NDArray[np.floating] | None = None,
    absolute: bool = False,
    outline: Outline | None = None,
) -> LightField:
    """A light field from the intensities of all bins.

    Args:
        cells: [C, 3] coordinates, each once, in any order; cells that emit nothing are dropped.
        intensity: [C, R², 3] radiant intensity, local units, at least 0.
        depth: of the grid.
        traced: the light paths that the intensities were estimated from, if they are known.
        bent: [C, R², 3] the part of the intensity that is not straight; default: all.
        absolute, outline: as of `LightField`.

    Raises:
        LumitreeError: nothing is emitted, or a number is out of range.
    """
    bins = intensity.shape[1]
    scale = float(intensity.max(initial=0))
    if not (np.isfinite(scale) and scale > 0):
        raise LumitreeError(f"the largest intensity is {scale}; expected light")
    if (least := float(intensity.min())) < 0:
        raise LumitreeError(f"the smallest intensity is {least}; expected 0 or more")
    packed = pack_lit(intensity, scale)
    emits = np.flatnonzero(packed.any(axis=1))
    emits = emits[np.argsort(morton(cells[emits]))]
    packed = packed[emits]
    lit = packed > 0
    words = packed[lit]
    return LightField(
        cells=cells[emits].astype(np.uint8),
        lit=np.packbits(lit, axis=1),
        intensity=words,
        bent=words if bent is None else pack_part(bent[emits][lit] / scale, words),
        depth=depth,
        resolution=int(np.sqrt(bins)),
        scale=scale,
        traced=traced,
        absolute=absolute,
        outline=outline,
    )


def _check_bins(what: str, light: LightField | LightInside) -> None:
    """Refuse cells and bins that do not fit each other."""
    expect_range(what, "scale", light.scale, float, 1e-15, 1e15)
    ordered = (np.diff(morton(light.cells)) > 0).all()
    expect(what, ordered, "cells are repeated or out of order")
    count, found = len(light.intensity), int(np.bitwise_count(light.lit).sum())
    expect(what, found == count, f"{count} intensities for {found} bins that have light")
    part = is_part(light.bent, light.intensity)
    expect(what, part, "a bent part is larger than its intensity")


def parts_of_ending(
    leaving: NDArray[np.floating], ending: NDArray[np.floating], solid_angle: NDArray[np.floating]
) -> NDArray[np.floating]:
    """J in four bins over its mean in them, so that I + J is as even as it can be.

    The light of a cell changes little within a few degrees, while surfaces cut it off sharply: it
    ends in the directions in which it does not leave.

    Args:
        leaving: [.., 4] luminance of I in the four bins.
        ending: [..] luminance of the mean of J, weighted by solid angle.
        solid_angle: [.., 4] of the bins.

    Returns:
        [.., 4] factors of J; their mean, weighted by solid angle, is 1.
    """
    order = np.argsort(leaving, axis=-1)
    i = np.take_along_axis(leaving, order, axis=-1)
    part = np.take_along_axis(np.broadcast_to(solid_angle, i.shape), order, axis=-1)
    part = part / part.sum(axis=-1, keepdims=True)
    # Filled up from the darkest bin on: the level if only the first k bins are below it.
    level = ((ending[..., None] + (part * i).cumsum(axis=-1)) / part.cumsum(axis=-1)).min(axis=-1)
    missing = np.maximum(level[..., None] - leaving, 0)
    # Over the mean of `missing` and not over J, as it is rounded.
    mean = (missing * solid_angle).sum(axis=-1) / solid_angle.sum(axis=-1)
    return np.where(mean[..., None] > 0, missing / np.where(mean > 0, mean, 1)[..., None], 1)


def dense(lit: NDArray[np.uint8], bins: int, values: NDArray[Number]) -> NDArray[Number]:
    """Values [B, ..] by cell and bin [C, N, ..]; 0 where none is stored.

    Args:
        lit: [C, ⌈N / 8⌉] which bins of each cell are stored; the first bin in the highest bit.
        bins: N.
        values: by cell and then by bin.
    """
    every = np.zeros((len(lit), bins, *values.shape[1:]), values.dtype)
    every[np.unpackbits(lit, axis=1, count=bins).view(bool)] = values
    return every


def by_coarse_bin(values: NDArray[Number]) -> NDArray[Number]:
    """Values [C, R²] of bins on the octahedral map as [C, Q², 4]: four of them are one of Q²."""
    coarse = round(values.shape[1] ** 0.5) // 2
    blocks = values.reshape(len(values), coarse, 2, coarse, 2)
    return blocks.transpose(0, 1, 3, 2, 4).reshape(len(values), coarse**2, 4)


def by_fine_bin(values: NDArray[Number]) -> NDArray[Number]:
    """The inverse of `by_coarse_bin`."""
    coarse = round(values.shape[1] ** 0.5)
    blocks = values.reshape(len(values), coarse, coarse, 2, 2)
    return blocks.transpose(0, 1, 3, 2, 4).reshape(len(values), 4 * coarse**2)


def pack_lit(intensity: NDArray[np.floating], scale: float) -> NDArray[np.uint32]:
    """Intensities [..., 3] over `scale` as RGB9_E5 numbers [...]; most may be 0."""
    packed = np.zeros(intensity.shape[:-1], np.uint32)
    lit = intensity.any(axis=-1)
    packed[lit] = pack(intensity[lit] / scale)
    return packed


def pack(colours: NDArray[np.floating]) -> NDArray[np.uint32]:
    """Colours [..., 3] from 0 to 1 as RGB9_E5 numbers [...].

    The error of a channel is at most 0.2 % of the colour's largest channel, or 2⁻⁴⁰ if that is
    more.
    """
    largest = colours.max(axis=-1)
    # Exponent e of the largest channel: it is below 2^e.
    _, exponent = np.frexp(largest)
    # Rounding must not carry the largest mantissa beyond its bits.
    carries = np.round(np.ldexp(largest, _MANTISSA_BITS - exponent)) > MANTISSA
    exponent = np.clip(exponent + carries + _EXPONENT_OFFSET - 1, 0, 2**_EXPONENT_BITS - 1)
    shift = EXPONENT_OF_ONE - exponent
    mantissa = np.round(np.ldexp(colours, shift[..., None])).astype(np.uint32)
    mantissa = np.minimum(mantissa, MANTISSA)
    packed = exponent.astype(np.uint32) << EXPONENT_SHIFT
    for channel, place in enumerate(MANTISSA_SHIFTS):
        packed |= mantissa[..., channel] << place
    return np.where(mantissa.any(axis=-1), packed, 0).astype(np.uint32)


def divided(packed: NDArray[np.uint32], divisor: float) -> NDArray[np.uint32]:
    """RGB9_E5 numbers [...] over a power of two of at least 1; 0 where they cannot be stored."""
    steps = np.uint32(int(np.log2(divisor)) << EXPONENT_SHIFT)
    return np.where(packed >= steps, packed - steps, 0).astype(np.uint32)


def pack_part(colours: NDArray[np.floating], whole: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Colours [N, 3] from 0 to 1 as RGB9_E5 numbers, in no channel above the numbers `whole`."""
    return pack(np.minimum(colours, unpack(whole)))


def is_part(part: NDArray[np.uint32], whole: NDArray[np.uint32]) -> bool:
    """Whether RGB9_E5 numbers [N] are in no channel above others."""
    differs = part != whole
    return bool((unpack(part[differs]) <= unpack(whole[differs])).all())


def unpack(packed: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Colours [..., 3] of RGB9_E5 numbers [...]."""
    exponent = (packed >> EXPONENT_SHIFT).astype(np.int64)
    mantissas = [packed >> place & MANTISSA for place in MANTISSA_SHIFTS]
    shift = exponent - EXPONENT_OF_ONE
    return np.ldexp(np.stack(mantissas, axis=-1).astype(np.float64), shift[..., None])
