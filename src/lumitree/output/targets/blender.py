"""Blender: a script that contains the lamp, and a file that the script makes."""

from pathlib import Path

from lumitree.core.files import scratch_folder
from lumitree.output.blender.blender import find_blender, run_script
from lumitree.output.blender.script import make_script
from lumitree.output.targets.target import ExportRequest, Target, Written, file_orientation

_UNITS = "metres; one watt of a light is one watt of each of R, G and B"


def _write_script(request: ExportRequest, folder: Path) -> Written:
    made = make_script(request.asset, request.lights, request.up, request.seed)
    (folder / request.name).write_bytes(made.text.encode())
    return Written(
        units=_UNITS,
        orientation=file_orientation("z"),
        not_carried_over=made.lost,
        lights=made.lights,
        triangles=request.triangles,
    )


def _write_blend(request: ExportRequest, folder: Path) -> Written:
    program = find_blender(request.blender)
    with scratch_folder() as scratch:
        written = _write_script(request, scratch)
        output = (folder / request.name).resolve()
        run_script(program, scratch / request.name, [str(output)], output)
    return written


SCRIPT = Target(name="Blender", write=_write_script)
BLEND = Target(name="Blender", write=_write_blend, check=find_blender)
