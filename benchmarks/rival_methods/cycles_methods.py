"""The methods of Cycles: the explicit lamp, without and with path guiding, and the export."""

import dataclasses
import functools
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.cycles.room import CyclesJob, render_cycles
from benchmarks.equal_error.batches import digest
from benchmarks.rival_methods.method import PATH_DEPTH, Method, TimedImage
from benchmarks.rival_methods.room import Room, lamp_from_file
from lumitree.core.frames import similarity_scale

# Path guiding learns in each image anew.
_SAMPLES, _GUIDED_SAMPLES = 16, 32


class CyclesRenderer:
    """Renders the lamp in the room.

    Args:
        program: from `find_blender`.
        scripts: text of the scripts of the lamp and of the room.
        job: what is rendered, but for the scripts, the samples and the seeds.
    """

    def __init__(self, program: str, scripts: tuple[str, str], job: CyclesJob) -> None:
        self._program, self._scripts, self._job = program, scripts, job

    def images(self, samples: int, seeds: Sequence[int]) -> Iterator[TimedImage]:
        """As `Renderer.images`."""
        with tempfile.TemporaryDirectory() as folder:
            paths = [Path(folder) / name for name in ("lamp.py", "room.py")]
            for path, text in zip(paths, self._scripts, strict=True):
                path.write_text(text, encoding="utf-8")
            lamp, room = map(str, paths)
            job = dataclasses.replace(
                self._job, lamp=lamp, room=room, samples=samples, seeds=list(seeds)
            )
            found = render_cycles(self._program, job)
        for index, image in enumerate(found.images):
            wall, cpu = (float(each[index]) for each in (found.seconds, found.cpu_seconds))
            yield TimedImage(image, {"wall": wall, "cpu": cpu})


def cycles_methods(luminaire: Any, asset: Any, room: Room, program: str) -> list[Method]:
    """The methods for a lamp.

    Args:
        luminaire: `Luminaire`.
        asset: its bake, with a light field and geometry.
        room: where it hangs.
        program: Blender, or a Python with the module bpy.
    """
    from lumitree.exports.blender import find_blender, geometry_script, make_script
    from lumitree.exports.target import ExportRequest

    program = find_blender(program)
    lamp = make_script(ExportRequest(asset=asset, lights=_LIGHTS, up="y"))
    scripts = lamp.text, geometry_script(room.geometry(), "room", "y").text
    matrix, view = lamp_from_file(luminaire.frame), room.camera()
    base = CyclesJob(
        lamp="",
        explicit=True,
        at=matrix[:3, 3].tolist(),
        scale=similarity_scale(matrix, "placement"),
        width=view["width"],
        height=view["height"],
        samples=_SAMPLES,
        seeds=[],
        camera=view,
        diffuse_bounces=PATH_DEPTH,
        bounces=PATH_DEPTH,
        warm_up=True,
    )
    exported = dataclasses.replace(base, explicit=False)
    guided = dataclasses.replace(base, guiding=True)
    lost = tuple(line for line in lamp.lost if "media" in line)
    method = functools.partial(
        Method, key={"scripts": digest(list(scripts))}, first_samples=_SAMPLES
    )
    return [
        method("cycles", "Cycles", CyclesRenderer(program, scripts, base), lost=lost),
        method(
            "cycles-guided",
            "Cycles, path guiding",
            CyclesRenderer(program, scripts, guided),
            first_samples=_GUIDED_SAMPLES,
            lost=lost,
        ),
        method(
            "cycles-export",
            f"Cycles, our export ({lamp.lights} lights)",
            CyclesRenderer(program, scripts, exported),
        ),
    ]


# Point lights of the export.
_LIGHTS = 16
