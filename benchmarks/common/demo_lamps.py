"""Lamps in the demonstration's room, an emissive sphere in their place, and pixels beside them."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Rays of a pixel, a side, that tell whether it shows diffuse surfaces alone.
STRATA = 4


def placed(what: Any, width: int, room: Any = None, **options: Any) -> Any:
    """The room (mi.Scene) with a luminaire or an asset in it.

    Args:
        what: source of a `Placement`.
        width: of the image, pixels.
        room: mi.Scene in place of the demonstration's room; its image keeps its own width.
        options: of `place_luminaires`.
    """
    from lumitree.rendering.demo_room import LAMP_CENTRE, LAMP_SIZE, demo_room
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire, place_luminaires

    room = demo_room(width) if room is None else room
    lamp = Placement(what, at=LAMP_CENTRE, size=LAMP_SIZE)
    return place_luminaires(room, [PlacedLuminaire(lamp)], **options)


def flux_in_room(asset: Any) -> NDArray[np.float64]:
    """Flux [3] of an asset's light field where `placed` puts it."""
    from lumitree.rendering.asset_flux import light_field_watts
    from lumitree.rendering.demo_room import LAMP_SIZE

    scale = LAMP_SIZE / (2 * float(asset.frame.half_extents.max()))
    return light_field_watts(asset.light_field) * asset.light_factors * scale**2


def sphere_room(asset: Any, width: int, room: Any = None) -> Any:
    """The room with a sphere that emits the same flux, evenly; `room` as for `placed`.

    Its radius is the geometric mean of the half extents of the lamp's box.
    """
    import mitsuba as mi

    from lumitree.rendering.demo_room import LAMP_CENTRE, LAMP_SIZE, demo_room

    half = asset.frame.half_extents
    radius = float(half.prod() ** (1 / 3)) * LAMP_SIZE / (2 * float(half.max()))
    radiance = flux_in_room(asset) / (4 * math.pi**2 * radius**2)
    room = demo_room(width) if room is None else room
    objects: dict[str, Any] = {f"shape_{i}": shape for i, shape in enumerate(room.shapes())}
    objects |= {
        "sensor": room.sensors()[0],
        "lamp": {
            "type": "sphere",
            "center": list(LAMP_CENTRE),
            "radius": radius,
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance.tolist()}},
        },
    }
    return mi.load_dict({"type": "scene", **objects})


def shows_diffuse(asset: Any, width: int, room: Any = None) -> NDArray[np.bool_]:
    """Mask [H, W] of the pixels that show diffuse surfaces alone; `room` as for `placed`."""
    import drjit as dr
    import mitsuba as mi

    from lumitree.core.device import on_device
    from lumitree.rendering.demo_room import LAMP_CENTRE, LAMP_SIZE, demo_room
    from lumitree.rendering.sampling import safe_inverse, slab

    room = demo_room(width) if room is None else room
    sensor = room.sensors()[0]
    width, height = sensor.film().size()
    steps = [np.arange(n * STRATA) for n in (height, width)]
    y, x = np.meshgrid(*((step + 0.5) / len(step) for step in steps), indexing="ij")
    position = on_device(mi.Point2f, np.stack([x.ravel(), y.ravel()], axis=1))
    ray, _ = sensor.sample_ray(0, 0.5, position, mi.Point2f(0.5))
    si = room.ray_intersect(ray)
    flags = si.bsdf().flags()
    other = mi.BSDFFlags.Glossy | mi.BSDFFlags.Delta
    half = asset.frame.half_extents * LAMP_SIZE / (2 * float(asset.frame.half_extents.max()))
    delta = mi.Vector3f(mi.Point3f(*LAMP_CENTRE) - ray.o)
    near, far = slab(delta, mi.Vector3f(*half.tolist()), safe_inverse(ray.d))
    meets_lamp = (dr.max(near) <= dr.min(far)) & (dr.max(near) < si.t)
    good = ~meets_lamp & ((flags & other) == 0) & ~si.shape.is_emitter()
    shape = height, STRATA, width, STRATA
    return np.asarray(np.array(good).reshape(shape).all(axis=(1, 3)), np.bool_)
