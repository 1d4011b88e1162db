"""The octree and the radiance field of an asset as a tensor of its file, see docs/format.md.

The field is rounded. A density keeps 4 bits after its leading one, and a coefficient is a multiple
of a step, which is smaller for leaves that emit much: their errors would not average out. R and B
are stored as differences to G. Values rounded once are not changed by rounding them again.

Symbols
    N   interior nodes          M   leaves          K   (l_max + 1)² coefficients per channel
"""

import dataclasses
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.array_stream import Arrays, Layout, compressed, decompressed
from lumitree.asset.asset import MAX_DENSITY, Asset
from lumitree.core.harmonics import num_coefficients
from lumitree.core.results import Json
from lumitree.core.tables import Range
from lumitree.errors import LumitreeError


class Steps(NamedTuple):
    """Steps of the coefficients.

    Attributes:
        constant: of band 0.
        bright, medium, dark: of the others, where the largest of the three coefficients of band 0
            is at least `BRIGHT`, at least `MEDIUM`, or less.
    """

    constant: float
    bright: float
    medium: float
    dark: float


STEPS = Steps(1 / 64, 1 / 8, 1 / 2, 1.0)
# A constant emission of about 1/10 and 1/100 of L_max.
BRIGHT, MEDIUM = -8.0, -16.0
# Bits of a float32 that a density drops; 4 of its mantissa stay.
DENSITY_SHIFT = 19
_MAX_ROWS = 1 << 27
# The largest int16 that is a float16 at any step, as is its half.
_LARGEST_CODE = (1 << 15) - (1 << 5)


@dataclasses.dataclass(frozen=True)
class FieldSizes:
    """Numbers of nodes and leaves in the description of a file."""

    nodes: Annotated[int, Range(1, _MAX_ROWS)]
    leaves: Annotated[int, Range(0, _MAX_ROWS)]


def rounded_field(asset: Asset) -> Arrays:
    """`children`, `density` and `coefficients` as a file of the asset gives them back."""
    return field_of_codes(field_codes(asset))


def stored_field(asset: Asset) -> tuple[Arrays, Json]:
    """Tensors of an asset's octree and field by name, and their description in the file."""
    nodes, leaves = len(asset.children), asset.num_leaves
    layouts = field_layouts(nodes, leaves, asset.l_max)
    tensors = {"field.stream": compressed(field_codes(asset), layouts)}
    return tensors, {"nodes": nodes, "leaves": leaves}


def build_field(sizes: FieldSizes, l_max: int, tensors: Arrays) -> Arrays:
    """`children`, `density` and `coefficients` of a file; the inverse of `stored_field`."""
    layouts = field_layouts(sizes.nodes, sizes.leaves, l_max)
    return field_of_codes(decompressed(tensors["field.stream"], layouts, "the field"))


def field_codes(asset: Asset, steps: Steps = STEPS) -> Arrays:
    """Arrays of the stream, by name; nodes and leaves in the order of the file."""
    children, leaves = _breadth_first(asset.children)
    return {
        "occupied": np.packbits(children != 0, axis=1, bitorder="little")[:, 0],
        "leaf": np.packbits(children < 0, axis=1, bitorder="little")[:, 0],
        "density": density_codes(asset.density[leaves]),
        "coefficients": coefficient_codes(asset.coefficients[leaves], steps),
    }


def field_of_codes(codes: Arrays, steps: Steps = STEPS) -> Arrays:
    """The field of the arrays of a stream, checked; the inverse of `field_codes`."""
    return {
        "children": _children(codes["occupied"], codes["leaf"], len(codes["density"])),
        "density": densities(codes["density"]),
        "coefficients": coefficients_of(codes["coefficients"], steps),
    }


