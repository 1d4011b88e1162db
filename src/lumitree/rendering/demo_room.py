"""The demonstration's room, built in code: a lamp before a window, over a table."""

from typing import Any

import mitsuba as mi

from lumitree.rendering.objects import load_ordered
from lumitree.rendering.placement import Placement
from lumitree.rendering.register import register

LAMP_CENTRE = (0.0, 1.72, 0.0)
LAMP_SIZE = 0.9
# Above the bulbs, in the upper part of the lamp's box, which ends at y = 2.17.
BALL_CENTRE, BALL_RADIUS = (0.33, 1.96, -0.26), 0.08


def lamp(source: str) -> Placement:
    """Where the lamp hangs; the top of its bounding box stays under the ceiling."""
    return Placement(source, at=LAMP_CENTRE, size=LAMP_SIZE)


def demo_room(width: int = 320, *, ball_in_box: bool = False) -> Any:
    """The scene (mi.Scene) of `demo_room_description`; arguments as there."""
    register()
    return load_ordered(demo_room_description(width, ball_in_box=ball_in_box))


def demo_room_description(width: int = 320, *, ball_in_box: bool = False) -> dict[str, object]:
    """Room of 4 x 2.4 x 4 metres, y up, with a lit window behind the lamp (an area light).

    Through the gaps of the lamp the window shows; its light throws the lamp's shadow. With
    `ball_in_box` a ball hangs from the ceiling into the lamp's bounding box.
    """
    to = mi.ScalarTransform4f

    def wall(point: list[float], rotate: tuple[list[float], float], scale: list[float]) -> Any:
        return to().translate(point).rotate(*rotate).scale([*scale, 1])

    walls = {
        "floor": (wall([0, 0, 0], ([1, 0, 0], -90), [2, 2]), _matte(0.45, 0.34, 0.26)),
        "ceiling": (wall([0, 2.4, 0], ([1, 0, 0], 90), [2, 2]), _matte(0.75, 0.75, 0.73)),
        "back": (wall([0, 1.2, -2], ([0, 1, 0], 0), [2, 1.2]), _matte(0.62, 0.66, 0.62)),
        "left": (wall([-2, 1.2, 0], ([0, 1, 0], 90), [2, 1.2]), _matte(0.65, 0.6, 0.55)),
        "right": (wall([2, 1.2, 0], ([0, 1, 0], -90), [2, 1.2]), _matte(0.55, 0.6, 0.65)),
        "near": (wall([0, 1.2, 2], ([0, 1, 0], 180), [2, 1.2]), _matte(0.6, 0.6, 0.6)),
    }
    scene: dict[str, object] = {
        name: {"type": "rectangle", "to_world": place, "bsdf": bsdf}
        for name, (place, bsdf) in walls.items()
    }
    scene |= _furniture()
    if ball_in_box:
        scene |= _hanging_ball()
    for index, x in enumerate((-0.36, 0.36)):
        scene[f"window_{index}"] = {
            "type": "rectangle",
            "to_world": wall([x, 1.5, -1.99], ([0, 1, 0], 0), [0.33, 0.5]),
            "bsdf": _matte(0.0, 0.0, 0.0),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [0.5, 0.7, 1.0]}},
        }
    scene["sensor"] = {
        "type": "perspective",
        "fov": 58,
        "to_world": to().look_at([0.35, 1.35, 1.9], [0, 1.4, 0], [0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": width * 3 // 4,
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent"},
    }
    scene["integrator"] = {"type": "lumitree_path", "max_depth": 12}
    return {"type": "scene", **scene}


def _furniture() -> dict[str, object]:
    return {
        "table": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().translate([0, 0.7, 0]).scale([0.6, 0.03, 0.45]),
            "bsdf": {
                "type": "roughplastic",
                "alpha": 0.12,
                "diffuse_reflectance": {"type": "rgb", "value": [0.32, 0.16, 0.08]},
            },
        },
        "leg": {
            "type": "cylinder",
            "p0": [0, 0, 0],
            "p1": [0, 0.68, 0],
            "radius": 0.06,
            "bsdf": _matte(0.1, 0.1, 0.1),
        },
        "vase": {
            "type": "sphere",
            "center": [0.25, 0.84, 0.1],
            "radius": 0.11,
            "bsdf": {
                "type": "plastic",
                "diffuse_reflectance": {"type": "rgb", "value": [0.1, 0.3, 0.5]},
            },
        },
    }


def _hanging_ball() -> dict[str, object]:
    x, y, z = BALL_CENTRE
    return {
        "ball": {
            "type": "sphere",
            "center": [x, y, z],
            "radius": BALL_RADIUS,
            "bsdf": {
                "type": "plastic",
                "diffuse_reflectance": {"type": "rgb", "value": [0.7, 0.25, 0.15]},
            },
        },
        "cord": {
            "type": "cylinder",
            "p0": [x, y, z],
            "p1": [x, 2.4, z],
            "radius": 0.004,
            "bsdf": _matte(0.1, 0.1, 0.1),
        },
    }


def _matte(*rgb: float) -> dict[str, object]:
    reflectance = {"type": "rgb", "value": list(rgb)}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
