"""A baked field on the device, and the exact integral of Eq. 3 along a ray.

Shadows need less detail than images, and a traversal of fewer leaves takes less time. A cell does
not transmit the transmittance of its mean density: thin parts hide less than the same density
spread over the cell. So a cell of the coarse field gets the density with which it transmits as much
light as its leaves do on average.

Symbols
    tau, T      optical depth and transmittance so far
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter, shared
from lumitree.core.frames import LocalFrame, towards_viewer
from lumitree.core.harmonics import basis, num_coefficients
from lumitree.core.transmittance import BLOCKED, Law, transmittance
from lumitree.octree.build import build_children, leaf_cells
from lumitree.octree.traversal import Octree, Span

# Coefficients that are loaded at once: gathers of single halves take three times as long.
_PACKET = 8
_LARGEST_HALF = float(np.finfo(np.float16).max)


class Field:
    """Device copy of an asset's octree.

    The integral is exact by default: it stops only where the linear law's transmittance is 0 or
    the exponential law's is below 1e-3.

    Args:
        asset: the arrays.
        min_density: leaves below this density (per local unit) count as empty; the paper: 0.1.
        max_opacity: rays stop at this opacity; the paper: 0.9.
    """

    def __init__(
        self, asset: FieldData, min_density: float = 0.0, max_opacity: float = 1.0
    ) -> None:
        self._law: Law = asset.law
        self._l_max = asset.l_max
        self._blocked = max(1.0 - max_opacity, 0.0 if asset.law == "linear" else BLOCKED)
        children = asset.children
        if min_density > 0:
            thin = np.append(asset.density < min_density, False)
            children = np.where((children < 0) & thin[~children.clip(max=-1)], 0, children)
        self._octree = Octree(children, asset.tree_depth, asset.frame.half_extents)
        # Device arrays cannot be empty: an asset without leaves gets one that nothing refers to.
        self._density = on_device(mi.Float, asset.density if asset.num_leaves else [0.0])
        packets, unit = _packets(asset)
        self._unit = parameter(mi.Float, 2.0**112 * unit)
        largest = (asset.max_radiance * factor for factor in asset.light_factors)
        self._max_radiance = parameter(mi.Color3f, *largest)
        self._coefficients = on_device(mi.UInt32, packets)
        dr.eval(self._density, self._coefficients)

    def emission(
        self,
        origin: mi.Point3f,
        direction: mi.Vector3f,
        active: mi.Bool | bool = True,
        span: Span = None,
    ) -> tuple[mi.Color3f, mi.Float]:
        """Emitted radiance L_e (Eq. 3) and transmittance T (Eq. 4) of the line through the proxy.

        Args:
            origin: any point of the line, local units.
            direction: unit direction of travel, local frame.
            active: mask.
            span: as for `Octree.traverse`.

        Returns:
            Radiance in units of the luminaire's scene; and transmittance in [0, 1].
        """
        y = self._basis(direction)

        def shade(state, leaf, start, length, active):
            radiance, tau, through = state
            tau, after = self._cross(tau, leaf, length, active)
            weight = through - after
            lit = active & (weight > 0)
            emission = dr.select(lit, weight * self._leaf_emission(leaf, y, lit), 0)
            return radiance + emission, tau, after

        clear = mi.Float(0), mi.Float(1)
        (_, through), (radiance, _, _) = self._octree.traverse_and_shade(
            origin,
            direction,
            mi.Bool(active),
            self._visit,
            clear,
            shade,
            (mi.Color3f(0), *clear),
            span,
        )
        return radiance, through

    def leaf_emission(
        self, leaf: mi.UInt32, direction: mi.Vector3f, active: mi.Bool | bool = True
    ) -> mi.Color3f:
        """Φ of Eq. 6 for a leaf, seen along a direction of travel as for `emission`."""
        return self._leaf_emission(leaf, self._basis(direction), active)

    def _basis(self, direction):
        return basis(*towards_viewer(direction), l_max=self._l_max)

    def eval_rays(
        self, origin: NDArray[np.floating], direction: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """As `emission` for arrays: points and unit directions [N, 3] to [N, 3] and [N]."""
        if not len(origin):
            return np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
        radiance, through = self.emission(
            on_device(mi.Point3f, origin), on_device(mi.Vector3f, direction)
        )
        dr.eval(radiance, through)
        return np.stack([np.array(channel) for channel in radiance], axis=-1), np.array(through)

    def transmittance(
        self,
        origin: mi.Point3f,
        direction: mi.Vector3f,
        active: mi.Bool | bool = True,
        span: Span = None,
    ) -> mi.Float:
        """Transmittance T (Eq. 4) alone; arguments as for `emission`."""
        state, active = (mi.Float(0), mi.Float(1)), mi.Bool(active)
        return self._octree.traverse(origin, direction, active, self._visit, state, span)[1]

    def _visit(self, state, leaf, start, length, active):
        tau, through = self._cross(state[0], leaf, length, active)
        return (tau, through), through > self._blocked

    def _cross(self, tau, leaf, length, active):
        """Optical depth and transmittance after a leaf."""
        density = dr.gather(mi.Float, self._density, leaf, active)
        tau = tau + dr.select(active, density * length, 0)
        return tau, mi.Float(transmittance(tau, self._law, dr))

    def _leaf_emission(self, leaf, y, active):
        """Φ of Eq. 6 for leaves [index], with the basis values `y` of the ray."""
        count, packets = len(y), _width(self._l_max) // _PACKET
        flat = []
        for packet in range(packets):
            index = leaf * packets + packet
            for pair in dr.gather(mi.Vector4u, self._coefficients, index, active):
                flat += [_from_half(half, self._unit) for half in (pair << 16, pair)]
        channels = []
        for channel in range(3):
            total = mi.Float(0)
            for k in range(count):
                total = dr.fma(flat[channel * count + k], y[k], total)
            channels.append(dr.rcp(1 + dr.exp(-total)))
        return self._max_radiance * mi.Color3f(*channels)


def _width(l_max: int) -> int:
    return -(-3 * num_coefficients(l_max) // _PACKET) * _PACKET


def _packets(asset: FieldData) -> tuple[NDArray[np.uint32], float]:
    """Coefficients in pairs, each leaf's padded to whole packets, and the unit they are in.

    Kernels flush half-precision denormals to 0. The unit is therefore the smallest power of two
    with which the largest coefficient can be stored: only coefficients that are negligible beside
    it are flushed.
    """
    largest = float(np.abs(asset.coefficients).max(initial=0))
    exponent = int(np.clip(np.floor(np.log2(_LARGEST_HALF / largest)), 0, 24)) if largest else 0
    rows = np.zeros((max(asset.num_leaves, 1), _width(asset.l_max)), np.float16)
    flat = asset.coefficients.reshape(-1, 3 * num_coefficients(asset.l_max))
    rows[: len(flat), : flat.shape[1]] = np.ldexp(flat, exponent)
    return rows.view(np.uint32).ravel(), 2.0**-exponent


def _from_half(bits, unit):
    """Value (mi.Float) of the half-precision number in the upper 16 of 32 bits, times `unit`.

    `unit` contains a factor of 2¹¹², the difference of the exponents' offsets.
    """
    # Sign; exponent and mantissa moved to their places. There are no infinities in an asset.
    word = (bits & 0x80000000) | ((bits & 0x7FFF0000) >> 3)
    return dr.reinterpret_array(mi.Float, word) * unit


def shared_field(asset: FieldData) -> Field:
    """Field of an asset in the variant that is set; all users of an asset share one copy."""
    return shared(asset, "field", lambda: Field(asset))


class FieldData(Protocol):
    """The data of a field, such as an `Asset`, which documents the members."""

    @property
    def children(self) -> NDArray[np.int32]: ...
    @property
    def density(self) -> NDArray[np.float32]: ...
    @property
    def coefficients(self) -> NDArray[np.float16]: ...
    @property
    def tree_depth(self) -> int: ...
    @property
    def l_max(self) -> int: ...
    @property
    def law(self) -> Law: ...
    @property
    def max_radiance(self) -> float: ...
    @property
    def light_factors(self) -> tuple[float, float, float]: ...
    @property
    def frame(self) -> LocalFrame: ...
    @property
    def num_leaves(self) -> int: ...
    @property
    def luminaire(self) -> str: ...


if TYPE_CHECKING:
    from lumitree.octree.field import FieldData

# Depth of the coarse field, and levels below it whose detail is averaged.
COARSE_DEPTH, _FINE_LEVELS = 5, 3
# A cell transmits at least this part of the light, so that its density is finite.
_LEAST = 1e-4
# Halvings of the range of a density, and local units that no side is below.
_BISECTIONS, _TINY = 40, 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class CoarseField:
    """A field of density without emission, as `FieldData`."""

    children: NDArray[np.int32]
    density: NDArray[np.float32]
    frame: LocalFrame
    luminaire: str
    tree_depth: int = COARSE_DEPTH
    law: Law = "exponential"
    l_max: int = 0
    max_radiance: float = 0.0
    light_factors: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def num_leaves(self) -> int:
        """Number of leaves, M."""
        return len(self.density)

    @property
    def coefficients(self) -> NDArray[np.float16]:
        """float16 [M, 3, 1] of zeros."""
        return np.zeros((self.num_leaves, 3, 1), np.float16)


def coarsened(asset: FieldData) -> CoarseField:
    """Field of depth `COARSE_DEPTH` with about the same mean transmittance.

    A cell that has leaves of the given field gets the density with which it transmits as much light
    along x, y and z together, by the area of the cell across each, as the leaves do on average.
    Cells count with their part inside the bounding box, to which rays are clipped. The law of the
    result is the exponential one, whatever the law of the given field.
    """
    cells, levels = leaf_cells(asset.children, asset.num_leaves)
    density = asset.density.astype(np.float64)
    resolution, side = 1 << _FINE_LEVELS, 2.0 / (1 << COARSE_DEPTH)
    half = asset.frame.half_extents
    # Leaves that are not below the coarse depth stay.
    stay = levels <= COARSE_DEPTH
    sides = _within(cells[stay], (2.0 / (1 << levels[stay]))[:, None], half)
    kept = transmittance(density[stay, None] * sides, asset.law, np)
    below = cells[~stay], levels[~stay] - COARSE_DEPTH, density[~stay]
    parents, index = np.unique(below[0] >> below[1][:, None], axis=0, return_inverse=True)
    grid = np.zeros((len(parents), resolution, resolution, resolution), np.float32)
    for steps in np.unique(below[1]):
        chosen = below[1] == steps
        _fill(grid, index[chosen].ravel(), below[0][chosen], int(steps), below[2][chosen])
    # Lengths [M, R, 3] of the grids' steps along each axis within the box.
    fine = parents[:, None, :] * resolution + np.arange(resolution)[:, None]
    steps = _within(fine, side / resolution, half)
    lines = [_through(grid, steps, axis, asset.law) for axis in range(3)]
    through = np.concatenate([kept, np.stack(lines, axis=-1)])
    sides = np.concatenate([sides, steps.sum(axis=1)])
    return CoarseField(
        children=build_children(
            np.concatenate([cells[stay], parents]),
            np.concatenate([levels[stay], np.full(len(parents), COARSE_DEPTH)]),
        ),
        density=_density(through, sides).astype(np.float32),
        frame=asset.frame,
        luminaire=asset.luminaire,
    )


def _within(
    cells: NDArray[np.int64], side: float | NDArray[np.float64], half_extents: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Sides [..., 3] of the parts of cells [..., 3] within the bounding box."""
    lower = np.maximum(cells * side - 1, -half_extents)
    upper = np.minimum((cells + 1) * side - 1, half_extents)
    return np.maximum(upper - lower, 0)


