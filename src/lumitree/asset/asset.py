"""The in-memory form of a baked luminaire, and every invariant it must satisfy.

Symbols
    N   interior nodes          M   leaves          K   (l_max + 1)² coefficients a channel
    octant                      x + 2y + 4z, each 0 for the lower half and 1 for the upper
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.backend import load_mitsuba
from lumitree.core.frames import check_local_frame, similarity_scale
from lumitree.core.harmonics import MAX_L, num_coefficients
from lumitree.core.reading import label
from lumitree.core.transmittance import LAWS, Law
from lumitree.errors import LumitreeError
from lumitree.octree.build import MAX_TREE_DEPTH

# What a renderer computes from values within these bounds is finite in float32, squares included.
MIN_RADIANCE, MAX_RADIANCE = 1e-15, 1e15
MAX_DENSITY = 1e15


@dataclasses.dataclass(frozen=True, eq=False)
class Asset:
    """A sparse octree over the cube [-1, 1]³ of the local frame.

    Inside a leaf density and coefficients are constant. The emission towards a viewer in
    direction v is Φ = max_radiance · sigmoid(Σ coefficient · Y(v)).

    Attributes:
        children: int32 [N, 8], by octant: 0 empty, n > 0 interior node n, c < 0 leaf ~c.
            Node 0 is the root; a node's children come after it.
        density: float32 [M], 0 to 1e15, per local unit of length.
        coefficients: float16 [M, 3, K], spherical-harmonics coefficients of the logit.
        tree_depth: level of the smallest possible leaf, whose side is 2 / 2**tree_depth.
        l_max: highest spherical-harmonics band, 0 to 4.
        law: transmittance law the field was made for.
        max_radiance: L_max, the upper end of the emission, 1e-15 to 1e15; radiance units of the
            luminaire's own scene.
        half_extents: float [3], the proxy box in local units, at least 1e-3; the longest is 1.
        world_from_proxy: float [4, 4], a similarity from the local frame to that of the luminaire's
            file. Its scale is 1e-12 to 1e12, its translation at most 1e12 along each axis.
        luminaire: where the field came from, for people; kept as a `core.reading.label`.
    """

    children: NDArray[np.int32]
    density: NDArray[np.float32]
    coefficients: NDArray[np.float16]
    tree_depth: int
    l_max: int
    law: Law
    max_radiance: float
    half_extents: NDArray[np.float64]
    world_from_proxy: NDArray[np.float64]
    luminaire: str

    def __post_init__(self) -> None:
        """Refuse anything that a renderer could not traverse safely."""
        object.__setattr__(self, "luminaire", label(self.luminaire))
        _check_scalars(self)
        _check_payload(self)
        _check_tree(self.children, len(self.density), self.tree_depth)

    @property
    def num_leaves(self) -> int:
        """Number of leaves, M."""
        return len(self.density)

    @property
    def num_bytes(self) -> int:
        """Bytes of tree and payload."""
        return self.children.nbytes + self.density.nbytes + self.coefficients.nbytes

    @property
    def info(self) -> "AssetInfo":
        """The asset in figures."""
        size = 2 * self.half_extents * similarity_scale(self.world_from_proxy)
        return AssetInfo(
            luminaire=self.luminaire,
            tree_depth=self.tree_depth,
            leaves=self.num_leaves,
            nodes=len(self.children),
            l_max=self.l_max,
            law=self.law,
            max_radiance=self.max_radiance,
            size=(float(size[0]), float(size[1]), float(size[2])),
            centre=tuple(self.world_from_proxy[:3, 3].tolist()),
        )

    def eval(
        self, origin: ArrayLike, direction: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Radiance emitted along lines, and their transmittance (Eq. 3 and 4).

        Args:
            origin: [N, 3] any point of each line, in the frame and unit of the luminaire's file.
            direction: [N, 3] directions of travel, of any length but 0.

        Returns:
            Radiance [N, 3], W/(m² sr), that reaches a viewer who looks along the line from outside
            the lamp; and transmittance [N] in [0, 1].

        Raises:
            LumitreeError: the arrays are not [N, 3] finite numbers, or a direction is 0.
        """
        origin, direction = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
        if origin.shape != direction.shape or origin.ndim != 2 or origin.shape[1] != 3:
            raise LumitreeError(
                f"origin is {origin.shape} and direction {direction.shape}; expected [N, 3] both"
            )
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        if not (np.isfinite(origin).all() and np.isfinite(length).all() and (length > 0).all()):
            raise LumitreeError("lines need finite origins and finite directions other than 0")
        load_mitsuba()
        from lumitree.octree.field import shared_field

        # Held, so that the next call finds it open; by the variant that is set now.
        self.__dict__["_field"] = field = shared_field(self)
        return field.eval_lines(*self._local_lines(origin, direction / length))

    def _local_lines(self, origin, direction):
        """Lines in the local frame: points [N, 3] and unit directions [N, 3]."""
        scale = similarity_scale(self.world_from_proxy)
        rotation = self.world_from_proxy[:3, :3] / scale
        return (origin - self.world_from_proxy[:3, 3]) @ rotation / scale, direction @ rotation


