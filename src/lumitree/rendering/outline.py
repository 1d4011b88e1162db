"""The luminous opening of a photometric file as images show it, in its true outline.

Cells of a light field would show it in steps. The radiance in a direction is the intensity of all
cells over the projected area of the opening.

Symbols
    h   half extents of the lamp's box, which the opening fills        ω   direction of travel
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import LightField, Outline, unpack
from lumitree.core.device import on_device, parameter
from lumitree.rendering.device_light import bins_around
from lumitree.rendering.sampling import face_areas, safe_inverse, slab


class LuminousOutline:
    """The opening of a light field that has one, on the device.

    Args:
        half_extents: [3] of the lamp's box, local units.
        factors: [3] factors on R, G and B of its light.
    """

    def __init__(
        self,
        field: LightField,
        outline: Outline,
        half_extents: NDArray[np.float64],
        factors: tuple[float, float, float],
    ) -> None:
        total = field.dense(field.scale * unpack(field.intensity)).sum(axis=0)
        self._intensity = on_device(mi.Float, total * np.array(factors))
        self._resolution = field.resolution
        self._half = parameter(mi.Vector3f, *half_extents.tolist())
        self._shape, _, axis = outline.partition("-")
        # Along the axis of a cylinder, and across it.
        along = "xyz".index(axis or "y")
        self._order = along, (along + 1) % 3, (along + 2) % 3

    def radiance(
        self, origin: mi.Point3f, direction: mi.Vector3f, active: mi.Bool | bool
    ) -> mi.Color3f:
        """Radiance along lines, by a point and the unit direction away from the eye."""
        active = active & self._hit(origin, direction)
        light = mi.Color3f(0)
        for index, weight in bins_around(-direction, self._resolution):
            light += weight * dr.gather(mi.Color3f, self._intensity, index, active)
        return dr.select(active, light / self._projected_area(direction), 0)

    def _hit(self, origin: mi.Point3f, direction: mi.Vector3f) -> mi.Bool:
        # In the frame in which the box is [-1, 1]³.
        o, d = mi.Vector3f(origin) / self._half, direction / self._half
        if self._shape == "ellipsoid":
            return dr.squared_norm(dr.cross(o, d)) <= dr.squared_norm(d)
        near, far = slab(-o, mi.Vector3f(1), safe_inverse(d))
        if self._shape == "box":
            return dr.max(near) <= dr.min(far)
        along, first, second = self._order
        squared = dr.square(d[first]) + dr.square(d[second])
        inverse = dr.rcp(dr.maximum(squared, 1e-20))
        middle = -(o[first] * d[first] + o[second] * d[second]) * inverse
        across = o[first] * d[second] - o[second] * d[first]
        reach = dr.safe_sqrt(squared - dr.square(across)) * inverse
        crosses = dr.square(across) <= squared
        return crosses & (
            dr.maximum(middle - reach, near[along]) <= dr.minimum(middle + reach, far[along])
        )

    def _projected_area(self, direction: mi.Vector3f) -> mi.Float:
        """As `formats.opening.Opening.projected_area`, local units."""
        h, d = self._half, dr.abs(direction)
        faces = face_areas(h) / 4
        if self._shape == "box":
            return 4 * dr.dot(faces, d)
        if self._shape == "ellipsoid":
            return math.pi * dr.norm(faces * d)
        along, first, second = self._order
        side = dr.norm(mi.Vector2f(h[first] * d[second], h[second] * d[first]))
        return math.pi * faces[along] * d[along] + 4 * h[along] * side
