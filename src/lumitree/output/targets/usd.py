"""OpenUSD: a layer with lights, surfaces and photometric files beside it, or one package."""

from pathlib import Path

from lumitree.core.files import FilePath, scratch_folder
from lumitree.errors import LumitreeError, shown
from lumitree.output.ies_profiles import LOST_COLOUR, ProfiledLight, profiled_lights
from lumitree.output.orientation import turn_up
from lumitree.output.pbr_meshes import LOST_GLOW, LOST_SHADOWS, Surface, surfaces_of
from lumitree.output.point_lights import place_lights
from lumitree.output.targets.target import (
    LOST_IN_BLENDER,
    ExportRequest,
    Target,
    Written,
    blender_spots,
    file_orientation,
)
from lumitree.output.usd.library import load_usd
from lumitree.output.usd.stage import GLOW, HIDDEN, LampStage

_LOST_PROFILES = (
    "lights emit the same in all directions: a package may hold no photometric files; write .usda "
    "for them"
)
_UNITS = (
    "metres; luminance in cd/m² (683 times W/(m² sr)), so a light of the intensity 4 has a mean "
    "of 1 cd"
)


def _write_stage(request: ExportRequest, folder: Path) -> Written:
    if request.importer == "blender":
        return _write_spots(request, folder, request.name)
    stage = LampStage(load_usd(), folder, request.name, request.stem, request.asset, _UNITS)
    surfaces, lights, lost = _contents(request)
    return _written(surfaces, lights, [*lost, *stage.write_layers(surfaces, lights)])


def _write_package(request: ExportRequest, folder: Path) -> Written:
    """A package, which holds layers and images only, as its specification has it."""
    pxr = load_usd()
    with scratch_folder() as scratch:
        name = f"{request.stem}.usdc"
        if request.importer == "blender":
            written = _write_spots(request, scratch, name)
        else:
            stage = LampStage(pxr, scratch, name, request.stem, request.asset, _UNITS)
            surfaces, lights, lost = _contents(request)
            lost += stage.write_layer(surfaces, lights)
            written = _written(surfaces, lights, [_LOST_PROFILES, *lost])
        given = pxr.Sdf.AssetPath(str(scratch / name))
        if not pxr.UsdUtils.CreateNewUsdzPackage(given, str(folder / request.name), name):
            raise LumitreeError(f"OpenUSD did not write the package {shown(request.name, 200)}")
    return written


def _write_spots(request: ExportRequest, folder: Path, name: str) -> Written:
    spots, written = blender_spots(request)
    stage = LampStage(load_usd(), folder, name, request.stem, request.asset, written.units)
    stage.write_layer([], spots)
    return written


def _contents(
    request: ExportRequest,
) -> tuple[list[Surface], list[ProfiledLight], list[str]]:
    """Surfaces and lights in the frame of the stage, and what surfaces lack."""
    turn = turn_up(request.up, "y")
    placed = place_lights(request.asset, turn, request.lights, request.seed)
    surfaces, lost = surfaces_of(request.asset, turn)
    return surfaces, profiled_lights(placed, request.asset.luminaire), lost


def _written(surfaces: list[Surface], lights: list[ProfiledLight], lost: list[str]) -> Written:
    lost = [LOST_IN_BLENDER, LOST_COLOUR, *sorted(set(lost))]
    if surfaces:
        lost.append(LOST_SHADOWS)
    if any(not surface.material.emission.is_black for surface in surfaces):
        lost.append(f"{LOST_GLOW}: choose the variant {HIDDEN} of {GLOW} of the lamp there")
    return Written(
        units=_UNITS,
        orientation=file_orientation("y"),
        not_carried_over=lost,
        lights=len(lights),
        triangles=sum(len(surface.mesh["faces"]) for surface in surfaces),
    )


def _check(_: FilePath | None) -> None:
    load_usd()


STAGE = Target(name="OpenUSD", write=_write_stage, importers=True, check=_check)
PACKAGE = Target(name="USDZ", write=_write_package, importers=True, check=_check)
