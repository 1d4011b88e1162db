"""Rays that leave surfaces, from nearer to them than Mitsuba's.

Mitsuba starts a ray 9e-5 (1 + |p|) away from the surface point p. Where a lamp is small, or far
from the origin, that is no longer small beside it: 0.9 units at a coordinate of 10,000. A lamp of
glass or of opal, in metres, emits up to 6 % too much light, because rays leave out a part of it.
Meshes and rectangles are hit with an error of a few units in the last place, so rays leave them
from as near; curved shapes and instances, whose hits are less precise, keep Mitsuba's distance.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.core.device import parameter

# Distance of a ray's origin from a flat surface, relative to the coordinates. An interpolated hit
# is off by at most 7 √3 · 2⁻²⁴ of them (Pharr et al., Physically Based Rendering, section 6.8).
_FLAT_OFFSET = 2.0**-20


def scene_box(scene: Any) -> Any:
    """Bounding box of a mi.Scene (mi.BoundingBox3f), on the device."""
    box = scene.bbox()
    return mi.BoundingBox3f(*(parameter(mi.Point3f, *each) for each in (box.min, box.max)))


def scene_extent(scene: Any) -> Any:
    """Half the diagonal of the bounding box of a mi.Scene (mi.Float)."""
    box = scene.bbox()
    return parameter(mi.Float, float(dr.norm(box.extents())) / 2 if box.valid() else 0.0)


def offset(si: Any, extent: Any) -> Any:
    """Distance (mi.Float) from a surface at which a ray leaves it.

    Args:
        si: mi.SurfaceInteraction3f.
        extent: `scene_extent`.
    """
    coordinate = dr.max(dr.abs(si.p))
    standard = (1 + coordinate) * mi.math.RayEpsilon
    flat = dr.minimum(standard, (coordinate + extent) * _FLAT_OFFSET)
    precise = si.shape.is_mesh() & (si.instance == None)  # noqa: E711 (a vector comparison)
    return dr.select(precise, flat, standard)


def spawn(si: Any, direction: Any, extent: Any) -> Any:
    """mi.Ray3f from a surface, on the side of it that the direction points to."""
    distance = dr.mulsign(offset(si, extent), dr.dot(si.n, direction))
    return mi.Ray3f(dr.fma(distance, si.n, si.p), direction, si.time, si.wavelengths)
