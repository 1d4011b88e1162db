"""OpenVDB: the field as voxels, which Blender writes."""

from importlib import resources
from pathlib import Path

from lumitree.core.files import write_bytes
from lumitree.core.work_folder import scratch_folder
from lumitree.output.blender.blender import find_blender, run_script
from lumitree.output.blender.volume import lost_in_volumes, pack_volume
from lumitree.output.orientation import turn_up
from lumitree.output.targets.target import ExportRequest, Target, Written, file_orientation


def _write(request: ExportRequest, folder: Path) -> Written:
    content = pack_volume(request.asset, turn_up(request.up, "z"))
    program = find_blender(request.blender)
    script = resources.files("lumitree.output.blender") / "vdb_script.py"
    with scratch_folder() as scratch, resources.as_file(script) as path:
        write_bytes(scratch / "content", content)
        output = (folder / request.name).resolve()
        run_script(program, path, [str(scratch / "content"), str(output)], output)
    return Written(
        units="metres; density in 1/m, emission in W/(m³ sr) of each of R, G and B",
        orientation=file_orientation("z"),
        not_carried_over=lost_in_volumes(request.asset),
    )


TARGET = Target(name="OpenVDB", write=_write)
