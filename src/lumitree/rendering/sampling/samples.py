"""Use of random samples in more than one place, tables of cumulated chances, and weights of MIS."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def divide_sample(sample: mi.Float, fraction: mi.Float | float) -> tuple[mi.Bool, mi.Float]:
    """Whether a sample in [0, 1) is below `fraction`, and a sample in [0, 1) for either case."""
    below = sample < fraction
    rest = dr.select(below, sample / fraction, (sample - fraction) / (1 - fraction))
    return below, dr.clip(rest, 0, dr.one_minus_epsilon(mi.Float))


def scrambled(sample: mi.Point2f) -> mi.Point3f:
    """Three numbers in [0, 1) from all bits of a sample in the unit square."""
    x, y = (dr.reinterpret_array(mi.UInt32, each) for each in (sample.x, sample.y))
    u, v = mi.sample_tea_32(x, y)
    w, _ = mi.sample_tea_32(v, u)
    return mi.Point3f(mi.Float(u >> 8), mi.Float(v >> 8), mi.Float(w >> 8)) * 2.0**-24


def resample(choice: mi.Float, light: mi.Float, total: mi.Float) -> tuple[mi.Bool, mi.Float]:
    """Whether a candidate of resampled importance sampling takes the place of those before.

    Args:
        choice: number in [0, 1).
        light: weight of the candidate.
        total: of it and of those before.

    Returns:
        With it a new number in [0, 1).
    """
    return divide_sample(choice, dr.select(total > 0, light / total, 0))


def sample_row(
    cumulated: mi.Float, first: mi.UInt32, count: int, sample: mi.Float, active: mi.Bool | bool
) -> mi.UInt32:
    """Index, from 0, that a sample in [0, 1) has in one row of a table of cumulated chances."""

    # The search is over the next power of two, so that rows of similar lengths share a kernel.
    length, bound = dr.opaque(mi.UInt32, count), 1 << (count - 1).bit_length()

    def below(index):
        inside = active & (index < length)
        return inside & (dr.gather(mi.Float, cumulated, first + index, inside) <= sample)

    return dr.minimum(dr.binary_search(0, bound - 1, below), length - 1)


def mis_weight(pdf: mi.Float, other_pdf: mi.Float) -> mi.Float:
    """Power heuristic; 0 where neither density is positive, as in `path`."""
    weight = dr.square(pdf) / (dr.square(pdf) + dr.square(other_pdf))
    return dr.select(dr.isfinite(weight), weight, 0)
