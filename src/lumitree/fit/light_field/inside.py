"""The light inside a luminaire's box from its bake, see `lumitree.asset.light_inside`.

Symbols
    C, Q, E, K, I, J, s, V, κ   as there        R   bins a side of the light field, 2 Q
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import LightField, pack_lit, unpack
from lumitree.asset.light_inside import MAX_CURVES, MAX_FACTOR, LightInside
from lumitree.asset.lit_bins import by_coarse_bin
from lumitree.core.octahedral import coarse_solid_angles, solid_angles
from lumitree.core.photometry import luminance
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.light_field.codebook import codebook
from lumitree.octree.build import morton
from lumitree.trace.histograms import cell_codes, coded_cells

# Distances of curves, local units: denser near, where most light ends. No way in the box is longer
# than the last, twice the diagonal of half the cube.
DISTANCES = np.hstack(
    [
        np.arange(0, 0.6, 0.05),
        np.arange(0.6, 1.2, 0.1),
        np.arange(1.2, 2, 0.2),
        (2, 2.4, 2.9, 3.5),
    ]
).astype(np.float32)


# κ is constant beyond the last distance at which at least this part of the light is unoccluded.
# Farther, a ratio of what is left would be noise.
_LEAST = 0.05


@dataclasses.dataclass(frozen=True)
class Entries:
    """Bins of cells in which there is light, before their curves are put into codebooks.

    Attributes:
        depth, resolution: of the light field.
        cells: [C, 3] coordinates, in Morton order.
        lit: [C, Q²] bins that are entries.
        rows, bins: [E] row in `cells` and bin of each entry.
        exits: float32 [C, R²] luminance of I.
        intensity: uint32 [E] J over `scale`, RGB9_E5.
        scale: unit of J.
        beyond: float32 [E, K] luminous flux of J that gets farther than each distance.
    """

    depth: int
    resolution: int
    cells: NDArray[np.integer]
    lit: NDArray[np.bool_]
    rows: NDArray[np.integer]
    bins: NDArray[np.integer]
    exits: NDArray[np.float32]
    intensity: NDArray[np.uint32]
    scale: float
    beyond: NDArray[np.float32]

    @property
    def everything(self) -> NDArray[np.float32]:
        """Luminous flux [E, K] of I + J s by entry and distance."""
        solid_angle = solid_angles(self.resolution).astype(np.float32)
        leaving = by_coarse_bin(self.exits * solid_angle).sum(axis=2)
        return leaving[self.lit][:, None] + self.beyond

    def _reach(self, seed: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Curve of each entry, and the curves of s; `seed` is the root seed."""
        rows = np.zeros(len(self.bins), np.uint8)
        ends = np.flatnonzero(self.beyond[:, 0])
        if not len(ends):
            return rows, np.eye(1, len(DISTANCES), dtype=np.float32)
        beyond = self.beyond[ends]
        total = np.repeat(beyond[:, :1], len(DISTANCES), axis=1)
        stream = SeedStream(Purpose.ENDING, 0, 1)
        rows[ends], curves = codebook(beyond, total, MAX_CURVES, 1.0, stream.seed(seed))
        # Sums are rounded.
        return rows, np.minimum.accumulate(curves, axis=1)

    def encoded(
        self, unoccluded: NDArray[np.float32], independent: NDArray[np.float32], seed: int
    ) -> LightInside:
        """The light inside the box.

        Args:
            unoccluded: luminous flux [E, K] of (I + J) V by entry and distance.
            independent: another estimate of it, see `codebook`.
            seed: root seed.
        """
        reach, reach_curves = self._reach(seed)
        stream = SeedStream(Purpose.VISIBILITY, 0, 1)
        valid = unoccluded >= _LEAST * unoccluded[:, :1]
        visibility, visibility_curves = codebook(
            _held(self.everything, valid),
            _held(unoccluded, valid),
            MAX_CURVES,
            MAX_FACTOR,
            stream.seed(seed),
            independent=_held(independent, valid),
        )
        return LightInside(
            cells=self.cells.astype(np.uint8),
            lit=np.packbits(self.lit, axis=1),
            intensity=self.intensity,
            reach=reach,
            visibility=visibility,
            distances=DISTANCES,
            reach_curves=reach_curves,
            visibility_curves=visibility_curves,
            scale=self.scale,
        )


def make_entries(
    field: LightField,
    cells: NDArray[np.integer],
    flux: NDArray[np.floating],
    by_reach: NDArray[np.floating],
) -> Entries:
    """Entries of a light field and of light that ends on the luminaire.

    Memory: by entry 4 arrays of `DISTANCES`, here and in `encoded`; 0.4 GB for a million.

    Args:
        cells: [C', 3] cells that have light that ends, each once, in any order.
        flux: [C', Q², 3] its flux.
        by_reach: [C', Q², K - 1] luminous flux of what ends between two distances.
    """
    intensity = flux / coarse_solid_angles(field.resolution)[:, None]
    scale = float(intensity.max(initial=0))
    scale = scale if scale > 0 else 1.0
    packed = pack_lit(intensity, scale)
    light_field_code, ending_code = (cell_codes(each, field.depth) for each in (field.cells, cells))
    codes = np.union1d(light_field_code, ending_code[packed.any(axis=1)])
    every = coded_cells(codes, field.depth)
    order = np.argsort(morton(every))
    codes, every = codes[order], every[order]

    exits = np.zeros((len(codes), field.resolution**2), np.float32)
    luminous = field.dense(luminance(field.scale * unpack(field.intensity)))
    exits[_rows_of(codes, light_field_code)] = luminous
    # Row of each cell in `cells`, or -1.
    source = _rows_of(ending_code, codes)
    ends = np.where(source[:, None] >= 0, packed[source] if len(packed) else 0, 0)
    lit = (ends > 0) | by_coarse_bin(exits > 0).any(axis=2)
    rows, bins = np.nonzero(lit)
    beyond = np.zeros((len(bins), len(DISTANCES)), np.float32)
    ending = np.flatnonzero(ends[lit])
    of_ending = by_reach[source[rows[ending]], bins[ending]]
    beyond[ending, :-1] = of_ending[:, ::-1].cumsum(axis=1)[:, ::-1]
    return Entries(
        depth=field.depth,
        resolution=field.resolution,
        cells=every,
        lit=lit,
        rows=rows,
        bins=bins,
        exits=exits,
        intensity=ends[lit].astype(np.uint32),
        scale=scale,
        beyond=beyond,
    )


def _held(values: NDArray[np.float32], valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Values [E, K] as far as they are valid, and then the last of these."""
    last = np.maximum(np.count_nonzero(valid, axis=1) - 1, 0)
    return np.where(valid, values, values[np.arange(len(values)), last, None])


def _rows_of(codes: NDArray[np.integer], wanted: NDArray[np.integer]) -> NDArray[np.int64]:
    """Row of each of some cells in `codes`, or -1."""
    if not len(codes):
        return np.full(len(wanted), -1)
    order = np.argsort(codes)
    at = np.minimum(np.searchsorted(codes, wanted, sorter=order), len(codes) - 1)
    return np.where(codes[order[at]] == wanted, order[at], -1)
