"""The light field of a luminaire: what it sends to receivers outside its box.

With `lumitree.asset.light_inside` it also lights receivers inside.

Symbols
    C   cells           R   bins of direction a side, see `core.octahedral`
    B   bins of all cells in which anything is emitted
"""

import dataclasses
import functools
import math

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.checks import expect, expect_arrays
from lumitree.asset.light_inside import LightInside
from lumitree.asset.lit_bins import Number, dense
from lumitree.asset.packed_colours import EXPONENT_SHIFT, is_part, pack_lit, pack_part
from lumitree.core.seeds import MAX_SEED
from lumitree.errors import LumitreeError, shown
from lumitree.octree.build import morton

_WHAT = "light field"
_expect = functools.partial(expect, _WHAT)
# A cell is named by 10 bits a coordinate, and a device array of all bins holds at most 2³¹.
MAX_DEPTH, MAX_RESOLUTION = 7, 512
MAX_BINS = 1 << 28
# Limits of `TracedPaths`.
MAX_PATHS, MAX_SEEDS = 1 << 50, 1 << 12


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
        what, seeds = functools.partial(expect, "record of light paths"), self.seeds
        what(
            type(self.count) is int and 1 <= self.count <= MAX_PATHS,
            f"count {self.count!r}, expected 1 to 2^50",
        )
        what(
            type(seeds) is tuple
            and 1 <= len(seeds) <= MAX_SEEDS
            and all(type(seed) is int and 0 <= seed <= MAX_SEED for seed in seeds)
            and list(seeds) == sorted(set(seeds)),
            f"seeds {shown(seeds, 60)}, expected 1 to {MAX_SEEDS} increasing integers from 0 to "
            f"{MAX_SEED}",
        )
        digits = self.luminaire
        what(
            type(digits) is str and len(digits) == 64 and set(digits) <= set("0123456789abcdef"),
            f"luminaire {shown(digits, 80)}, expected 64 hexadecimal digits",
        )
        noise = self.noise
        what(
            noise is None or (type(noise) is float and noise >= 0 and math.isfinite(noise)),
            f"noise {noise!r}, expected a number of at least 0",
        )


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

    def __post_init__(self) -> None:
        """Refuse what a renderer could not use safely."""
        _check_scalars(self)
        # An array of a file may have no dimensions, and so no length.
        first = self.cells.shape[:1]
        bins = self.resolution**2
        expect_arrays(
            _WHAT,
            {
                "cells": (self.cells, np.uint8, (*first, 3)),
                "lit": (self.lit, np.uint8, (*first, bins // 8)),
                "intensity": (self.intensity, np.uint32, (self.intensity.size,)),
                "bent": (self.bent, np.uint32, self.intensity.shape),
            },
        )
        count = len(self.cells)
        _expect(count > 0 and count * bins <= MAX_BINS, f"{count} cells of {bins} bins")
        _expect((self.cells < 1 << self.depth).all(), "a cell is outside the grid")
        _expect((np.diff(morton(self.cells)) > 0).all(), "cells are repeated or out of order")
        found = int(np.bitwise_count(self.lit).sum())
        _expect(
            found == len(self.intensity),
            f"{len(self.intensity)} intensities for {found} bins that emit",
        )
        # A renderer divides by the flux of a cell.
        _expect(self.lit.any(axis=1).all(), "a cell emits nothing")
        _expect((self.intensity & ((1 << EXPONENT_SHIFT) - 1)).all(), "an intensity is 0")
        _expect(is_part(self.bent, self.intensity), "a bent part is larger than its intensity")
        if self.inside is not None:
            self.inside.check_beside(self.cells, self.depth, self.resolution)

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
        """The field of its bent light alone, which is all of this field's light."""
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
) -> LightField:
    """A light field from the intensities of all bins.

    Args:
        cells: [C, 3] coordinates, each once, in any order; those that emit nothing are left out.
        intensity: [C, R², 3] radiant intensity, local units, at least 0.
        depth: of the grid.
        traced: the light paths that the intensities were estimated from, if they are known.
        bent: [C, R², 3] the part of the intensity that is not straight; default: all.
        absolute: as of `LightField`.

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
    )


def _check_scalars(field: LightField) -> None:
    depth, resolution = field.depth, field.resolution
    _expect(
        type(depth) is int and 1 <= depth <= MAX_DEPTH,
        f"depth {depth!r}, expected 1 to {MAX_DEPTH}",
    )
    _expect(
        type(resolution) is int
        and 4 <= resolution <= MAX_RESOLUTION
        and resolution & (resolution - 1) == 0,
        f"resolution {resolution!r}, expected a power of two from 4 to {MAX_RESOLUTION}",
    )
    _expect(
        type(field.scale) is float and 1e-15 <= field.scale <= 1e15,
        f"scale {field.scale!r}, expected 1e-15 to 1e15",
    )
