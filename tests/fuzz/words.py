"""Bytes and arrays with some changes."""

import numpy as np

from fuzz.values import pick


def flipped(content, rng):
    """Bytes with some bits changed, a part overwritten, repeated or removed, or cut off."""
    data = bytearray(content or b" ")
    for _ in range(int(rng.integers(1, 4))):
        at, length = int(rng.integers(len(data))), int(rng.integers(1, 9))
        match int(rng.integers(6)):
            case 0:
                del data[at:]
            case 1:
                del data[at : at + length]
            case 2:
                data[at:at] = data[at : at + 8 * length]
            case 3:
                filler = pick(rng, (b"\0", b"\xff", b"\x7f", b"\x80"))
                data[at : at + length] = filler * min(length, len(data) - at)
            case _:
                data[at] ^= 1 << int(rng.integers(8))
        data = data or bytearray(b"\0")
    return bytes(data)


def changed_array(array, rng):
    """A copy of an array with other numbers, some of them extreme."""
    array = np.array(array)
    if not array.size:
        return array
    where = rng.integers(array.size, size=pick(rng, (1, 1, 2, array.size)))
    match int(rng.integers(5)):
        case 0:
            bits = array.reshape(-1).view(np.uint8)
            bits[int(rng.integers(bits.size))] ^= np.uint8(1 << int(rng.integers(8)))
        case 1:
            array = array[rng.permutation(len(array))]
        case 2:
            array.flat[where] = array.flat[int(rng.integers(array.size))]
        case _:
            array.flat[where] = pick(rng, _extremes(array.dtype))
    return array


def _extremes(dtype):
    if dtype.kind == "f":
        kind = np.finfo(dtype)
        finite = (kind.max, kind.min, kind.tiny, kind.smallest_subnormal, 0, -0.0, 1, -1, 2, 1e4)
        return (*(dtype.type(each) for each in finite), np.inf, -np.inf, np.nan)
    if dtype.kind == "b":
        return (False, True)
    kind = np.iinfo(dtype)
    return (kind.max, kind.min, 0, 1, 2, kind.max // 2, kind.max // 2 + 1)


def resized(array, rng):
    """An array with more or fewer rows."""
    count = pick(rng, (0, len(array) - 1, len(array) + 1, 2 * len(array), 300))
    return np.resize(array, (max(count, 0), *array.shape[1:])) if array.size else array
