"""Haar wavelets of a 4D light field on a box, thresholded to a number of bytes.

A node of the tree is a part of the light field: a square of a face times a square of directions. It
has 16 children, which halve both sides of both squares, and 15 wavelets for the differences between
them. Those of a node whose wavelets are all dropped, and of all nodes below, are not stored: the
light field is constant there.

Symbols
    P, D    cells of position and of direction along a side of a square; powers of 2
    L       levels of wavelets, log2(min(P, D))
    B       parts of the light field at the coarsest level, 6 (P / 2^L)² (D / 2^L)²
    N_l     nodes of level l = 0 to L - 1, B 16^l
    S       slots, see `SlotTree`
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import hadamard

# Bit i of a child's number, or of a wavelet's, is for an axis; the first axis has the highest bit.
CHILDREN = 16
# Signs [child, wavelet] of the Haar wavelets of four axes.
_SIGNS = hadamard(CHILDREN)[:, 1:].astype(np.float64)
_WAVELETS = ["".join("ad"[k >> bit & 1] for bit in (3, 2, 1, 0)) for k in range(1, CHILDREN)]
# Of a coefficient: three channels of 9 bits and an exponent of 5 bits.
_COEFFICIENT_BYTES, _MANTISSA, _EXPONENTS = 4, 8, 32
# Of a node: a bit for each of its 15 wavelets and for each of its 16 children.
_NODE_BYTES = 4
# Of a part at the coarsest level: three floats, of which a sign says whether its node is stored.
_COARSE_BYTES = 12


@dataclasses.dataclass(frozen=True)
class Wavelets:
    """Orthonormal Haar transform of the flux of the cells.

    Attributes:
        scaling: [B, 3] coefficients of the coarsest level.
        details: of each level from the coarsest, [N_l, 15, 3]. The children of node n of a level
            are the nodes 16 n to 16 n + 15 of the next.
    """

    scaling: NDArray[np.floating]
    details: Sequence[NDArray[np.floating]]


@dataclasses.dataclass(frozen=True)
class SlotTree:
    """What is stored, reconstructed.

    Slots 0 to B - 1 are the parts at the coarsest level; then each stored node has 16 for its
    children.

    Attributes:
        values: float64 [S, 3], not negative; mean flux of the finest cells in the slot's part.
        first: uint32 [S], first slot of the node that the slot's part is; 0 if it is not stored.
        splits: float32 [S]; those of a node are the probabilities to go to the lower half along the
            first axis (slot 1), then along the second in either half (2 and 3), along the third (4
            to 7) and along the fourth (8 to 15). Slot 0, and the first B, have none.
        num_bytes: of the file that would hold the tree.
    """

    values: NDArray[np.float64]
    first: NDArray[np.uint32]
    splits: NDArray[np.float32]
    num_bytes: int


def transform(flux: NDArray[np.floating]) -> Wavelets:
    """Haar transform of the flux [6, P, P, D, D, 3] of the cells."""
    import pywt

    levels = int(math.log2(min(flux.shape[1], flux.shape[3])))
    scaling, *details = pywt.wavedecn(
        flux, "haar", mode="periodization", level=levels, axes=(1, 2, 3, 4)
    )
    return Wavelets(
        nested(scaling, 0),
        [
            np.stack([nested(bands[key], level) for key in _WAVELETS], axis=1)
            for level, bands in enumerate(details)
        ],
    )


def nested(values: NDArray[np.floating], level: int) -> NDArray[np.floating]:
    """Values [6, P', P', D', D', 3] of the nodes of a level, as rows [N, 3] in the tree's order."""
    faces, *sides, channels = values.shape
    coarse = [side >> level for side in sides]
    split = [(side, *[2] * level) for side in coarse]
    values = values.reshape(faces, *(each for axis in split for each in axis), channels)
    # Coarse place of all axes, then a bit of each axis, level by level.
    order = [1 + axis * (level + 1) + place for place in range(level + 1) for axis in range(4)]
    return values.transpose(0, *order, values.ndim - 1).reshape(-1, channels)


def compress(wavelets: Wavelets, num_bytes: float) -> SlotTree:
    """The largest coefficients, as many as a number of bytes holds.

    The size of a coefficient is its length over the three channels. Since the basis is orthonormal,
    dropping the smallest is the choice of least squared error of the cells' flux. Coefficients
    kept are rounded to 4 bytes. `math.inf` keeps all that are not 0, without rounding.

    Dropping coefficients makes some cells negative. They are set to 0 on the way from the coarsest
    level down, and the other children of the same node and channel are scaled so that their sum
    remains that of their parent. So each channel has the flux of the cells that were transformed,
    exactly in each part at the coarsest level. But it is another function than the sum of the kept
    wavelets: light is moved within nodes. This is part of the error of the compression, and the
    samples of a tree are unbiased for this function only.
    """
    sizes = [np.linalg.norm(each, axis=-1) for each in wavelets.details]
    ranked = np.sort(np.concatenate([each.ravel() for each in sizes]))[::-1]
    if math.isinf(num_bytes):
        return _reconstruct(wavelets.scaling, wavelets.details, [each > 0 for each in sizes])
    low, high = 0, int(np.count_nonzero(ranked))
    # The number of bytes grows with that of coefficients: bisection.
    while low < high:
        count = (low + high + 1) // 2
        kept = _larger(sizes, ranked, count)
        if _size(len(wavelets.scaling), kept) <= num_bytes:
            low = count
        else:
            high = count - 1
    kept = _larger(sizes, ranked, low)
    largest = float(ranked[0])
    rounded = [
        _rounded(np.where(use[..., None], each, 0), largest)
        for use, each in zip(kept, wavelets.details, strict=True)
    ]
    return _reconstruct(wavelets.scaling, rounded, kept)


