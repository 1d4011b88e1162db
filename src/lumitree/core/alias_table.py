"""Alias tables (Walker 1977): an index is sampled from a discrete distribution with two loads.

Symbols
    N   entries of a row        q   N times the probability of an index
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter


class AliasTable:
    """Rows of alias tables on the device, in parts with rows of different lengths.

    An entry has two words: a threshold and the index of the alias in one; and the probability of
    its index. Thresholds are rounded up to the bits of the first word, so that no index has
    probability 0, and the probabilities follow from the rounded thresholds.

    Args:
        weights: arrays [.., N] of all rows, at least 0, with a positive sum in each row.
            Probabilities are proportional to them but for the rounding.
        parts: number of rows, and N, of each part.
    """

    def __init__(self, weights: Iterable[NDArray[np.float64]], *parts: tuple[int, int]) -> None:
        bits = int(max(count for _, count in parts) - 1).bit_length()
        steps = 1 << (32 - bits)
        sizes = [rows * count for rows, count in parts]
        words = np.empty((sum(sizes), 2), np.uint32)
        first = 0
        for weight in itertools.chain.from_iterable(weights):
            count = len(weight)
            threshold, alias = alias_row(weight)
            rounded = np.clip(np.ceil(threshold * steps), 1, steps)
            pmf = rounded / steps + np.bincount(alias, 1 - rounded / steps, count)
            row = words[first : first + count]
            row[:, 0] = (rounded.astype(np.uint64) - 1 << bits) | alias.astype(np.uint64)
            row[:, 1] = (pmf / count).astype(np.float32).view(np.uint32)
            first += count
        self._words = on_device(mi.UInt32, words)
        starts = np.cumsum([0, *sizes[:-1]])
        self._parts = on_device(
            mi.UInt32, np.stack([starts, [count for _, count in parts]], axis=1)
        )
        self._count, self._bits = parameter(mi.UInt32, parts[0][1]), parameter(mi.UInt32, bits)
        self._steps = parameter(mi.Float, float(steps))

    def sample(
        self,
        row: mi.UInt32,
        sample: mi.Float,
        active: mi.Bool | bool = True,
        part: mi.UInt32 | None = None,
    ) -> tuple[mi.UInt32, mi.Float]:
        """Index for a sample in [0, 1), and its probability; by default in the first part."""
        first, count = self._row(row, part)
        scaled = sample * mi.Float(count)
        entry = dr.minimum(mi.UInt32(scaled), count - 1)
        word = dr.gather(mi.UInt32, self._words, 2 * (first + entry), active)
        step = mi.UInt32((scaled - mi.Float(entry)) * self._steps)
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
        first, _ = self._row(row, part)
        word = dr.gather(mi.UInt32, self._words, 2 * (first + index) + 1, active)
        return dr.reinterpret_array(mi.Float, word)

    def _row(self, row, part):
        """First entry of a row, and N."""
        if part is None:
            return row * self._count, self._count
        found = dr.gather(mi.Vector2u, self._parts, part)
        return found.x + row * found.y, found.y


def alias_row(weights: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Thresholds [N] in [0, 1] and aliases [N] of one distribution.

    Entry i stands for i with probability threshold[i], else for alias[i]. Entries with q < 1 are
    filled by entries with q >= 1, both in order. So which one fills which follows from cumulated
    sums of 1 - q and of q - 1.
    """
    q = weights * (len(weights) / weights.sum())
    light, heavy = np.flatnonzero(q < 1), np.flatnonzero(q >= 1)
    threshold, alias = np.minimum(q, 1), np.arange(len(q))
    if not (len(light) and len(heavy)):
        # Equal weights, perhaps but for rounding.
        return np.ones_like(q), alias
    lacking, spare = np.cumsum(1 - q[light]), np.cumsum(q[heavy] - 1)
    last = len(heavy) - 1
    # The first heavy entry that has something to spare when a light one's turn comes.
    before = np.concatenate([[0], lacking[:-1]])
    alias[light] = heavy[np.minimum(np.searchsorted(spare, before), last)]
    # A heavy entry fills light ones until it has not enough; the next heavy one fills that one.
    ended = np.searchsorted(lacking, spare, side="right")
    exhausted = (ended < len(light)) & (np.arange(len(heavy)) < last)
    which = np.flatnonzero(exhausted)
    threshold[heavy[which]] = np.clip(1 + spare[which] - lacking[ended[which]], 0, 1)
    alias[heavy[which]] = heavy[which + 1]
    return threshold, alias
