"""The rays that a radiance field emits, from its leaves.

A leaf is sampled by its emission, a direction uniformly, and a line through the leaf uniformly over
its projected area A. The leaf adds Φ (T₀ - T₁) to the radiance of the line, with the transmittances
T₀ and T₁ from both ends of the leaf to the border of the box. So the ray has the flux
4π A Φ (T₀ - T₁) / p.

Symbols
    M       leaves
    Φ       radiance of a leaf        p   probability with which it is sampled
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
from lumitree.rendering.sampling import face_areas, point_on_box, safe_inverse, slab

# Random directions in which the emission of a leaf is evaluated.
_DIRECTIONS = 16
# Part of the samples that is the same for all leaves.
_EVEN_PART = 0.05


class FieldRays:
    """Samples rays of a field that has leaves; `data` are its arrays."""

    def __init__(self, field: Field, data: FieldData) -> None:
        self._field, self._is_linear = field, data.law == "linear"
        half = data.frame.half_extents
        # Parts inside the box; others get an area of 0.
        boxes = boxes_inside(half, *leaf_cells(data.children, data.num_leaves))
        lower, upper = (np.clip(each, -half, half) for each in boxes)
        size, density = upper - lower, data.density.astype(np.float64)
        x, y, z = size.T
        area = 2 * (x * y + y * z + z * x)
        mean_length = 4 * x * y * z / np.maximum(area, 1e-30)
        leaf = dr.arange(mi.UInt32, data.num_leaves * _DIRECTIONS) // _DIRECTIONS
        random = mi.PCG32(dr.width(leaf))
        sample = mi.Point2f(random.next_float32(), random.next_float32())
        emission = field.leaf_emission(leaf, mi.warp.square_to_uniform_sphere(sample))
        strength = np.array(dr.block_sum(dr.sum(emission), _DIRECTIONS), np.float64)
        strength *= area * -np.expm1(-density * mean_length)
        strength += _EVEN_PART * strength.mean() + 1e-300
        self._table = AliasTable.of(strength[None])
        # Two packets of four numbers: middle and density; half of the sides.
        packets = (lower + upper) / 2, density, size / 2, np.zeros(len(size))
        self._leaves = on_device(mi.Float, np.column_stack(packets))

    def sample_ray(
        self,
        choice: mi.Float,
        sample1: mi.Point2f,
        sample2: mi.Point2f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Color3f]:
        """As `DeviceLight.sample_ray`; rays start where most of the leaf's light starts."""
        leaf, pmf = self._table.sample(mi.UInt32(0), choice, active)
        first, second = (dr.gather(mi.Vector4f, self._leaves, 2 * leaf + i, active) for i in (0, 1))
        middle, half = (
            mi.Point3f(first.x, first.y, first.z),
            mi.Vector3f(second.x, second.y, second.z),
        )
        density, direction = first.w, mi.warp.square_to_uniform_sphere(sample1)
        areas = face_areas(half) * dr.abs(direction)
        end = mi.Point3f(point_on_box(half, areas, direction, sample2))
        near, _ = slab(-mi.Vector3f(end), half, safe_inverse(direction))
        length = dr.maximum(-dr.max(near), 0)
        depth = density * length
        span = mi.Float(0), mi.Float(dr.inf)
        through = self._field.transmittance(middle + end, direction, active, span)
        if self._is_linear:
            through = dr.minimum(through, depth)
        else:
            through *= 1 - dr.exp(-depth)
        emitted = self._field.leaf_emission(leaf, -direction, active)
        flux = emitted * (4 * math.pi * dr.sum(areas) * through / pmf)
        back = dr.minimum(length, dr.rcp(dr.maximum(density, 1e-6))) / 2
        # Leaves outside the box have no area.
        valid = active & (dr.max(flux) > 0)
        point = mi.Point3f(middle + dr.select(valid, end - back * direction, 0))
        return point, direction, dr.select(valid, flux, 0)
