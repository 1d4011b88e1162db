"""A baked field on the device, and the exact integral of Eq. 3 along a ray.

Symbols
    tau, T      optical depth and transmittance so far
"""

from __future__ import annotations

import functools
import threading
import weakref
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter
from lumitree.core.frames import towards_viewer
from lumitree.core.harmonics import basis, num_coefficients
from lumitree.core.transmittance import BLOCKED, transmittance
from lumitree.octree.coarse import COARSE_DEPTH, coarsened
from lumitree.octree.field_data import FieldData
from lumitree.octree.traversal import Octree, Span

# record(recorded, leaf, start, length, active[, emission]) -> recorded: see `Field.integrate`.
Record = Callable[..., Any]
# Coefficients that are loaded at once: gathers of single halves take three times as long.
_PACKET = 8
_LARGEST_HALF = float(np.finfo(np.float16).max)


class Field:
    """Device copy of an asset's octree.

    The integral is exact by default: it stops only where the linear law's transmittance is 0 or
    the exponential law's is below 1e-3.

    Args:
        asset: what to render.
        min_density: leaves below this density (per local unit) count as empty; the paper: 0.1.
        max_opacity: rays stop at this opacity; the paper: 0.9.
    """

    def __init__(
        self, asset: FieldData, min_density: float = 0.0, max_opacity: float = 1.0
    ) -> None:
        self.asset = asset
        self._min_density, self._max_opacity = min_density, max_opacity
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

    @functools.cached_property
    def coarse(self) -> Field:
        """Field of few leaves whose transmittance is about the same (`octree.coarse`)."""
        if self.asset.tree_depth <= COARSE_DEPTH:
            return self
        return Field(coarsened(self.asset, self._min_density), max_opacity=self._max_opacity)

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
        radiance, through, _ = self.integrate(origin, direction, active, _nothing, (), span)
        return radiance, through

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

    def integrate(
        self,
        origin: mi.Point3f,
        direction: mi.Vector3f,
        active: mi.Bool | bool,
        record: Record,
        recorded: Any,
        span: Span = None,
    ) -> tuple[mi.Color3f, mi.Float, Any]:
        """As `emission`, and calls a function for every leaf that the ray reaches.

        Args:
            record: takes the recorded state, a leaf, the distance at which the line enters it, the
                length of the line in it, a mask and the leaf's contribution to the radiance;
                returns the new state.
            recorded: tuple of Dr.Jit arrays, the first state.

        Returns:
            Radiance, transmittance and what is recorded.
        """
        y = basis(*towards_viewer(direction), l_max=self.asset.l_max)

        def shade(state, leaf, start, length, active):
            radiance, tau, through, recorded = state
            tau, after = self._cross(tau, leaf, length, active)
            weight = through - after
            lit = active & (weight > 0)
            emission = dr.select(lit, weight * self._leaf_emission(leaf, y, lit), 0)
            recorded = record(recorded, leaf, start, length, active, emission)
            return radiance + emission, tau, after, recorded

        clear = mi.Float(0), mi.Float(1)
        (_, through), (radiance, _, _, recorded) = self._octree.traverse_and_shade(
            origin,
            direction,
            mi.Bool(active),
            self._visit,
            clear,
            shade,
            (mi.Color3f(0), *clear, recorded),
            span,
        )
        return radiance, through, recorded

    def cross(
        self,
        origin: mi.Point3f,
        direction: mi.Vector3f,
        active: mi.Bool | bool,
        record: Record,
        recorded: Any,
    ) -> Any:
        """The recorded state of `integrate`, at a lower cost.

        `record` is called without the contribution to the radiance.
        """

        def visit(state, leaf, start, length, active):
            passed, recorded = state
            passed, onwards = self._visit(passed, leaf, start, length, active)
            return (passed, record(recorded, leaf, start, length, active)), onwards

        state = ((mi.Float(0), mi.Float(1)), recorded)
        return self._octree.traverse(origin, direction, mi.Bool(active), visit, state)[1]

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
        return tau, mi.Float(transmittance(tau, self.asset.law, dr))

    def _leaf_emission(self, leaf, y, active):
        """Φ of Eq. 6 for leaves [index], with the basis values `y` of the ray."""
        count, packets = len(y), _width(self.asset.l_max) // _PACKET
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


def _nothing(recorded, *_):
    return recorded


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


_LOCK = threading.Lock()
_SHARED: weakref.WeakKeyDictionary[FieldData, dict[str | None, weakref.ref[Field]]] = (
    weakref.WeakKeyDictionary()
)


def shared_field(asset: FieldData) -> Field:
    """Field of an asset in the variant that is set; all users of an asset share one copy."""
    key = mi.variant()
    with _LOCK:
        known = _SHARED.setdefault(asset, {}).get(key)
    field = None if known is None else known()
    if field is None:
        # Mitsuba creates plugins in parallel, and a thread that waits for the device may create
        # others meanwhile. So the lock is not held here; of two fields, the first is kept.
        field = Field(asset)
        with _LOCK:
            known = _SHARED[asset].get(key)
            other = None if known is None else known()
            if other is not None:
                return other
            _SHARED[asset][key] = weakref.ref(field)
    return field
