"""A diffuse room of boxes, as a scene of Mitsuba and as one of Radiance. Metres, y up."""

import dataclasses
import itertools
from typing import Any

import numpy as np

SIDES = (4.0, 2.8, 3.0)
_THICKNESS = 0.1


@dataclasses.dataclass(frozen=True)
class Box:
    """A diffuse, grey box.

    Attributes:
        lower, upper: [3] corners.
        reflectance: of all its faces.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    reflectance: float


def walls(floor: float, sides: float, ceiling: float) -> list[Box]:
    """Six slabs around a room of `SIDES`, whose floor is centred at the origin.

    Args:
        floor, sides, ceiling: reflectances.
    """
    x, y, z, t = SIDES[0] / 2, SIDES[1], SIDES[2] / 2, _THICKNESS
    return [
        Box((-x - t, -t, -z - t), (x + t, 0, z + t), floor),
        Box((-x - t, y, -z - t), (x + t, y + t, z + t), ceiling),
        Box((-x - t, 0, -z - t), (-x, y, z + t), sides),
        Box((x, 0, -z - t), (x + t, y, z + t), sides),
        Box((-x, 0, -z - t), (x, y, -z), sides),
        Box((-x, 0, z), (x, y, z + t), sides),
    ]


def furniture() -> list[Box]:
    """A table with four legs and a set of shelves at a wall."""
    boxes = [Box((-0.9, 0.71, -0.45), (0.5, 0.75, 0.35), 0.4)]
    for x, z in itertools.product((-0.85, 0.41), (-0.41, 0.27)):
        boxes.append(Box((x, 0, z), (x + 0.04, 0.71, z + 0.04), 0.3))
    for height in (0.1, 0.6, 1.1, 1.6):
        boxes.append(Box((1.6, height, -1.0), (2.0, height + 0.03, 0.4), 0.5))
    for z in (-1.03, 0.4):
        boxes.append(Box((1.6, 0, z), (2.0, 1.7, z + 0.03), 0.5))
    return boxes


def mitsuba_scene(boxes: list[Box]) -> Any:
    """mi.Scene of the boxes."""
    import mitsuba as mi

    return mi.load_dict({"type": "scene", **mitsuba_shapes(boxes)})


def mitsuba_shapes(boxes: list[Box]) -> dict[str, Any]:
    """The boxes as entries of a dictionary for `mitsuba.load_dict`."""
    import mitsuba as mi

    shapes = {}
    for index, box in enumerate(boxes):
        lower, upper = np.array(box.lower), np.array(box.upper)
        placed = mi.ScalarTransform4f().translate(((lower + upper) / 2).tolist())
        shapes[f"box_{index}"] = {
            "type": "cube",
            "to_world": placed.scale(((upper - lower) / 2).tolist()),
            "bsdf": {
                "type": "diffuse",
                "reflectance": {"type": "rgb", "value": box.reflectance},
            },
        }
    return shapes


def radiance_text(boxes: list[Box], name: str = "room") -> str:
    """The boxes as a scene of Radiance; all names in it begin with `name`."""
    lines = []
    for index, box in enumerate(boxes):
        (x0, y0, z0), (x1, y1, z1) = box.lower, box.upper
        grey = " ".join([f"{box.reflectance:.9g}"] * 3)
        lines.append(f"void plastic {name}_{index}_grey 0 0 5 {grey} 0 0")
        # By two corners along (x, -z, y).
        low, high = (x0, -z1, y0), (x1, -z0, y1)
        for axis, side in itertools.product(range(3), (low, high)):
            corners = []
            for first, second in ((low, low), (high, low), (high, high), (low, high)):
                corner = list(side)
                others = [each for each in range(3) if each != axis]
                corner[others[0]], corner[others[1]] = first[others[0]], second[others[1]]
                corners += [f"{each:.9g}" for each in corner]
            face = f"{name}_{index}_{axis}_{int(side is high)}"
            lines.append(f"{name}_{index}_grey polygon {face} 0 0 12 {' '.join(corners)}")
    return "\n".join(lines) + "\n"
