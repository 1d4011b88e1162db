"""Light inside the box of a luminaire: what its light field lacks for receivers there.

Light that leaves a cell and ends on the luminaire itself never gets out of the box, but it lights
what stands in its way. How much of it gets as far as a distance r is its reach.

Symbols
    C   cells           Q   bins of direction a side, half as many as the light field's
    E   entries: bins of all cells in which there is any light         K   distances
    I   radiant intensity of a cell that leaves the box, from the light field
    J   radiant intensity of a cell that ends on the luminaire
    s   reach: part of J that gets farther than r

A receiver at distance r from a point of a cell gets I + J s. The parts of I and J that are not
straight (`lumitree.asset.light_field`) are stored beside them, with a reach of their own.
"""

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.checks import expect, expect_arrays
from lumitree.asset.packed_colours import is_part
from lumitree.octree.build import morton

_expect = functools.partial(expect, "light inside the box")
# An entry names a curve by 8 bits.
MAX_CURVES, MAX_DISTANCES = 256, 64
MAX_ENTRIES = 1 << 28


@dataclasses.dataclass(frozen=True, eq=False)
class LightInside:
    """Light that ends on a luminaire, by cell, direction and distance.

    Curves are linear between the distances, and constant beyond the last.

    Attributes:
        cells: uint8 [C, 3], coordinates of the cells that light leaves, in Morton order: those of
            the light field, and others whose light all ends on the luminaire.
        lit: uint8 [C, ⌈Q² / 8⌉], which bins of each cell have an entry; the first bin in the
            highest bit.
        intensity: uint32 [E], J by cell and then by bin: RGB9_E5 numbers
            (`packed_colours.unpack`) times `scale`. Local units, as those of the light field.
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
        entries, first = self.intensity.shape, self.cells.shape[:1]
        bins = self.lit.shape[1:]
        distances = self.distances.shape
        expect_arrays(
            "light inside the box",
            {
                "cells": (self.cells, np.uint8, (*first, 3)),
                "lit": (self.lit, np.uint8, (*first, *bins)),
                "intensity": (self.intensity, np.uint32, (self.intensity.size,)),
                "bent": (self.bent, np.uint32, entries),
                "reach": (self.reach, np.uint8, entries),
                "bent_reach": (self.bent_reach, np.uint8, entries),
                "distances": (self.distances, np.float32, (self.distances.size,)),
                "reach_curves": (
                    self.reach_curves,
                    np.float32,
                    (*self.reach_curves.shape[:1], *distances),
                ),
            },
        )
        _expect(
            type(self.scale) is float and 1e-15 <= self.scale <= 1e15,
            f"scale {self.scale!r}, expected 1e-15 to 1e15",
        )
        _expect((np.diff(morton(self.cells)) > 0).all(), "cells are repeated or out of order")
        found = int(np.bitwise_count(self.lit).sum())
        _expect(found == entries[0], f"{entries[0]} intensities for {found} bins that have light")
        _expect(is_part(self.bent, self.intensity), "a bent part is larger than its intensity")
        steps = self.distances
        _expect(
            2 <= len(steps) <= MAX_DISTANCES
            and np.isfinite(steps).all()
            and steps[0] == 0
            and (np.diff(steps) > 0).all(),
            f"distances are no increasing numbers from 0, 2 to {MAX_DISTANCES}",
        )
        curves = self.reach_curves
        _expect(
            1 <= len(curves) <= MAX_CURVES and (curves >= 0).all() and (curves <= 1).all(),
            f"reach curves are not 1 to {MAX_CURVES} of numbers from 0 to 1",
        )
        _expect(
            (self.reach < len(curves)).all() and (self.bent_reach < len(curves)).all(),
            "a reach curve is named that is not there",
        )
        _expect(
            (np.diff(curves, axis=1) <= 0).all() and not curves[:, -1].any(),
            "a reach increases, or does not end at 0",
        )

    def check_beside(self, cells: NDArray[np.uint8], depth: int, resolution: int) -> None:
        """Refuse it beside a light field that it does not fit; arguments as its members."""
        bins = (resolution // 2) ** 2
        expect_arrays(
            "light inside the box", {"lit": (self.lit, np.uint8, (len(self.cells), -(-bins // 8)))}
        )
        _expect(len(self.cells) * bins <= MAX_ENTRIES, f"{len(self.cells)} cells of {bins} bins")
        _expect((self.cells < 1 << depth).all(), "a cell is outside the grid")
        own, codes = morton(self.cells), morton(cells)
        rows = np.minimum(np.searchsorted(own, codes), max(len(own) - 1, 0))
        _expect(
            len(own) >= len(codes) and (own[rows] == codes).all(),
            "a cell of the light field is missing",
        )
        if padding := -bins % 8:
            _expect(
                not (self.lit & ((1 << padding) - 1)).any(), "a bin beyond the last has an entry"
            )

    @property
    def num_bytes(self) -> int:
        """Bytes of all arrays."""
        fields = (getattr(self, field.name) for field in dataclasses.fields(self))
        return sum(value.nbytes for value in fields if isinstance(value, np.ndarray))


def parts_of_ending(
    leaving: NDArray[np.floating], ending: NDArray[np.floating], solid_angle: NDArray[np.floating]
) -> NDArray[np.floating]:
    """J in four bins over its mean in them, so that I + J is as even as it can be.

    What a cell emits changes little within a few degrees, while surfaces cut light off sharply: it
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
    # Over its own mean and not over J, as it is rounded.
    mean = (missing * solid_angle).sum(axis=-1) / solid_angle.sum(axis=-1)
    return np.where(mean[..., None] > 0, missing / np.where(mean > 0, mean, 1)[..., None], 1)
