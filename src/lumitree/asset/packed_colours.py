"""Colours of 32 bits: red, green and blue with a common exponent (RGB9_E5)."""

import numpy as np
from numpy.typing import NDArray

# Red, green and blue of 9 bits with a common exponent of 5 bits, as OpenGL's RGB9_E5. Colours
# are at most 1, so the exponent's offset is 31 in place of 15: darker colours can be stored.
_EXPONENT_OFFSET, _MANTISSA_BITS, _EXPONENT_BITS = 31, 9, 5
# Where the mantissas and the exponent are in a number, and a mantissa's bits. The unit of the
# mantissas is 2 to the power of the exponent less `EXPONENT_OF_ONE`.
MANTISSA_SHIFTS = (0, _MANTISSA_BITS, 2 * _MANTISSA_BITS)
EXPONENT_SHIFT = 3 * _MANTISSA_BITS
MANTISSA = (1 << _MANTISSA_BITS) - 1
EXPONENT_OF_ONE = _MANTISSA_BITS + _EXPONENT_OFFSET - 1


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
