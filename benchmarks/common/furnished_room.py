"""A furnished room of equal bays, which may be large."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Side of a bay, and height of the room, m.
BAY, HEIGHT = 3.0, 2.8
# Corners of the boxes of a bay, m, by material; y is up.
BOXES = {
    "desk": [
        [[0.8, 0.71, 1.1], [2.3, 0.74, 1.9]],
        [[0.8, 0.0, 1.1], [0.84, 0.71, 1.9]],
        [[2.26, 0.0, 1.1], [2.3, 0.71, 1.9]],
    ],
    "screen": [[[0.7, 0.0, 1.95], [2.4, 1.4, 1.99]]],
    "cupboard": [[[0.1, 0.0, 2.5], [1.3, 1.9, 2.95]]],
}


def furniture(columns: int, rows: int) -> dict[str, NDArray[np.float64]]:
    """Boxes [B, 2, 3] of the bays by material, as corners."""
    found: dict[str, list[NDArray[np.float64]]] = {name: [] for name in BOXES}
    for i in range(columns):
        for j in range(rows):
            for name, boxes in BOXES.items():
                # Every second bay has a cupboard.
                if name != "cupboard" or (i + j) % 2:
                    found[name].append(boxes + np.array([i * BAY, 0, j * BAY]))
    return {name: np.concatenate(each) for name, each in found.items() if each}


def box_mesh(boxes: NDArray[np.float64], bsdf: Any) -> Any:
    """A mesh (mi.Mesh) of boxes [B, 2, 3]."""
    import mitsuba as mi

    from lumitree.core.mitsuba_meshes import make_mesh

    corners = np.array([[(k >> a) & 1 for a in range(3)] for k in range(8)])
    points = boxes[:, corners, np.arange(3)].reshape(-1, 3)
    quads = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    faces = np.array([(q[0], *q[k : k + 2]) for q in quads for k in (1, 2)])
    faces = (8 * np.arange(len(boxes))[:, None, None] + faces).reshape(-1, 3)
    properties = mi.Properties()
    properties["mesh_bsdf"] = bsdf
    return make_mesh("boxes", {"vertices": points, "faces": faces}, properties)


def furnished_room(columns: int, rows: int, width: int) -> Any:
    """A furnished room (mi.Scene) of some bays; y is up."""
    import mitsuba as mi

    from lumitree.rendering.objects import load_ordered
    from lumitree.rendering.register import register

    register()
    x, z = columns * BAY, rows * BAY
    to = mi.ScalarTransform4f

    def wall(point: list[float], axis: list[float], angle: float, *half: float) -> Any:
        return to().translate(point).rotate(axis, angle).scale([*half, 1])

    walls = {
        "floor": (wall([x / 2, 0, z / 2], [1, 0, 0], -90, x / 2, z / 2), (0.45, 0.34, 0.26)),
        "ceiling": (wall([x / 2, HEIGHT, z / 2], [1, 0, 0], 90, x / 2, z / 2), (0.75, 0.75, 0.73)),
        "back": (wall([x / 2, HEIGHT / 2, 0], [0, 1, 0], 0, x / 2, HEIGHT / 2), (0.6, 0.65, 0.6)),
        "near": (wall([x / 2, HEIGHT / 2, z], [0, 1, 0], 180, x / 2, HEIGHT / 2), (0.6, 0.6, 0.6)),
        "left": (wall([0, HEIGHT / 2, z / 2], [0, 1, 0], 90, z / 2, HEIGHT / 2), (0.65, 0.6, 0.5)),
        "right": (wall([x, HEIGHT / 2, z / 2], [0, 1, 0], -90, z / 2, HEIGHT / 2), (0.5, 0.6, 0.6)),
    }
    scene: dict[str, Any] = {
        name: {"type": "rectangle", "to_world": place, "bsdf": matte(*colour)}
        for name, (place, colour) in walls.items()
    }
    brown = {"type": "rgb", "value": [0.32, 0.16, 0.08]}
    bsdfs = {
        "desk": {"type": "roughplastic", "alpha": 0.12, "diffuse_reflectance": brown},
        "screen": matte(0.3, 0.4, 0.5),
        "cupboard": matte(0.6, 0.6, 0.55),
    }
    for name, boxes in furniture(columns, rows).items():
        scene[name] = box_mesh(boxes, mi.load_dict(bsdfs[name]))
    film = {"type": "hdrfilm", "width": width, "height": width * 3 // 4, "rfilter": {"type": "box"}}
    look = to().look_at([0.2, 1.7, 0.2], [x, 0.9, z], [0, 1, 0])
    scene["sensor"] = {"type": "perspective", "fov": 75, "to_world": look, "film": film}
    return load_ordered({"type": "scene", **scene})


def matte(*rgb: float) -> dict[str, Any]:
    """A two-sided diffuse BSDF."""
    reflectance = {"type": "rgb", "value": list(rgb)}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