def density_codes(density: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Codes [M] of densities [M]: the upper bits of their float32, rounded."""
    half = np.uint32(1 << (DENSITY_SHIFT - 1))
    largest = np.float32(MAX_DENSITY).view(np.uint32) >> DENSITY_SHIFT
    return np.minimum((density.view(np.uint32) + half) >> DENSITY_SHIFT, largest).astype(np.uint16)


def densities(codes: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Densities [M] of codes [M]; one with too many bits is refused."""
    if (codes >> (32 - DENSITY_SHIFT)).any():
        raise LumitreeError(f"a density of more than {32 - DENSITY_SHIFT} bits")
    return (codes.astype(np.uint32) << DENSITY_SHIFT).view(np.float32)


def coefficient_codes(coefficients: NDArray[np.float16], steps: Steps = STEPS) -> NDArray[np.int16]:
    """Codes [M, K, 3] of coefficients [M, 3, K], as multiples of steps: R - G, G and B - G."""
    values = coefficients.transpose(0, 2, 1).astype(np.float32)
    # Differences to G may be twice as large.
    largest = _LARGEST_CODE // 2 * steps.constant
    values[:, :1] = np.clip(values[:, :1], -largest, largest)
    # Differences before rounding: grey leaves have only 0.
    values[..., ::2] -= values[..., 1:2]
    codes = np.empty(values.shape, np.int16)
    codes[:, :1] = _limited(values[:, :1] / steps.constant)
    codes[:, 1:] = _limited(values[:, 1:] / _step_of_leaves(codes, steps))
    return codes


def coefficients_of(codes: NDArray[np.int16], steps: Steps = STEPS) -> NDArray[np.float16]:
    """Coefficients [M, 3, K] of codes [M, K, 3]."""
    values = codes.astype(np.float32)
    values[..., ::2] += values[..., 1:2]
    values[:, :1] *= steps.constant
    values[:, 1:] *= _step_of_leaves(codes, steps)
    # Codes of a damaged file may overflow: `Asset` refuses infinity.
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(values.transpose(0, 2, 1), np.float16)


def _step_of_leaves(codes: NDArray[np.int16], steps: Steps) -> NDArray[np.float32]:
    """Steps [M, 1, 1] of all bands but 0, for codes [M, K, 3]."""
    red, green, blue = codes[:, 0].astype(np.float32).T * steps.constant
    largest = green + np.maximum(np.maximum(red, blue), 0)
    chosen = np.select([largest >= BRIGHT, largest >= MEDIUM], steps[1:3], steps.dark)
    return chosen.astype(np.float32)[:, None, None]


def _limited(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.clip(np.rint(values), -_LARGEST_CODE, _LARGEST_CODE)


def field_layouts(nodes: int, leaves: int, l_max: int) -> list[Layout]:
    """Arrays of the stream, in its order."""
    return [
        Layout("occupied", np.uint8, (nodes,)),
        Layout("leaf", np.uint8, (nodes,)),
        Layout("density", np.uint16, (leaves,), planes=True),
        Layout("coefficients", np.int16, (leaves, num_coefficients(l_max), 3), planes=True),
    ]


def _breadth_first(
    children: NDArray[np.int32],
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """The node table in the order of the file, and the old indices [M] of its leaves.

    Nodes are breadth first, by octant within a node, and leaves in the order of their entries.
    """
    levels = [np.zeros(1, np.int64)]
    while len(levels[-1]):
        entries = children[levels[-1]]
        levels.append(entries[entries > 0].astype(np.int64))
    ordered = children[np.concatenate(levels)]
    leaves = ~ordered[ordered < 0].astype(np.int64)
    return _numbered(ordered > 0, ordered < 0), leaves


def _children(
    occupied: NDArray[np.uint8], leaf: NDArray[np.uint8], leaves: int
) -> NDArray[np.int32]:
    """Node table [N, 8] of the bits of its entries."""
    is_leaf, is_interior = (
        np.unpackbits(bits[:, None], axis=1, bitorder="little").astype(bool)
        for bits in (leaf, occupied ^ leaf)
    )
    found = int(is_interior.sum()) + 1, int(is_leaf.sum())
    if (leaf & ~occupied).any() or found != (len(occupied), leaves):
        raise LumitreeError(
            f"a tree of {found[0]} nodes and {found[1]} leaves, expected {len(occupied)} and "
            f"{leaves}"
        )
    return _numbered(is_interior, is_leaf)


def _numbered(interior: NDArray[np.bool_], leaf: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Node table [N, 8] in which nodes and leaves are numbered in the order of their entries."""
    children = np.zeros(interior.shape, np.int32)
    children[interior] = np.arange(1, interior.sum() + 1)
    children[leaf] = ~np.arange(leaf.sum())
    return children
