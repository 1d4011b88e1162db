"""Rays that leave surfaces: where they start, on which side, and whether they were transmitted.

Mitsuba starts a ray 9e-5 (1 + |p|) away from the surface point p. Where a lamp is small, or far
from the origin, that is no longer small beside it: 0.9 units at a coordinate of 10,000. A lamp of
glass or of opal, in metres, emits up to 6 % too much light, because rays skip a part of it.
Meshes and rectangles are hit with an error of a few units in the last place, so rays leave them
from as near; curved shapes and instances, whose hits are less precise, keep Mitsuba's distance.

BSDFs are defined by the shading normal, which differs from the geometric normal on a mesh that is
shaded smoothly. A direction that is above the surface by one normal may be below it by the other.
There an opaque BSDF would scatter light through the surface: a closed shade of few triangles
around a bulb would leak. So opaque BSDFs are 0 for pairs of directions on opposite sides of the
geometric surface, both where they are evaluated and where they are sampled. The rule is symmetric
in both directions, so light paths and camera paths agree.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from lumitree.core.device import parameter

# Distance of a ray's origin from a flat surface, relative to the coordinates. An interpolated hit
# is off by at most 7 √3 · 2⁻²⁴ of them (Pharr et al., Physically Based Rendering, section 6.8).
_FLAT_OFFSET = 2.0**-20


def scene_box(scene: mi.Scene) -> mi.BoundingBox3f:
    """Bounding box of a scene, on the device."""
    box = scene.bbox()
    return mi.BoundingBox3f(*(parameter(mi.Point3f, *each) for each in (box.min, box.max)))


def scene_extent(scene: mi.Scene) -> mi.Float:
    """Half the diagonal of the bounding box of a scene."""
    box = scene.bbox()
    return parameter(mi.Float, float(dr.norm(box.extents())) / 2 if box.valid() else 0.0)


def offset(si: mi.SurfaceInteraction3f, extent: mi.Float) -> mi.Float:
    """Distance from a surface at which a ray leaves it; `extent` is `scene_extent`."""
    coordinate = dr.max(dr.abs(si.p))
    standard = (1 + coordinate) * mi.math.RayEpsilon
    flat = dr.minimum(standard, (coordinate + extent) * _FLAT_OFFSET)
    precise = si.shape.is_mesh() & (si.instance == None)  # noqa: E711 (a vector comparison)
    return dr.select(precise, flat, standard)


def spawn(si: mi.SurfaceInteraction3f, direction: mi.Vector3f, extent: mi.Float) -> mi.Ray3f:
    """Ray from a surface, on the side of it that the direction points to."""
    distance = dr.mulsign(offset(si, extent), dr.dot(si.n, direction))
    return mi.Ray3f(dr.fma(distance, si.n, si.p), direction, si.time, si.wavelengths)


def is_opaque(bsdf: mi.BSDF | mi.BSDFPtr) -> mi.Bool:
    """Whether no component of a BSDF transmits, apart from null components."""
    return ~mi.has_flag(bsdf.flags(), mi.BSDFFlags.Transmission)


def on_opposite_sides(
    si: mi.SurfaceInteraction3f, arriving: mi.Vector3f, leaving: mi.Vector3f
) -> mi.Bool:
    """Whether light that arrives at a surface and leaves it crosses the geometric surface.

    Args:
        arriving, leaving: direction of travel before and after the surface.
    """
    return dr.dot(si.n, arriving) * dr.dot(si.n, leaving) >= 0


def is_smooth(sampled_type: mi.UInt32) -> mi.Bool:
    """Whether an interaction of this mi.BSDFFlags type lets light pass without spreading it."""
    return mi.has_flag(sampled_type, mi.BSDFFlags.DeltaTransmission) | mi.has_flag(
        sampled_type, mi.BSDFFlags.Null
    )


def is_transmitted(sampled_type: mi.UInt32) -> mi.Bool:
    """Whether an interaction of this mi.BSDFFlags type lets light pass."""
    return mi.has_flag(sampled_type, mi.BSDFFlags.Transmission) | mi.has_flag(
        sampled_type, mi.BSDFFlags.Null
    )
