"""The demonstration's room with materials that all renderers have alike."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.geometry import AssetGeometry
from lumitree.core.photometry import flux_from_radiance, luminance

_PLASTICS = ("plastic", "roughplastic")
# Luminous flux of the window over the lamp's: lamps of files may have any unit of power.
_WINDOW_SHARE = 0.5


@dataclasses.dataclass(frozen=True)
class Room:
    """The room of one lamp.

    Models of plastics differ between renderers: diffuse surfaces take their place. The window
    emits half of the luminous flux of the lamp.

    Args:
        width: of the image, pixels.
        watts: flux [3] of the lamp in the room, W.
    """

    width: int
    watts: Sequence[float]

    def described(self) -> dict[str, Any]:
        """The room for `mitsuba.load_dict`."""
        from lumitree.rendering.demo_room import demo_room_description

        description = demo_room_description(self.width)
        shapes = [value for value in description.values() if isinstance(value, dict)]
        for shape in shapes:
            if shape.get("bsdf", {}).get("type") in _PLASTICS:
                diffuse = {"type": "diffuse", "reflectance": shape["bsdf"]["diffuse_reflectance"]}
                shape["bsdf"] = {"type": "twosided", "bsdf": diffuse}
        windows = [shape for shape in shapes if "emitter" in shape]
        factor = _WINDOW_SHARE * float(luminance(self.watts)) / sum(map(_lumens, windows))
        for window in windows:
            radiance = window["emitter"]["radiance"]
            radiance["value"] = [factor * each for each in radiance["value"]]
        return description

    def mitsuba(self) -> Any:
        """The room (mi.Scene)."""
        from lumitree.rendering.objects import load_ordered
        from lumitree.rendering.register import register

        register()
        return load_ordered(self.described())

    def geometry(self) -> AssetGeometry:
        """Shapes and materials of the room, m, y up."""
        from lumitree.lamp.luminaire import load_luminaire
        from lumitree.lamp.stored_geometry import stored_geometry

        shapes = {
            name: value
            for name, value in self.described().items()
            if name not in ("sensor", "integrator", "type")
        }
        return stored_geometry(load_luminaire({"type": "scene", **shapes}))

    def camera(self) -> dict[str, Any]:
        """The room's camera.

        Returns:
            `origin` and `target` [3], m, y up; `fov`, the horizontal field of view, degrees;
            `width` and `height`, pixels.
        """
        described = self.described()["sensor"]
        matrix = np.array(described["to_world"].matrix, np.float64)
        origin, forward = matrix[:3, 3], matrix[:3, 2]
        return {
            "origin": origin.tolist(),
            "target": (origin + forward).tolist(),
            "fov": float(described["fov"]),
            "width": int(described["film"]["width"]),
            "height": int(described["film"]["height"]),
        }


def _lumens(rectangle: dict[str, Any]) -> float:
    """Luminous flux of a rectangle that emits on one side, lm."""
    first, second = np.array(rectangle["to_world"].matrix, np.float64)[:3, :2].T
    area = 4 * float(np.linalg.norm(np.cross(first, second)))
    return flux_from_radiance(rectangle["emitter"]["radiance"]["value"], area)


def lamp_from_file(frame: Any) -> NDArray[np.float64]:
    """[4, 4] similarity from the frame of a luminaire's file to its place in the room.

    Args:
        frame: `LocalFrame` of the luminaire.
    """
    from lumitree.rendering.demo_room import LAMP_CENTRE, LAMP_SIZE

    return frame.placed(at=LAMP_CENTRE, size=LAMP_SIZE) @ frame.local_from_world
