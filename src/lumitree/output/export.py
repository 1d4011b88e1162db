"""Assets for other renderers."""

import dataclasses
import os
from importlib import resources
from pathlib import Path
from typing import Literal

from lumitree.asset.asset import Asset
from lumitree.core.arguments import check_choice, check_range
from lumitree.core.backend import load_rgb
from lumitree.core.files import FilePath, atomic_path, check_writable, write_bytes
from lumitree.core.results import Result
from lumitree.core.seeds import check_seed
from lumitree.core.stopwatch import Stopwatch
from lumitree.core.work_folder import scratch_folder
from lumitree.errors import LumitreeError, explained, shown
from lumitree.rendering.asset_cache import open_asset

_ENDINGS = (".py", ".blend", ".vdb")
# By measurement, see docs/decisions/blender.md.
DEFAULT_LIGHTS, MAX_LIGHTS = 16, 1024


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class ExportResult(Result):
    """Result of `export`.

    Attributes:
        luminaire: name of the luminaire.
        file: what was written.
        file_bytes: its size.
        lights: number of point lights.
        triangles: number of triangles of the lamp's own surfaces.
        not_carried_over: one line for each property of the lamp that Blender shows otherwise, or
            not at all.
    """

    luminaire: str
    file: Path
    file_bytes: int
    lights: int
    triangles: int
    not_carried_over: list[str]


@explained
def export(
    asset: Asset | FilePath,
    output: FilePath,
    *,
    lights: int = DEFAULT_LIGHTS,
    up: Literal["y", "z"] = "y",
    blender: FilePath | None = None,
    seed: int = 0,
) -> ExportResult:
    """Write an asset for Blender: point lights that illuminate, and the lamp's own surfaces.

    The light field becomes point lights, each with an intensity by direction; see
    `output.blender.lights`. The geometry is added so that cameras and mirrors show it, and neither
    illuminates nor casts shadows. All are children of one empty, whose transform and property
    "gain" apply to the lamp. The frame is that of the luminaire's file, with z up and lengths in
    metres.

    Args:
        asset: an asset, or the path of a `.lumitree` file, a photometric file or a ray file. It
            needs a light field, or a field for `.vdb`.
        output: path of the file to write. A `.py` file is a script that contains the lamp and runs
            in Blender 4.2 or newer; a `.blend` file is made by running it. A `.vdb` file has the
            field as OpenVDB grids instead (`density` and `emission`, see `output.blender.volume`);
            it needs the module `openvdb` of Blender 4.4 or newer.
        lights: largest number of point lights, 1 to 1,024.
        up: the axis that points up in the luminaire's file, "y" or "z".
        blender: program that makes `.blend` and `.vdb` files: Blender, or a Python with the module
            `bpy`. Default: `blender` on the search path, else this Python if it has `bpy`.
        seed: root seed of the clusters.

    Returns:
        Figures of the file, and what is not carried over.

    Raises:
        LumitreeError: an argument is out of range; the asset cannot be read, or lacks the part that
            is needed; the file cannot be written; or there is no Blender to write it, or it failed.
    """
    from lumitree.output.blender.blender import find_blender

    output = Path(output)
    if output.suffix not in _ENDINGS:
        raise LumitreeError(
            f"output {shown(repr(str(output)), 300)} does not end in {', '.join(_ENDINGS)}"
        )
    check_writable(output)
    if type(lights) is not int:
        raise LumitreeError(f"lights is {shown(lights, 40)}; expected a whole number")
    check_range("lights", lights, 1, MAX_LIGHTS)
    check_choice("up", up, ("y", "z"))
    check_seed(seed)
    program = None if output.suffix == ".py" else find_blender(blender)
    load_rgb()
    watch = Stopwatch()
    with watch.stage("load"):
        given = open_asset(asset)
        loaded = given.near_origin
    with watch.stage("write"):
        made = _volume(loaded, up) if output.suffix == ".vdb" else _lamp(loaded, lights, up, seed)
        with atomic_path(output) as temporary:
            if program is None:
                temporary.write_bytes(made.content)
            else:
                _run(program, made, temporary.resolve())
    lost = made.lost
    if loaded is not given:
        place = ", ".join(f"{each:.10g}" for each in given.frame.centre)
        lost = [*lost, f"the place of the lamp in its file, ({place}): it is moved to the origin"]
    return ExportResult(
        luminaire=loaded.luminaire,
        file=output,
        file_bytes=output.stat().st_size,
        lights=made.lights,
        triangles=made.triangles,
        not_carried_over=lost,
        **watch.costs(),
    )


@dataclasses.dataclass(frozen=True)
class _Made:
    """What is written, or run by Blender: a script, or the data of one."""

    content: bytes
    lost: list[str]
    lights: int = 0
    triangles: int = 0
    script: str | None = None


def _lamp(asset: Asset, lights: int, up: Literal["y", "z"], seed: int) -> _Made:
    from lumitree.output.blender.script import make_script

    made = make_script(asset, lights, up, seed)
    triangles = 0 if asset.geometry is None else asset.geometry.num_triangles
    return _Made(made.text.encode(), made.lost, made.lights, triangles)


def _volume(asset: Asset, up: Literal["y", "z"]) -> _Made:
    from lumitree.output.blender.script import Z_UP
    from lumitree.output.blender.volume import lost_in_volumes, pack_volume

    content = pack_volume(asset, Z_UP[up])
    return _Made(content, lost_in_volumes(asset), script="vdb_script.py")


def _run(program: str, made: _Made, output: Path) -> None:
    """Let Blender write a file."""
    from lumitree.output.blender.blender import run_script

    with scratch_folder() as folder:
        content = folder / "content"
        write_bytes(content, made.content)
        if made.script is None:
            run_script(program, content, [os.fspath(output)])
            return
        script = resources.files("lumitree.output.blender") / made.script
        with resources.as_file(script) as path:
            run_script(program, path, [os.fspath(content), os.fspath(output)])
