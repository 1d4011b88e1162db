"""A diffuse room without other lights, the same in Cycles and in Mitsuba."""

import dataclasses
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.exports.blender import run_script

# Metres, y up. Walls by centre and two half edges, whose cross product points into the room.
WALLS: dict[str, dict[str, Any]] = {
    name: {"centre": centre, "first": first, "second": second, "reflectance": reflectance}
    for name, centre, first, second, reflectance in (
        ("floor", [0, 0, 0], [2, 0, 0], [0, 0, -2], [0.45, 0.34, 0.26]),
        ("ceiling", [0, 2.4, 0], [2, 0, 0], [0, 0, 2], [0.75, 0.75, 0.73]),
        ("back", [0, 1.2, -2], [2, 0, 0], [0, 1.2, 0], [0.62, 0.66, 0.62]),
        ("left", [-2, 1.2, 0], [0, 0, -2], [0, 1.2, 0], [0.65, 0.6, 0.55]),
        ("right", [2, 1.2, 0], [0, 0, 2], [0, 1.2, 0], [0.55, 0.6, 0.65]),
        ("near", [0, 1.2, 2], [-2, 0, 0], [0, 1.2, 0], [0.6, 0.6, 0.6]),
    )
}
CAMERA: dict[str, Any] = {"origin": [0.0, 1.35, 1.9], "target": [0, 1.3, 0], "fov": 70.0}
DIFFUSE_BOUNCES, OTHER_BOUNCES = 4, 32
_LIMIT = 1800.0


@dataclasses.dataclass(frozen=True)
class CyclesJob:
    """An image that Cycles renders.

    Attributes:
        lamp: script of the lamp.
        explicit: whether the lamp's own surfaces illuminate the room, without the lights.
        at: [3] where the origin of the lamp's file goes, m, y up.
        width, height: of the images, pixels.
        samples: a pixel.
        seeds: one image each.
        gain: of the lamp.
        scale: of the lamp, scene units in one of its file.
        room: script of another room, by `geometry_script`, in place of this one.
        walls: of the room, as `WALLS`.
        camera: `origin`, `target` and `fov` (horizontal, degrees), or, without `fov`, `width` (m)
            of an orthographic one.
        pixel_centres: whether a pixel shows its centre alone, and not the mean over its area.
        diffuse_bounces, bounces: largest numbers of diffuse bounces, and of all together.
        guiding: whether Cycles guides paths.
        warm_up: whether the scene is prepared first, and seconds are for the samples alone: the
            time of an image of one sample is subtracted. There are 2 samples at least.
    """

    lamp: str
    explicit: bool
    at: list[float]
    width: int
    height: int
    samples: int
    seeds: list[int]
    gain: float = 1.0
    scale: float = 1.0
    room: str | None = None
    walls: dict[str, dict[str, Any]] = dataclasses.field(default_factory=lambda: WALLS)
    camera: dict[str, Any] = dataclasses.field(default_factory=lambda: CAMERA)
    pixel_centres: bool = False
    diffuse_bounces: int = DIFFUSE_BOUNCES
    bounces: int = OTHER_BOUNCES
    guiding: bool = False
    warm_up: bool = False


@dataclasses.dataclass(frozen=True)
class Images:
    """Images of different seeds.

    Attributes:
        images: [N, H, W, 3] radiance, W/(m² sr).
        seconds, cpu_seconds: [N] wall and CPU time of each.
        samples: a pixel.
        version: of the renderer.
    """

    images: NDArray[np.floating]
    seconds: NDArray[np.float64]
    cpu_seconds: NDArray[np.float64]
    samples: int
    version: str


def render_cycles(program: str, job: CyclesJob) -> Images:
    """Render a job by the program of `find_blender`."""
    script = Path(__file__).with_name("room_script.py")
    with tempfile.TemporaryDirectory() as folder:
        members = dataclasses.asdict(job)
        facts = {**members, "folder": folder}
        path = Path(folder) / "job.json"
        path.write_text(json.dumps(facts), encoding="utf-8")
        result = Path(folder) / "result.npz"
        run_script(program, script, [str(path)], result, _LIMIT)
        with np.load(result) as found:
            return Images(
                images=found["images"],
                seconds=found["seconds"],
                cpu_seconds=found["cpu_seconds"],
                samples=job.samples,
                version=f"Blender {found['version']}",
            )


def mitsuba_walls(walls: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Shapes for `mitsuba.load_dict`, of walls as of `WALLS`."""
    import mitsuba as mi

    shapes: dict[str, Any] = {}
    for name, wall in walls.items():
        first, second = np.array(wall["first"]), np.array(wall["second"])
        normal = np.cross(first, second)
        matrix = np.eye(4)
        matrix[:3] = np.stack(
            [first, second, normal / np.linalg.norm(normal), wall["centre"]], axis=-1
        )
        reflectance = {"type": "rgb", "value": wall["reflectance"]}
        shapes[name] = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(matrix),
            "bsdf": {"type": "diffuse", "reflectance": reflectance},
        }
    return shapes
