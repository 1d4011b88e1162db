"""The demonstration's room with materials that all renderers have alike."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.geometry import AssetGeometry

_PLASTICS = ("plastic", "roughplastic")


def room_description(width: int) -> dict[str, Any]:
    """The room for `mitsuba.load_dict`.

    Models of plastics differ between renderers: diffuse surfaces take their place.

    Args:
        width: of the image, pixels.
    """
    from lumitree.rendering.demo_room import demo_room_description

    description = demo_room_description(width)
    for value in description.values():
        if isinstance(value, dict) and value.get("bsdf", {}).get("type") in _PLASTICS:
            diffuse = {"type": "diffuse", "reflectance": value["bsdf"]["diffuse_reflectance"]}
            value["bsdf"] = {"type": "twosided", "bsdf": diffuse}
    return description


def mitsuba_room(width: int) -> Any:
    """The room (mi.Scene)."""
    from lumitree.rendering.plugins.objects import load_ordered
    from lumitree.rendering.plugins.register import register

    register()
    return load_ordered(room_description(width))


def room_geometry() -> AssetGeometry:
    """Shapes and materials of the room, m, y up."""
    from lumitree.lamp.loading import load_luminaire
    from lumitree.lamp.stored_geometry import stored_geometry

    described = room_description(1)
    shapes = {
        name: value
        for name, value in described.items()
        if name not in ("sensor", "integrator", "type")
    }
    return stored_geometry(load_luminaire({"type": "scene", **shapes}))


def camera(width: int) -> dict[str, Any]:
    """The room's camera.

    Args:
        width: of the image, pixels.

    Returns:
        `origin` and `target` [3], m, y up; `fov`, the horizontal field of view, degrees; `width`
        and `height`, pixels.
    """
    described = room_description(width)["sensor"]
    matrix = np.array(described["to_world"].matrix, np.float64)
    origin, forward = matrix[:3, 3], matrix[:3, 2]
    return {
        "origin": origin.tolist(),
        "target": (origin + forward).tolist(),
        "fov": float(described["fov"]),
        "width": int(described["film"]["width"]),
        "height": int(described["film"]["height"]),
    }


def lamp_from_file(frame: Any) -> NDArray[np.float64]:
    """[4, 4] similarity from the frame of a luminaire's file to its place in the room.

    Args:
        frame: `LocalFrame` of the luminaire.
    """
    from lumitree.rendering.demo_room import LAMP_CENTRE, LAMP_SIZE

    return frame.placed(at=LAMP_CENTRE, size=LAMP_SIZE) @ frame.local_from_world