def _larger(
    sizes: Sequence[NDArray[np.floating]], ranked: NDArray[np.floating], count: int
) -> list[NDArray[np.bool_]]:
    """Which coefficients are among the largest: at most `count`, fewer if some are equal."""
    limit = ranked[count] if count < len(ranked) else 0
    return [each > limit for each in sizes]


def _stored(kept: Sequence[NDArray[np.bool_]]) -> list[NDArray[np.bool_]]:
    """Which nodes [N_l] of each level keep a coefficient themselves or below."""
    stored = [np.asarray(each.any(axis=1)) for each in kept]
    for level in range(len(stored) - 2, -1, -1):
        stored[level] |= stored[level + 1].reshape(-1, CHILDREN).any(axis=1)
    return stored


def _size(coarse: int, kept: Sequence[NDArray[np.bool_]]) -> int:
    coefficients = sum(int(each.sum()) for each in kept)
    nodes = sum(int(each.sum()) for each in _stored(kept))
    return _COARSE_BYTES * coarse + _COEFFICIENT_BYTES * coefficients + _NODE_BYTES * nodes


def _rounded(values: NDArray[np.floating], largest: float) -> NDArray[np.float64]:
    """Coefficients [..., 3] as 4 bytes hold them: signed channels, and one exponent for all.

    Args:
        largest: length of the largest coefficient; exponents count from its own down.
    """
    exponent = np.frexp(np.abs(values).max(axis=-1, keepdims=True))[1]
    lowest = np.frexp(largest)[1] - (_EXPONENTS - 1)
    step = np.ldexp(1.0, np.maximum(exponent, lowest) - _MANTISSA)
    most = 2**_MANTISSA - 1
    return np.clip(np.round(values / step), -most, most) * step


def _reconstruct(
    scaling: NDArray[np.floating],
    details: Sequence[NDArray[np.floating]],
    kept: Sequence[NDArray[np.bool_]],
) -> SlotTree:
    levels, coarse = len(details), len(scaling)
    nodes = [np.flatnonzero(each) for each in _stored(kept)]
    # The first slots of the levels, and the number of all slots.
    base = coarse + CHILDREN * np.cumsum([0, *(len(each) for each in nodes)])
    values, first = np.zeros((base[-1], 3)), np.zeros(base[-1], np.uint32)
    splits = np.zeros(base[-1], np.float32)
    # A scaling coefficient is the flux over the square root of the number of cells, 16^L.
    values[:coarse] = scaling / 4**levels
    for level, here in enumerate(nodes):
        if level == 0:
            slots = here
        else:
            parent = np.searchsorted(nodes[level - 1], here // CHILDREN)
            slots = base[level - 1] + CHILDREN * parent + here % CHILDREN
        first[slots] = base[level] + CHILDREN * np.arange(len(here))
        # A step of the inverse transform, in mean flux of the finest cells.
        differences = _SIGNS @ details[level][here] / 4 ** (levels - level)
        children = _not_negative(values[slots], differences)
        place = slice(base[level], base[level + 1])
        values[place] = children.reshape(-1, 3)
        splits[place] = _splits(children.sum(axis=2)).ravel()
    return SlotTree(values, first, splits, _size(coarse, kept))


def _not_negative(
    parent: NDArray[np.float64], differences: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Children [N, 16, 3] of mean `parent` [N, 3]: the positive parts of parent + differences."""
    children = np.maximum(parent[:, None] + differences, 0)
    mean = children.mean(axis=1)
    scale = np.divide(parent, mean, out=np.zeros_like(mean), where=mean > 0)
    return children * scale[:, None]


def _splits(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """`SlotTree.splits` of nodes whose children have these weights [N, 16]."""
    result = np.full(weights.shape, 0.5)
    for axis in range(4):
        halves = weights.reshape(len(weights), 1 << axis, 2, 8 >> axis).sum(axis=-1)
        total = halves.sum(axis=-1)
        place = result[:, 1 << axis : 2 << axis]
        np.divide(halves[..., 0], total, out=place, where=total > 0)
    return result
