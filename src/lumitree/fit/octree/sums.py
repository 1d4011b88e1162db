"""Sums of many rays' contributions that are the same whatever the order of addition.

Threads add to one array in an order that differs from run to run, and floating-point sums depend
on it. Here every value is rounded to a multiple of a power of two, and the multiples are added as
64-bit integers, which is exact. So equal seeds give equal bytes, with any number of threads.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

from lumitree.core.device import parameter
from lumitree.errors import LumitreeError

# Sums stay below 2^62: bounds are themselves rounded.
_BITS = 62
# Largest power of two of a scale; the limit of single precision is 2^127.
_MAX_EXPONENT = 126


class ExactSum:
    """An array of sums on the device, in multiples of about 2^-62 of a bound.

    The bound is at least the sum of the absolute values of all that will be added, and finite.
    """

    def __init__(self, size: int, bound: float) -> None:
        if not math.isfinite(bound):
            raise LumitreeError(
                "a ray's radiance or transmittance is NaN or infinity; look for materials or "
                "emitters with invalid values"
            )
        exponent = _BITS - math.frexp(bound)[1] if bound > 0 else 0
        self._scale = math.ldexp(1, min(exponent, _MAX_EXPONENT))
        # Opaque, or every other scale would compile other kernels.
        self._multiplier = parameter(mi.Float, self._scale)
        self._total = dr.zeros(mi.Int64, size)

    def add(
        self, value: mi.Float | mi.Vector4f, index: mi.UInt32, active: mi.Bool | bool = True
    ) -> None:
        """Add values to the sums of an index, or four values to four neighbours."""
        integer = mi.Int64 if dr.size_v(value) != 4 else dr.int64_array_t(value)
        multiple = integer(dr.round(value * self._multiplier))
        # Rays of a packet are neighbours but seldom in one leaf: looking for that costs more.
        dr.scatter_reduce(
            dr.ReduceOp.Add, self._total, multiple, index, active, mode=dr.ReduceMode.Direct
        )

    def values(self) -> mi.Float:
        """The sums."""
        return mi.Float(self._total) * parameter(mi.Float, 1 / self._scale)


def total_of(count: int, *values: mi.Float | mi.Color3f) -> float:
    """A bound for `ExactSum`: sum over `count` rays of absolute values."""
    total = 0.0
    for value in values:
        copies = count if dr.width(value) == 1 else 1
        total += copies * float(dr.sum(dr.abs(value), axis=None)[0])
    return total
