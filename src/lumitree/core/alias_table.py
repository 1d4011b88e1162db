"""Alias tables (Walker 1977): an index is sampled from a discrete distribution with two loads.

Symbols
    N   entries of a row        q   N times the probability of an index
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

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
        weights: arrays [M, N] of all rows, M each, at least 0, with a positive sum in each row.
            Probabilities are proportional to them but for the rounding.
        parts: number of rows, and N, of each part.
    """

    def __init__(self, weights: Iterable[NDArray[np.float64]], *parts: tuple[int, int]) -> None:
        bits = int(max(count for _, count in parts) - 1).bit_length()
        steps = 1 << (32 - bits)
        sizes = [rows * count for rows, count in parts]
        words = np.empty((sum(sizes), 2), np.uint32)
        first = 0
        for each in weights:
            block = _words(each, bits)
            words[first : first + len(block)] = block
            first += len(block)
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
        word = dr.gather(mi.UInt32, self._words, 2 * (first + _place(entry, count)), active)
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


def _words(weights: NDArray[np.float64], bits: int) -> NDArray[np.uint32]:
    """Both words [M × N, 2] of the entries of rows [M, N], each row in the order of `_place`."""
    (rows, count), steps = weights.shape, 1 << (32 - bits)
    threshold, alias = alias_rows(weights)
    rounded = np.clip(np.ceil(threshold * steps), 1, steps)
    places = (count * np.arange(rows)[:, None] + alias).ravel()
    others = np.bincount(places, (1 - rounded / steps).ravel(), weights.size)
    pmf = (rounded / steps).ravel() + others
    word = (rounded.astype(np.uint64) - 1 << bits) | alias.astype(np.uint64)
    probability = (pmf / count).astype(np.float32).view(np.uint32)
    words = np.stack([word.astype(np.uint32), probability.reshape(rows, count)], axis=2)
    order = np.arange(count)
    order[: count // 4 * 4] = order[: count // 4 * 4].reshape(4, -1).T.ravel()
    return words[:, order].reshape(-1, 2)


def alias_rows(weights: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Thresholds [M, N] in [0, 1] and aliases [M, N] of distributions, one a row.

    Entry i of a row stands for i with probability threshold[i], else for alias[i]. Entries with
    q < 1 are filled by entries with q >= 1, both in order. So which one fills which follows from
    cumulated sums of 1 - q and of q - 1.
    """
    size = weights.shape[1]
    q = weights * (size / weights.sum(axis=1, keepdims=True))
    heavy = q >= 1
    lacking = np.cumsum(np.where(heavy, 0, 1 - q), axis=1)
    spare = np.cumsum(np.where(heavy, q - 1, 0), axis=1)
    # Light and heavy entries in order, and how many are among the first entries of a row.
    lights, heavies = (np.argsort(each, axis=1, kind="stable") for each in (heavy, ~heavy))
    num_light, num_heavy = (np.cumsum(_behind_0(each), axis=1) for each in (~heavy, heavy))
    last = num_heavy[:, -1:] - 1
    # The first heavy entry that has something to spare when a light one's turn comes.
    before = _behind_0(lacking)[:, :-1]
    below, _ = _merged(before, spare)
    filler = np.minimum(np.take_along_axis(num_heavy, below, axis=1), last)
    # A heavy entry fills light ones until it has not enough; the next heavy one fills that one.
    ended = np.take_along_axis(num_light, _merged(lacking, spare)[1], axis=1)
    number = num_heavy[:, 1:]
    exhausted = heavy & (ended < num_light[:, -1:]) & (number <= last)
    ends = np.take_along_axis(lights, np.minimum(ended, size - 1), axis=1)
    left = np.clip(1 + spare - np.take_along_axis(lacking, ends, axis=1), 0, 1)
    threshold = np.where(exhausted, left, np.minimum(q, 1))
    following = np.where(heavy, np.minimum(number, size - 1), filler)
    alias = np.take_along_axis(heavies, following, axis=1)
    alias = np.where(exhausted | ~heavy, alias, np.arange(size))
    # Equal weights, perhaps but for rounding.
    equal = (last < 0) | (num_light[:, -1:] == 0)
    return np.where(equal, 1.0, threshold), np.where(equal, np.arange(size), alias)


def _behind_0(rows: NDArray[Any]) -> NDArray[Any]:
    """Rows that begin with another entry of 0."""
    return np.pad(rows, ((0, 0), (1, 0)))


def _merged(
    first: NDArray[np.float64], second: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """How many entries of the other row are before each, for rows [M, N] in increasing order.

    The first row's entries are before equal ones of the second.
    """
    size = first.shape[1]
    order = np.argsort(np.concatenate([first, second], axis=1), axis=1, kind="stable")
    place = np.empty_like(order)
    np.put_along_axis(place, order, np.broadcast_to(np.arange(2 * size), order.shape), axis=1)
    return place[:, :size] - np.arange(size), place[:, size:] - np.arange(size)
