"""The rays that a radiance field emits, from points of its leaves.

A leaf is sampled by its emission, a point of it uniformly, and a direction uniformly. The light of
the point is attenuated on its way out of the box.

Symbols
    M       leaves
    Φ, σ    radiance and density of a leaf
    τ, T    optical depth from the point to the border of the box, and transmittance
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.alias_table import AliasTable
from lumitree.core.device import on_device
from lumitree.octree.build import boxes_inside, leaf_cells
from lumitree.octree.field import Field, FieldData
from lumitree.rendering.sampling import scrambled

# Random directions in which the emission of a leaf is evaluated, and the optical depth of a leaf
# beyond which it is not sampled more often: only its surface emits.
_DIRECTIONS, _OPAQUE = 16, 4.0
# Part of the samples that is the same for all leaves.
_EVEN_PART = 0.05


class FieldRays:
    """Samples rays of a field that has leaves; `data` are its arrays."""

    def __init__(self, field: Field, data: FieldData) -> None:
        self._field, self._is_linear = field, data.law == "linear"
        cells, levels = leaf_cells(data.children, data.num_leaves)
        half = data.frame.half_extents
        # Parts inside the box; others get a volume of 0.
        lower, upper = (np.clip(each, -half, half) for each in boxes_inside(half, cells, levels))
        size = upper - lower
        density = data.density.astype(np.float64)
        strength = size.prod(axis=1) * np.minimum(density, _OPAQUE * (1 << levels) / 2)
        leaf = dr.arange(mi.UInt32, data.num_leaves * _DIRECTIONS) // _DIRECTIONS
        random = mi.PCG32(dr.width(leaf))
        sample = mi.Point2f(random.next_float32(), random.next_float32())
        emission = field.leaf_emission(leaf, mi.warp.square_to_uniform_sphere(sample))
        strength *= np.array(dr.block_sum(dr.sum(emission), _DIRECTIONS), np.float64)
        strength += _EVEN_PART * strength.mean() + 1e-300
        self._table = AliasTable([strength[None]], (1, len(strength)))
        # Two packets of four numbers: corner, and V σ; sides.
        light = size.prod(axis=1) * density
        packets = lower, light, size, np.zeros(len(size))
        self._leaves = on_device(mi.Float, np.column_stack(packets))

    def sample_ray(
        self,
        choice: mi.Float,
        sample1: mi.Point2f,
        sample2: mi.Point2f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Color3f]:
        """As `DeviceLight.sample_ray`; the mean of 4π V σ Φ |dT/dτ| / p is the flux."""
        leaf, pmf = self._table.sample(mi.UInt32(0), choice, active)
        first, second = (dr.gather(mi.Vector4f, self._leaves, 2 * leaf + i, active) for i in (0, 1))
        corner, size = (
            mi.Point3f(first.x, first.y, first.z),
            mi.Vector3f(second.x, second.y, second.z),
        )
        point = dr.fma(size, scrambled(sample2), corner)
        direction = mi.warp.square_to_uniform_sphere(sample1)
        emitted = self._field.leaf_emission(leaf, -direction, active)
        span = mi.Float(0), mi.Float(dr.inf)
        through = self._field.transmittance(point, direction, active, span)
        if self._is_linear:
            through = dr.select(through > 0, mi.Float(1), 0)
        flux = emitted * (4 * math.pi * first.w * through / pmf)
        return mi.Point3f(point), direction, dr.select(active, flux, 0)
