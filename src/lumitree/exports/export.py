"""Assets for other renderers."""

import dataclasses
import os
from pathlib import Path
from typing import Literal

from lumitree.asset.asset import Asset
from lumitree.core.arguments import check_choice, check_count, metres_of
from lumitree.core.backend import in_turn, load_rgb
from lumitree.core.files import (
    FilePath,
    atomic_files,
    atomic_folder,
    check_new_folder,
    check_writable,
)
from lumitree.core.results import Result, Stopwatch
from lumitree.core.seeds import check_seed
from lumitree.errors import LumitreeError, shown
from lumitree.exports import blender, gltf, ies_folder, pbrt, radiance, usd
from lumitree.exports.target import ExportRequest, Importer, Target
from lumitree.rendering.asset_cache import open_asset, refuse_frame

# By measurement, see docs/decisions/other-programs.md.
DEFAULT_LIGHTS, MAX_LIGHTS = 16, 1024
# A folder has no suffix.
TARGETS: dict[str, Target] = {
    ".py": blender.SCRIPT,
    ".blend": blender.BLEND,
    ".rad": radiance.TARGET,
    ".pbrt": pbrt.TARGET,
    ".usda": usd.STAGE,
    ".usdz": usd.PACKAGE,
    ".glb": gltf.TARGET,
    "": ies_folder.TARGET,
}


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class ExportResult(Result):
    """Result of `export`.

    Attributes:
        luminaire: name of the luminaire.
        target: the program or the format that it was written for.
        file: what was written: the file to open, or the folder.
        files: all files that were written.
        file_bytes: the size of all of them.
        lights: number of point lights.
        triangles: number of triangles of the lamp's surfaces.
        units: one line: the units of lengths and of light.
        orientation: one line: the axis that points up, and where the origin is.
        not_carried_over: one line for each property of the lamp that the other program shows
            otherwise, or not at all.
    """

    luminaire: str
    target: str
    file: Path
    files: list[Path]
    file_bytes: int
    lights: int
    triangles: int
    units: str
    orientation: str
    not_carried_over: list[str]


@in_turn
def export(
    asset: Asset | FilePath,
    output: FilePath,
    *,
    lights: int = DEFAULT_LIGHTS,
    unit: float | str = "m",
    up: Literal["y", "z"] = "y",
    blender: FilePath | None = None,
    importer: Importer = "any",
    seed: int = 0,
) -> ExportResult:
    """Write an asset for another program: as point lights, for some with the lamp's surfaces.

    The light field becomes point lights, each with an intensity by direction; see
    `exports.point_lights`. Blender, OpenUSD and glTF get the lamp's surfaces, too. Lengths are in
    metres. The suffix of `output` chooses the program:

    * `.py`: a script that contains the lamp and runs in Blender 4.2 or newer. The geometry is added
      so that cameras and mirrors show it, and neither illuminates nor casts shadows. All are
      children of one empty, whose transform and custom properties apply to the lamp.
    * `.blend`: the file that this script makes.
    * `.rad`: a scene of Radiance, with a folder of function and data files.
    * `.pbrt`: a scene of pbrt-v4 to include, with a folder of images.
    * `.usda`: a layer of OpenUSD with the lights. The surfaces, the images, and an IES profile for
      each light are in a folder. It needs the package `usd-core` (the extra `usd`).
    * `.usdz`: the same as one package, in which lights have no profiles.
    * `.glb`: binary glTF, with lights of EXT_lights_ies and KHR_lights_punctual.
    * a folder, that is a name without a suffix or with a slash at its end: an IES file for each
      light, and a table of their places, for all other programs.

    Args:
        asset: an asset, or the path of a `.lumitree` file, a photometric file or a ray file. It
            needs a light field.
        output: path of the file to write, whose further files are in the folder NAME_files beside
            it; or of a folder that is new or empty.
        lights: largest number of point lights, 1 to 1,024.
        unit: unit of length of the luminaire's Mitsuba scene: "m", "cm", "mm", "in", "ft", or the
            metres in a unit. Models and photometric files are in metres once they are baked.
        up: the axis that points up in the luminaire's Mitsuba scene, "y" or "z"; models and
            photometric files have y up once they are baked. The lamp is turned to the axis
            up of the program (`ExportResult.orientation`).
        blender: program that makes `.blend` files: Blender, or a Python with the module
            `bpy`. Default: `blender` on the search path, else this Python if it has `bpy`.
        importer: for `.glb`, `.usda` and `.usdz`, the program that reads the file. "blender" writes
            no surfaces, and lights as spots without profiles, of which Blender's importer makes the
            illumination of `.py`; "any" (default) writes what the format's specification means.
        seed: root seed of the clusters.

    Returns:
        The files, their units and orientation, and what is not carried over.

    Raises:
        LumitreeError: an argument is out of range; the asset cannot be read, or lacks the part that
            is needed; the files cannot be written; or there is no Blender to write one, or it
            failed.
    """
    target = find_target(output)
    output = Path(output)
    (check_new_folder if target.is_folder else check_writable)(output)
    check_count("lights", lights, 1, MAX_LIGHTS)
    check_choice("up", up, ("y", "z"))
    check_choice("importer", importer, ("any", "blender"))
    if importer == "blender" and not target.importers:
        raise LumitreeError(
            f"the importer blender is for .glb, .usda and .usdz, and the output is for "
            f"{target.name}; leave the importer out"
        )
    metres = metres_of(unit)
    check_seed(seed)
    if target.check is not None:
        target.check(blender)
    load_rgb()
    watch = Stopwatch()
    with watch.stage("load"):
        given = open_asset(asset)
        if given.is_photometric:
            refuse_frame(asset, metres, up)
        near = given.near_origin
        loaded = near if metres == 1 else near.scaled(metres)
    request = ExportRequest(
        asset=loaded,
        lights=lights,
        up=up,
        seed=seed,
        blender=blender,
        importer=importer,
        name=output.name,
    )
    writing = atomic_folder if target.is_folder else atomic_files
    with watch.stage("write"), writing(output) as folder:
        written = target.write(request, folder)
        names = sorted(each.relative_to(folder) for each in folder.rglob("*") if each.is_file())
    files = [(output if target.is_folder else output.parent) / name for name in names]
    lost = written.not_carried_over
    if near is not given:
        place = ", ".join(f"{each:.10g}" for each in given.frame.centre)
        lost = [*lost, f"the place of the lamp in its file, ({place}): it is moved to the origin"]
    return ExportResult(
        luminaire=loaded.luminaire,
        target=target.name,
        file=output,
        files=files,
        file_bytes=sum(each.stat().st_size for each in files),
        lights=written.lights,
        triangles=written.triangles,
        units=written.units or target.units,
        orientation=f"{target.up} is up; the origin is the origin of the lamp's file{target.note}",
        not_carried_over=lost,
        **watch.costs(),
    )


def find_target(output: FilePath) -> Target:
    """The target of an output: by its suffix, or for folders if a slash is at its end.

    Raises:
        LumitreeError: there is none.
    """
    text = os.fspath(output)
    suffix = "" if text.endswith(("/", os.sep)) else Path(text).suffix.lower()
    if suffix not in TARGETS:
        raise LumitreeError(
            f"output {shown(repr(text), 300)} does not end in {', '.join(filter(None, TARGETS))}, "
            "and is not a folder (a name without an ending, or with a / at its end)"
        )
    return TARGETS[suffix]
