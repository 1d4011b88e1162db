"""glTF: one binary file with the lamp's lights and surfaces."""

from pathlib import Path

from lumitree.output.gltf.lamp import lamp_glb
from lumitree.output.ies_profiles import LOST_COLOUR, profiled_lights
from lumitree.output.orientation import turn_up
from lumitree.output.pbr_meshes import LOST_GLOW, surfaces_of
from lumitree.output.point_lights import place_lights
from lumitree.output.targets.target import (
    LOST_IN_BLENDER,
    ExportRequest,
    Target,
    Written,
    blender_spots,
    file_orientation,
)

_UNITS = "metres; cd and cd/m² (683 times W/sr and W/(m² sr))"
_LOST_DIRECTIONS = (
    "programs without EXT_lights_ies show lights that emit the same in all directions; programs "
    "that add these to those of EXT_lights_ies show twice the light"
)
_LOST_SHADOW_LINKS = (
    "the lamp's surfaces shade its own lights, which have that shade already; where the program "
    "can, let the surfaces cast no shadows"
)


def _write(request: ExportRequest, folder: Path) -> Written:
    if request.importer == "blender":
        spots, written = blender_spots(request)
        (folder / request.name).write_bytes(lamp_glb(request.asset, spots, [])[0])
        return written
    turn = turn_up(request.up, "y")
    placed = place_lights(request.asset, turn, request.lights, request.seed)
    lights = profiled_lights(placed, request.asset.luminaire)
    surfaces, lost = surfaces_of(request.asset, turn)
    content, more = lamp_glb(request.asset, lights, surfaces)
    (folder / request.name).write_bytes(content)
    if surfaces:
        lost = [_LOST_SHADOW_LINKS, *sorted({*lost, *more})]
    if any(not surface.material.emission.is_black for surface in surfaces):
        lost.append(LOST_GLOW)
    return Written(
        units=_UNITS,
        orientation=file_orientation("y"),
        not_carried_over=[LOST_IN_BLENDER, _LOST_DIRECTIONS, LOST_COLOUR, *lost],
        lights=len(lights),
        triangles=sum(len(surface.mesh["faces"]) for surface in surfaces),
    )


TARGET = Target(name="glTF", write=_write, importers=True)
