"""Alias tables (Walker 1977): an index is sampled from a discrete distribution with two loads.

Symbols
    N   entries of a row        q   N times the probability of an index
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter


class AliasTable:
    """Rows of alias tables on the device, in parts with rows of different lengths.

    An entry has two words: a threshold and the index of the alias in one; and the probability of
    its index. Thresholds are rounded up to the bits of the first word, so that no index has
    probability 0, and the probabilities follow from the rounded thresholds. Entries a quarter of
    a row apart are stored side by side: samples at equal steps, as of a `Reservoir`, are near.

    Args:
        weights: mi.Float of all rows, at least 0, with a positive sum in each row. Probabilities
            are proportional to them but for the rounding.
        parts: number of rows, and N, of each part.
    """

    def __init__(self, weights: mi.Float, *parts: tuple[int, int]) -> None:
        rows, counts = np.array(parts, np.int64).T
        bits = int(counts.max() - 1).bit_length()
        starts = np.cumsum([0, *rows * counts])
        self._parts = on_device(mi.UInt32, np.stack([starts[:-1], counts], axis=1))
        self._count, self._bits = parameter(mi.UInt32, parts[0][1]), parameter(mi.UInt32, bits)
        self._steps = parameter(mi.Float, 2.0 ** (32 - bits))
        self._words = dr.zeros(mi.UInt32, 2 * int(starts[-1]))
        part = np.repeat(np.arange(len(parts)), rows)
        row = np.arange(len(part)) - (np.cumsum(rows) - rows)[part]
        first, count = (
            on_device(mi.UInt32, each) for each in (starts[part] + row * counts[part], counts[part])
        )
        self._fill(weights, first, count)

    @classmethod
    def of(cls, *parts: NDArray[np.float64]) -> AliasTable:
        """A table of arrays [M, N], whose rows are brought into the range of single precision."""
        scaled = [(each / each.max(axis=1, keepdims=True)).ravel() for each in parts]
        weights = on_device(mi.Float, np.concatenate(scaled))
        return cls(weights, *(each.shape for each in parts))

    @dr.syntax
    def _fill(self, weights: mi.Float, first: mi.UInt32, count: mi.UInt32) -> None:
        """Write rows, whose entries are `count` from `first` on: each is one lane.

        Entries with q < 1 are filled by entries with q >= 1, both in order. An entry that has not
        enough to fill the next one is itself filled by the next one of its kind.
        """
        words, bits, steps = self._words, self._bits, mi.Float64(self._steps)

        def write(index, threshold, alias, share, active):
            place = 2 * (first + _place(index, count))
            word = (mi.UInt32(threshold * steps - 1) << bits) | alias
            share = dr.reinterpret_array(mi.UInt32, mi.Float(share / count))
            dr.scatter(words, word, place, active)
            dr.scatter(words, share, place + 1, active)

        whole, nobody = mi.Float64(1), mi.UInt32(0)
        entry, total = mi.UInt32(0), mi.Float64(0)
        while dr.hint(entry < count, exclude=[words]):
            total += mi.Float64(dr.gather(mi.Float, weights, first + entry))
            write(entry, whole, nobody, whole, mi.Bool(True))
            entry += 1
        scale = mi.Float64(count) / total
        # The next entry to fill, the one that fills, whether it is known to be of that kind, q - 1
        # less all that it has filled, and the threshold and the share of the entry before it.
        small, large, known, spare = mi.UInt32(0), mi.UInt32(0), mi.Bool(False), mi.Float64(0)
        before, left, got = mi.UInt32(count), mi.Float64(1), mi.Float64(0)
        while dr.hint(((small < count) | (spare < 0)) & (large < count), exclude=[words]):
            small_q, large_q = (
                scale * mi.Float64(dr.gather(mi.Float, weights, first + each, each < count))
                for each in (small, large)
            )
            found, spent = ~known & (large_q >= 1), known & (spare < 0)
            turn = known & ~spent & (small < count)
            fills = turn & (small_q < 1)
            threshold = dr.select(found, left, dr.select(fills, small_q, 1))
            threshold = dr.clip(-dr.floor(-threshold * steps), 1, steps) / steps
            share = threshold + dr.select(fills, 0, got)
            at = dr.select(found, before, dr.select(fills, small, large))
            write(at, threshold, large, share, fills | spent | (found & (before < count)))
            filled = dr.select(found | fills, 1 - threshold, 0)
            got = filled + dr.select(found, 0, got)
            spare += dr.select(found, large_q - 1, dr.select(fills, small_q - 1, 0))
            left = dr.select(spent, 1 + spare, left)
            before = dr.select(spent, large, before)
            small += dr.select(turn, mi.UInt32(1), 0)
            large += dr.select(spent | ~(known | found), mi.UInt32(1), 0)
            known = (known | found) & ~spent
        write(large, whole, nobody, 1 + got, known & (large < count))
        dr.eval(words)

    def sample(
        self,
        row: mi.UInt32,
        sample: mi.Float,
        active: mi.Bool | bool = True,
        part: mi.UInt32 | None = None,
        other: mi.Float | None = None,
    ) -> tuple[mi.UInt32, mi.Float]:
        """Index for a sample in [0, 1), and its probability; by default in the first part.

        `other`: sample by which an entry or its alias is taken, for rows so long that the 24 bits
        of one are too few.
        """
        first, count = self._row(row, part)
        scaled = sample * mi.Float(count)
        entry = dr.minimum(mi.UInt32(scaled), count - 1)
        word = dr.gather(mi.UInt32, self._words, 2 * (first + _place(entry, count)), active)
        step = mi.UInt32((scaled - mi.Float(entry) if other is None else other) * self._steps)
        alias = word & ((mi.UInt32(1) << self._bits) - 1)
        index = dr.select(step <= word >> self._bits, entry, alias)
        return index, self.probability(row, index, active, part)

    def probability(
        self,
        row: mi.UInt32,
        index: mi.UInt32,
        active: mi.Bool | bool = True,
        part: mi.UInt32 | None = None,
    ) -> mi.Float:
        """Probability with which `sample` returns an index; 0 where not active."""
        first, count = self._row(row, part)
        word = dr.gather(mi.UInt32, self._words, 2 * (first + _place(index, count)) + 1, active)
        return dr.reinterpret_array(mi.Float, word)

    def _row(self, row, part):
        """First entry of a row, and N."""
        if part is None:
            return row * self._count, self._count
        found = dr.gather(mi.Vector2u, self._parts, part)
        return found.x + row * found.y, found.y


def _place(index: mi.UInt32, count: mi.UInt32) -> mi.UInt32:
    """Place of an entry in its row of N = `count`; the last N modulo 4 entries keep theirs."""
    length = count >> 2
    quarter = dr.select(index >= 2 * length, mi.UInt32(2), 0)
    quarter += dr.select(index >= (quarter + 1) * length, mi.UInt32(1), 0)
    return dr.select(index < 4 * length, 4 * (index - quarter * length) + quarter, index)
