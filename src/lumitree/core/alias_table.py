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
    """Rows of alias tables on the device.

    An entry has two words: a threshold and the index of the alias in one; and the probability of
    its own index. Thresholds are rounded up to what the first word has room for, so that no index
    has probability 0, and the probabilities follow from the rounded thresholds.

    Args:
        weights: arrays [.., N] of all rows, at least 0, with a positive sum in each row.
            Probabilities are proportional to them but for the rounding.
        rows, count: number of rows, and N.
    """

    def __init__(self, weights: Iterable[NDArray[np.float64]], rows: int, count: int) -> None:
        bits = int(count - 1).bit_length()
        steps = 1 << (32 - bits)
        words = np.empty((rows, count, 2), np.uint32)
        for row, weight in enumerate(itertools.chain.from_iterable(weights)):
            threshold, alias = alias_row(weight)
            rounded = np.clip(np.ceil(threshold * steps), 1, steps)
            chance = rounded / steps + np.bincount(alias, 1 - rounded / steps, count)
            first = (rounded.astype(np.uint64) - 1 << bits) | alias.astype(np.uint64)
            words[row, :, 0] = first
            words[row, :, 1] = (chance / count).astype(np.float32).view(np.uint32)
        self._words = on_device(mi.UInt32, words)
        self._count, self._bits = parameter(mi.UInt32, count), parameter(mi.UInt32, bits)
        self._steps = parameter(mi.Float, float(steps))

    def sample(
        self, row: mi.UInt32, sample: mi.Float, active: mi.Bool | bool = True
    ) -> tuple[mi.UInt32, mi.Float]:
        """Index for a sample in [0, 1), and its probability."""
        scaled = sample * mi.Float(self._count)
        entry = dr.minimum(mi.UInt32(scaled), self._count - 1)
        word = dr.gather(mi.UInt32, self._words, self._place(row, entry), active)
        step = mi.UInt32((scaled - mi.Float(entry)) * self._steps)
        alias = word & ((mi.UInt32(1) << self._bits) - 1)
        index = dr.select(step <= word >> self._bits, entry, alias)
        return index, self.probability(row, index, active)

    def probability(
        self, row: mi.UInt32, index: mi.UInt32, active: mi.Bool | bool = True
    ) -> mi.Float:
        """Probability with which `sample` returns an index; 0 where not active."""
        word = dr.gather(mi.UInt32, self._words, self._place(row, index) + 1, active)
        return dr.reinterpret_array(mi.Float, word)

    def _place(self, row, entry):
        return 2 * (row * self._count + entry)


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
    # A heavy entry ends with the light one for which it has not enough; the next one fills it.
    ended = np.searchsorted(lacking, spare, side="right")
    ends = (ended < len(light)) & (np.arange(len(heavy)) < last)
    which = np.flatnonzero(ends)
    threshold[heavy[which]] = np.clip(1 + spare[which] - lacking[ended[which]], 0, 1)
    alias[heavy[which]] = heavy[which + 1]
    return threshold, alias
