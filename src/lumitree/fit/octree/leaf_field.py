"""A field whose leaves can be changed, its integral along rays, and the integral's derivatives.

Symbols
    s_i         optical depth of leaf i along the ray, density times length
    T_i         transmittance after leaf i; T_0 = 1
    w_i         weight of leaf i, T_{i-1} - T_i
    Phi_i       emission of leaf i towards the viewer, in units of L_max: sigmoid(c_i · Y)
    L           sum of w_i Phi_i
    dL          derivative of the loss by L
    g           w Phi (1 - Phi), derivative of w Phi by the logit of Phi
"""

from __future__ import annotations

import copy
import functools
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter
from lumitree.core.frames import towards_viewer
from lumitree.core.harmonics import basis, num_coefficients
from lumitree.core.reading import Arrays
from lumitree.core.transmittance import BLOCKED, Law, transmittance
from lumitree.fit.octree.sums import ExactSum, total_of
from lumitree.octree.build import build_children
from lumitree.octree.traversal import Octree

# Leaves of a smaller weight in a ray add nothing to its radiance, and get no gradient for their
# coefficients.
MIN_WEIGHT = 1e-4
# Optical depth across a leaf that a bake makes opaque: it transmits 5e-5, and a bake makes no leaf
# denser.
OPAQUE_DEPTH = 10.0
_Values: TypeAlias = "mi.Float | NDArray[np.floating]"
# The arrays of a field, as `LeafField.arrays` names them.
LEAVES = ("cells", "levels", "log_density", "coefficients")