@dataclasses.dataclass(frozen=True)
class AssetInfo:
    """An asset in figures.

    Attributes:
        luminaire: where it came from.
        tree_depth: level of the smallest possible leaf.
        leaves, nodes: of the octree.
        l_max: highest spherical-harmonics band.
        law: transmittance law, "linear" or "exponential".
        max_radiance: upper end of the emission, W/(m² sr).
        size: sides of the bounding box, the unit of the luminaire's file.
        centre: of the bounding box, in the frame of the luminaire's file.
    """

    luminaire: str
    tree_depth: int
    leaves: int
    nodes: int
    l_max: int
    law: Law
    max_radiance: float
    size: tuple[float, ...]
    centre: tuple[float, ...]


def _expect(condition: Any, message: str) -> None:
    if not condition:
        raise LumitreeError(f"invalid asset: {message}")


def _check_scalars(asset: Asset) -> None:
    _expect(
        type(asset.tree_depth) is int and 1 <= asset.tree_depth <= MAX_TREE_DEPTH,
        f"tree depth {asset.tree_depth!r}, expected 1 to {MAX_TREE_DEPTH}",
    )
    _expect(
        type(asset.l_max) is int and 0 <= asset.l_max <= MAX_L,
        f"l_max {asset.l_max!r}, expected 0 to {MAX_L}",
    )
    _expect(asset.law in LAWS, f"transmittance law {asset.law!r}, expected one of {LAWS}")
    _expect(
        MIN_RADIANCE <= asset.max_radiance <= MAX_RADIANCE,
        f"maximum radiance {asset.max_radiance!r}, expected {MIN_RADIANCE} to {MAX_RADIANCE}",
    )
    try:
        check_local_frame(asset.half_extents, asset.world_from_proxy)
    except LumitreeError as error:
        raise LumitreeError(f"invalid asset: {error}") from None


def _check_payload(asset: Asset) -> None:
    leaves = len(asset.density)
    shapes = {
        "children": (asset.children, np.int32, (len(asset.children), 8)),
        "density": (asset.density, np.float32, (leaves,)),
        "coefficients": (
            asset.coefficients,
            np.float16,
            (leaves, 3, num_coefficients(asset.l_max)),
        ),
    }
    for name, (array, dtype, shape) in shapes.items():
        _expect(
            array.dtype == dtype and array.shape == shape,
            f"{name} is {array.dtype} {array.shape}, expected {np.dtype(dtype)} {shape}",
        )
    _expect(
        ((asset.density >= 0) & (asset.density <= MAX_DENSITY)).all(),
        f"density holds NaN, negative values or values above {MAX_DENSITY}",
    )
    _expect(np.isfinite(asset.coefficients).all(), "coefficients hold NaN or infinity")


def _check_tree(children: NDArray[np.int32], num_leaves: int, tree_depth: int) -> None:
    num_nodes = len(children)
    _expect(num_nodes >= 1, "the tree has no root")
    nodes, leaves = children[children > 0], ~children[children < 0]
    _expect(not len(nodes) or nodes.max() < num_nodes, "a node index is out of range")
    _expect(
        (np.bincount(nodes, minlength=num_nodes)[1:] == 1).all(),
        "interior nodes are not each referenced exactly once",
    )
    _expect(not len(leaves) or leaves.max() < num_leaves, "a leaf index is out of range")
    _expect(
        len(leaves) == num_leaves and (np.bincount(leaves, minlength=num_leaves) == 1).all(),
        "leaves are not each referenced exactly once",
    )
    # Every node referenced once and each level reached from the root rules out cycles.
    level, reached = np.array([0]), 0
    for _ in range(tree_depth):
        reached += len(level)
        below = children[level]
        level = below[below > 0]
    _expect(
        reached == num_nodes and not len(level),
        f"the tree is deeper than {tree_depth} levels or not connected",
    )