def _through(
    grid: NDArray[np.float32], steps: NDArray[np.float64], axis: int, law: Law
) -> NDArray[np.float64]:
    """Mean transmittance [M] of the lines through each grid [M, R, R, R] along an axis.

    `steps` [M, R, 3] has the lengths of the grid's steps along each axis.
    """
    lengths = [steps[..., each] for each in range(3)]
    along = lengths.pop(axis)
    depth = np.einsum("mabc,ma->mbc", np.moveaxis(grid, axis + 1, 1), along)
    area = lengths[0][:, :, None] * lengths[1][:, None, :]
    light = (transmittance(depth, law, np) * area).sum(axis=(1, 2))
    return light / np.maximum(area.sum(axis=(1, 2)), _TINY)


def _density(through: NDArray[np.float64], sides: NDArray[np.float64]) -> NDArray[np.float64]:
    """Density [M] of cells that transmit the parts `through` [M, 3] of the light along each axis.

    It solves Σ_i A_i exp(-density · a_i) = Σ_i A_i t_i by bisection, with the side a_i and the area
    across it A_i.
    """
    sides = np.maximum(sides, _TINY)
    area = np.prod(sides, axis=1, keepdims=True) / sides
    area /= area.sum(axis=1, keepdims=True)
    light = np.maximum((area * through).sum(axis=1), _LEAST)
    low, high = np.zeros(len(sides)), -np.log(_LEAST) / sides.min(axis=1)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        is_more = (area * np.exp(-middle[:, None] * sides)).sum(axis=1) > light
        low, high = np.where(is_more, middle, low), np.where(is_more, high, middle)
    return low


def _fill(
    grid: NDArray[np.float32],
    index: NDArray[np.int64],
    cells: NDArray[np.int64],
    steps: int,
    density: NDArray[np.float64],
) -> None:
    """Add leaves that are `steps` levels below the coarse depth to the grids of their cells."""
    if steps > _FINE_LEVELS:
        finer = steps - _FINE_LEVELS
        inner = cells >> finer & (1 << _FINE_LEVELS) - 1
        np.add.at(grid, (index, *inner.T), density / 8.0**finer)
        return
    side, inner = 1 << (_FINE_LEVELS - steps), cells & ((1 << steps) - 1)
    blocks = grid.reshape(len(grid), *(1 << steps, side) * 3)
    x, y, z = inner.T
    blocks[index, x, :, y, :, z, :] = density[:, None, None, None]