def padded_width(l_max: int) -> int:
    """Coefficients of a leaf, 3 · K padded to a multiple of 4."""
    return -(-3 * num_coefficients(l_max) // 4) * 4


class LeafField:
    """Leaves of one octree with trainable density and coefficients.

    Attributes:
        cells, levels: int64 [M, 3] and [M], where the leaves are.
        log_density: mi.Float [M], per local unit.
        coefficients: mi.Float [M · width], of the logits of emission: the 3 · K of a leaf follow
            one another, padded to `width`, a multiple of 4.
        octree: the tree over them.
    """

    def __init__(
        self,
        cells: NDArray[np.int64],
        levels: NDArray[np.int64],
        log_density: _Values,
        coefficients: _Values,
        *,
        tree_depth: int,
        l_max: int,
        law: Law,
        half_extents: NDArray[np.float64],
    ) -> None:
        self.cells, self.levels = cells, levels
        self.tree_depth, self.l_max = tree_depth, l_max
        self.law: Law = law
        if isinstance(log_density, np.ndarray):
            log_density = on_device(mi.Float, log_density)
        self.log_density, self.coefficients = log_density, self._padded(coefficients)
        self.half_extents = half_extents
        self.octree = Octree(build_children(cells, levels), tree_depth, half_extents)
        self._blocked = 0.0 if law == "linear" else BLOCKED

    def with_leaves(
        self,
        cells: NDArray[np.int64],
        levels: NDArray[np.int64],
        log_density: _Values,
        coefficients: _Values,
    ) -> LeafField:
        """A field of other leaves over the same proxy."""
        return LeafField(
            cells,
            levels,
            log_density,
            coefficients,
            tree_depth=self.tree_depth,
            l_max=self.l_max,
            law=self.law,
            half_extents=self.half_extents,
        )

    def copy(self) -> LeafField:
        """The field as it is now; later steps on this one do not change the copy."""
        # Device arrays are never changed in place here, only replaced.
        return copy.copy(self)

    @property
    def num_leaves(self) -> int:
        """Number of leaves, M."""
        return len(self.cells)

    @functools.cached_property
    def device_levels(self) -> mi.Float:
        """The levels [M]."""
        return on_device(mi.Float, self.levels)

    @functools.cached_property
    def neighbours(self) -> list[tuple[mi.UInt32, mi.Bool]]:
        """For each of the six faces the leaf beyond its centre [M], and whether there is one."""
        side = 1 << (self.tree_depth - self.levels)
        corner = self.cells * side[:, None]
        found = []
        for axis in range(3):
            for steps in (-1, side):
                cell = corner + (side // 2)[:, None]
                cell[:, axis] = corner[:, axis] + steps
                found.append(self.octree.leaf_at(on_device(mi.Vector3i, cell)))
        dr.eval(found)
        return found

    @property
    def width(self) -> int:
        """Coefficients of a leaf with their padding."""
        return padded_width(self.l_max)

    def coefficient_array(self) -> NDArray[np.float32]:
        """Coefficients [M, 3, K] without their padding."""
        count = num_coefficients(self.l_max)
        rows = np.array(self.coefficients).reshape(self.num_leaves, self.width)
        return rows[:, : 3 * count].reshape(-1, 3, count)

    def arrays(self) -> Arrays:
        """The arrays that `LEAVES` names, in the form that `with_leaves` takes."""
        values = self.cells, self.levels, np.array(self.log_density), self.coefficient_array()
        return dict(zip(LEAVES, values, strict=True))

    def set_coefficients(self, coefficients: NDArray[np.floating]) -> None:
        """Replace the coefficients by others [M, 3, K]."""
        self.coefficients = self._padded(coefficients)

    def smooth(self, share: float) -> None:
        """Regularise every leaf's coefficients towards the mean of its neighbours'.

        Args:
            share: part of the way to the mean, 0 to 1.
        """
        quads = self.width // 4
        row = dr.arange(mi.UInt32, quads * self.num_leaves)
        leaf = row // quads
        column = row - leaf * quads
        total, count = mi.Vector4f(0), mi.Float(0)
        for neighbours, present in self.neighbours:
            there = dr.gather(mi.Bool, present, leaf)
            other = dr.gather(mi.UInt32, neighbours, leaf) * quads + column
            total += dr.gather(mi.Vector4f, self.coefficients, other, there)
            count += dr.select(there, mi.Float(1), 0)
        before = dr.gather(mi.Vector4f, self.coefficients, row)
        strength = dr.select(count > 0, parameter(mi.Float, share), 0)
        self.coefficients = dr.ravel(before + strength * (total / dr.maximum(count, 1) - before))
        dr.eval(self.coefficients)

    def _padded(self, coefficients: _Values) -> mi.Float:
        if not isinstance(coefficients, np.ndarray):
            return coefficients
        count = 3 * num_coefficients(self.l_max)
        rows = coefficients.astype(np.float32).reshape(self.num_leaves, count)
        return on_device(mi.Float, np.pad(rows, ((0, 0), (0, self.width - rows.shape[1]))))

    def meets(self, origin: mi.Point3f, direction: mi.Vector3f) -> mi.Bool:
        """Whether the line of a ray crosses any leaf."""

        def visit(state, leaf, start, length, active):
            return (state[0] | active,), ~active

        return self.octree.traverse(origin, direction, mi.Bool(True), visit, (mi.Bool(False),))[0]

    def integrate(
        self, origin: mi.Point3f, direction: mi.Vector3f
    ) -> tuple[mi.Color3f, mi.Float, mi.Color3f]:
        """L / L_max, T, and Phi where the linear law saturates (else 0)."""
        y = basis(*towards_viewer(direction), l_max=self.l_max)

        def shade(state, leaf, start, length, active):
            radiance, tau, through, last = state
            _, tau, after = self.cross(tau, leaf, length, active)
            weight = through - after
            visible = active & (weight > MIN_WEIGHT)
            emission = self.emission(leaf, y, visible)
            radiance = dr.select(visible, radiance + weight * emission, radiance)
            if self.law == "linear":
                last = dr.select(visible & (after <= 0), emission, last)
            return radiance, tau, after, last

        state = (mi.Color3f(0), mi.Float(0), mi.Float(1), mi.Color3f(0))
        through, (radiance, _, _, last) = self.traverse(origin, direction, shade, state)
        return radiance, through, last

    def through(self, origin: mi.Point3f, direction: mi.Vector3f) -> mi.Float:
        """T of rays, without their radiance."""
        clear = mi.Float(0), mi.Float(1)
        return self.octree.traverse(origin, direction, mi.Bool(True), self._visit, clear)[1]

    def traverse(
        self, origin: mi.Point3f, direction: mi.Vector3f, shade: Any, shaded: Any
    ) -> tuple[Any, Any]:
        """T of rays, and the last state of `shade`.

        Visits leaves front to back, until the rest is blocked; see `Octree.traverse_and_shade`.
        """
        clear = mi.Float(0), mi.Float(1)
        (_, through), shaded = self.octree.traverse_and_shade(
            origin, direction, mi.Bool(True), self._visit, clear, shade, shaded
        )
        return through, shaded

    def _visit(self, state, leaf, start, length, active):
        _, tau, through = self.cross(state[0], leaf, length, active)
        return (tau, through), through > self._blocked

    def cross(
        self, tau: mi.Float, leaf: mi.UInt32, length: mi.Float, active: mi.Bool
    ) -> tuple[mi.Float, mi.Float, mi.Float]:
        """Optical depth of a leaf along a ray, and the ray's depth and transmittance after it.

        Args:
            tau: optical depth in front of the leaf.
            length: of the ray in the leaf, local units.
        """
        density = dr.exp(dr.gather(mi.Float, self.log_density, leaf, active))
        depth = dr.select(active, density * length, 0)
        tau = tau + depth
        return depth, tau, mi.Float(transmittance(tau, self.law, dr))

    def emission(self, leaf: mi.UInt32, y: list[mi.Float], active: mi.Bool) -> mi.Color3f:
        """Phi of a leaf; `y` are the harmonics of the direction towards the viewer."""
        count, quads = len(y), self.width // 4
        flat = []
        for quad in range(quads):
            # Four at a time take a third of the time of one by one.
            flat.extend(dr.gather(mi.Vector4f, self.coefficients, leaf * quads + quad, active))
        channels = []
        for channel in range(3):
            total = mi.Float(0)
            for k in range(count):
                total = dr.fma(flat[channel * count + k], y[k], total)
            channels.append(dr.rcp(1 + dr.exp(-total)))
        return mi.Color3f(*channels)


# Largest optical depth of a leaf in gradients, which bounds their sums. Leaves that a bake makes
# stay below √3 times `OPAQUE_DEPTH`; leaves of other assets may be denser.
_MAX_DEPTH = 32.0


def gradients(
    field: LeafField,
    origin: mi.Point3f,
    direction: mi.Vector3f,
    integrated: tuple[mi.Color3f, mi.Float, mi.Color3f],
    d_radiance: mi.Color3f,
    d_depth: mi.Float,
) -> tuple[mi.Float, mi.Float]:
    """The loss's derivatives by log density [M] and coefficients [M · width].

    With T = law(tau), L = Phi_1 + sum_i T_i (Phi_{i+1} - Phi_i), so that
    dL/ds_j = sum_{i >= j} law'(tau_i) (Phi_{i+1} - Phi_i):
    for the exponential law T_j Phi_j - (radiance from behind j), for the linear one
    Phi_j - Phi_k where leaf k saturates it (Phi_k = 0 where none does) and 0 from k on.

    Args:
        integrated: what `LeafField.integrate` returned for the same rays.
        d_radiance: dL of each ray, by L / L_max.
        d_depth: the loss's derivative by the optical depth of the whole ray.
    """
    y = basis(*towards_viewer(direction), l_max=field.l_max)
    total, _, last = integrated
    quads = field.width // 4
    # Differences of emission are at most 1, and harmonics of l <= 4 at most 0.85.
    bound = total_of(dr.width(origin), d_radiance, d_depth)
    by_density = ExactSum(field.num_leaves, _MAX_DEPTH * bound)
    by_coefficient = ExactSum(field.num_leaves * field.width, bound)

    def shade(state, leaf, start, length, active):
        seen, tau, through = state
        depth, tau, after = field.cross(tau, leaf, length, active)
        weight = through - after
        visible = active & (weight > MIN_WEIGHT)
        # Also for thin leaves: Adam follows the sign of the smallest gradient.
        emission = field.emission(leaf, y, active)
        seen = dr.select(visible, seen + weight * emission, seen)
        if field.law == "linear":
            slope = dr.select(after > 0, emission - last, 0)
        else:
            slope = after * emission - (total - seen)
        d_tau = dr.dot(d_radiance, slope) + d_depth
        by_density.add(d_tau * dr.minimum(depth, _MAX_DEPTH), leaf, active)
        by_emission = weight * d_radiance * emission * (1 - emission)
        flat = [by_emission[channel] * value for channel in range(3) for value in y]
        flat += [mi.Float(0)] * (-len(flat) % 4)
        for quad in range(quads):
            values = mi.Vector4f(*flat[4 * quad : 4 * quad + 4])
            by_coefficient.add(values, leaf * quads + quad, visible)
        return seen, tau, after

    field.traverse(origin, direction, shade, (mi.Color3f(0), mi.Float(0), mi.Float(1)))
    return by_density.values(), by_coefficient.values()


def depth_gradient(
    field: LeafField, origin: mi.Point3f, direction: mi.Vector3f, d_depth: mi.Float
) -> mi.Float:
    """The derivative by log density [M] of a loss that depends on T only."""
    by_density = ExactSum(field.num_leaves, _MAX_DEPTH * total_of(dr.width(origin), d_depth))

    def shade(state, leaf, start, length, active):
        depth, _, _ = field.cross(state[0], leaf, length, active)
        by_density.add(d_depth * dr.minimum(depth, _MAX_DEPTH), leaf, active)
        return state

    field.traverse(origin, direction, shade, (mi.Float(0),))
    return by_density.values()


def accumulate_by_weight(
    field: LeafField, origin: mi.Point3f, direction: mi.Vector3f, value: mi.Float
) -> mi.Float:
    """For each leaf [M] the sum over rays of its weight times their value."""
    total = ExactSum(field.num_leaves, total_of(dr.width(origin), value))

    def shade(state, leaf, start, length, active):
        _, tau, after = field.cross(state[0], leaf, length, active)
        total.add((state[1] - after) * value, leaf, active)
        return tau, after

    field.traverse(origin, direction, shade, (mi.Float(0), mi.Float(1)))
    return total.values()


def emission_moments(
    field: LeafField,
    origin: mi.Point3f,
    direction: mi.Vector3f,
    light: mi.Color3f,
    share: mi.Float,
    cell: mi.UInt32,
    harmonics: int,
) -> NDArray[np.float64]:
    """Moments of the emission of the leaves of each cell, for `calibration`.

    Args:
        light, share: of each ray.
        cell: [M], index of each leaf's cell, from 0 without gaps.
        harmonics: number of harmonics Y_k.

    Returns:
        [C, 3, ...] for each cell and channel the sums over rays and leaves of
        g (light - share) Y_k and of g (1 - Phi) share Y_j Y_k, lower triangle by rows.
    """
    y = basis(*towards_viewer(direction), l_max=field.l_max)
    first = y[:harmonics]
    products = [first[j] * first[k] for j in range(harmonics) for k in range(j + 1)]
    count = harmonics + len(products)
    quads = -(-count // 4)
    cells = int(dr.max(cell)[0]) + 1
    sums = ExactSum(cells * 3 * 4 * quads, total_of(dr.width(origin), light, share))

    def shade(state, leaf, start, length, active):
        _, tau, after = field.cross(state[0], leaf, length, active)
        emission = field.emission(leaf, y, active)
        row = 3 * dr.gather(mi.UInt32, cell, leaf, active)
        for channel in range(3):
            rest = 1 - emission[channel]
            slope = (state[1] - after) * emission[channel] * rest
            flat = [slope * (light[channel] - share) * value for value in first]
            flat += [slope * rest * share * value for value in products]
            flat += [mi.Float(0)] * (-count % 4)
            for quad in range(quads):
                values = mi.Vector4f(*flat[4 * quad : 4 * quad + 4])
                sums.add(values, (row + channel) * quads + quad, active)
        return tau, after

    field.traverse(origin, direction, shade, (mi.Float(0), mi.Float(1)))
    return np.array(sums.values(), np.float64).reshape(cells, 3, -1)[..., :count]
