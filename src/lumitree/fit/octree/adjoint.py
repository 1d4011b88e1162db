"""The adjoint of `LeafField.integrate`: derivatives, and sums by leaf over many rays.

Each function traverses the rays a second time. Symbols are as in `leaf_field`, and

    dL          derivative of the loss by L
    g           w Phi (1 - Phi), derivative of w Phi by the logit of Phi
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.frames import towards_viewer
from lumitree.core.harmonics import basis
from lumitree.fit.octree.leaf_field import MIN_WEIGHT, LeafField
from lumitree.fit.octree.sums import ExactSum, total_of

# Largest optical depth of a leaf in gradients, which bounds their sums. Leaves that a bake makes
# stay below √3 times `OPAQUE_DEPTH`; those of assets made otherwise may be denser.
_MAX_DEPTH = 32.0


def gradients(
    field: LeafField,
    origin: Any,
    direction: Any,
    integrated: tuple[Any, Any, Any],
    d_radiance: Any,
    d_depth: Any,
) -> tuple[Any, Any]:
    """The loss's derivatives by log density (mi.Float [M]) and coefficients (mi.Float [M · width]).

    With T = law(tau), L = Phi_1 + sum_i T_i (Phi_{i+1} - Phi_i), so that
    dL/ds_j = sum_{i >= j} law'(tau_i) (Phi_{i+1} - Phi_i):
    for the exponential law T_j Phi_j - (radiance from behind j), for the linear one
    Phi_j - Phi_k where leaf k saturates it (Phi_k = 0 where none does) and 0 from k on.

    Args:
        integrated: what `LeafField.integrate` returned for the same rays.
        d_radiance: dL of each ray (mi.Color3f, by L / L_max).
        d_depth: the loss's derivative by the optical depth of the whole ray (mi.Float).
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


def depth_gradient(field: LeafField, origin: Any, direction: Any, d_depth: Any) -> Any:
    """The derivative by log density (mi.Float [M]) of a loss that depends on T alone."""
    by_density = ExactSum(field.num_leaves, _MAX_DEPTH * total_of(dr.width(origin), d_depth))

    def shade(state, leaf, start, length, active):
        depth, _, _ = field.cross(state[0], leaf, length, active)
        by_density.add(d_depth * dr.minimum(depth, _MAX_DEPTH), leaf, active)
        return state

    field.traverse(origin, direction, shade, (mi.Float(0),))
    return by_density.values()


def accumulate_by_weight(field: LeafField, origin: Any, direction: Any, value: Any) -> Any:
    """For each leaf the sum over rays of its weight times their value, mi.Float (mi.Float [M])."""
    total = ExactSum(field.num_leaves, total_of(dr.width(origin), value))

    def shade(state, leaf, start, length, active):
        _, tau, after = field.cross(state[0], leaf, length, active)
        total.add((state[1] - after) * value, leaf, active)
        return tau, after

    field.traverse(origin, direction, shade, (mi.Float(0), mi.Float(1)))
    return total.values()


def emission_moments(
    field: LeafField,
    origin: Any,
    direction: Any,
    light: Any,
    share: Any,
    cell: Any,
    harmonics: int,
) -> NDArray[np.float64]:
    """Moments of the emission of the leaves of each cell, for `calibration`.

    Args:
        light: mi.Color3f of each ray.
        share: mi.Float of each ray.
        cell: mi.UInt32 [M], index of each leaf's cell; none is left out.
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
