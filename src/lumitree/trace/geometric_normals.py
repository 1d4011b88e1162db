"""The side of a surface that light is on, by its geometric normal.

BSDFs are defined by the shading normal, which differs from the geometric normal on a mesh that is
shaded smoothly. A direction that is above the surface by one normal may be below it by the other.
There an opaque BSDF would scatter light through the surface: a closed shade of few triangles
around a bulb would leak. So opaque BSDFs are 0 for pairs of directions on opposite sides of the
geometric surface, both where they are evaluated and where they are sampled. The rule is symmetric
in both directions, so light paths and camera paths agree.
"""

from typing import Any

import drjit as dr
import mitsuba as mi


def is_opaque(bsdf: Any) -> Any:
    """Whether no component of a mi.BSDF transmits, apart from null components (mi.Bool)."""
    return ~mi.has_flag(bsdf.flags(), mi.BSDFFlags.Transmission)


def on_opposite_sides(si: Any, arriving: Any, leaving: Any) -> Any:
    """Whether light that arrives at a surface and leaves it crosses the geometric surface.

    Args:
        si: mi.SurfaceInteraction3f.
        arriving: mi.Vector3f, direction of travel before the surface.
        leaving: mi.Vector3f, direction of travel after it.
    """
    return dr.dot(si.n, arriving) * dr.dot(si.n, leaving) >= 0
