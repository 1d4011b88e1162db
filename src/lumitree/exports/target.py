"""The request to a target of `lumitree export`, and its result."""

import dataclasses
import hashlib
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from lumitree.asset.asset import Asset
from lumitree.core.files import FilePath
from lumitree.exports.light_profiles import Spot, spots_of
from lumitree.exports.point_lights import Up, place_lights, turn_up

Importer = Literal["any", "blender"]
LOST_IN_BLENDER = (
    "Blender's importer makes other light of it: write .py or .blend for Blender, or give the "
    "importer blender"
)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ExportRequest:
    """The asset to export, and the settings of the export.

    Attributes:
        asset: the asset, near the origin of its file.
        up: the axis that points up in the luminaire's file.
        blender: the program that the user named to run scripts of Blender, or None.
        importer: the program that reads the file, if it needs other values than the format's.
        name: file name of the output, without folders; other files have names derived from it.
    """

    asset: Asset
    lights: int
    up: Up
    seed: int
    blender: FilePath | None
    importer: Importer
    name: str

    @property
    def stem(self) -> str:
        """The name without its suffix, of letters, digits, `_`, `.` and `-`, for other files.

        Where others are replaced, with a digest: two names do not become one.
        """
        stem = Path(self.name).stem
        plain = re.sub(r"[^\w.-]", "_", stem, flags=re.ASCII)
        if plain == stem:
            return stem
        return f"{plain}-{hashlib.sha256(os.fsencode(stem)).hexdigest()[:8]}"

    @property
    def triangles(self) -> int:
        """Number of triangles of the asset's geometry, 0 without one."""
        return 0 if self.asset.geometry is None else self.asset.geometry.num_triangles


@dataclasses.dataclass(frozen=True, kw_only=True)
class Written:
    """The output of a target.

    Attributes:
        units: one line: the units of lengths and of light.
        orientation: one line: the axis that points up, and where the origin is.
        not_carried_over: one line for each property of the lamp that the program shows otherwise,
            or not at all.
        lights: number of point lights.
        triangles: number of triangles of the lamp's own surfaces.
    """

    units: str
    orientation: str
    not_carried_over: list[str]
    lights: int = 0
    triangles: int = 0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Target:
    """A program, or a kind of file, that assets are written for.

    Attributes:
        name: of the program or the format.
        write: writes all files into an empty folder. The file with the name `ExportRequest.name`
            is the one to open; a target that is a folder writes files of any names.
        is_folder: whether the output is a folder.
        importers: whether Blender's importer of the format needs values of its own.
        check: refuses, before any work, what cannot be written with the program that the user
            named in `ExportRequest.blender`.
    """

    name: str
    write: Callable[[ExportRequest, Path], Written]
    is_folder: bool = False
    importers: bool = False
    check: Callable[[FilePath | None], object] | None = None


def blender_spots(request: ExportRequest) -> tuple[list[Spot], Written]:
    """The lights with y up that Blender's importers of glTF and OpenUSD turn into the lamp's."""
    turn = turn_up(request.up, "y")
    spots = spots_of(place_lights(request.asset, turn, request.lights, request.seed))
    return spots, Written(
        units="metres; Blender's importer makes W of each of R, G and B",
        orientation=file_orientation("y"),
        not_carried_over=[
            "the lamp's surfaces: they would illuminate and cast shadows a second time",
            "each light is the sum of spots that is nearest to its intensity, with one colour",
        ],
        lights=len(spots),
    )


def file_orientation(up: str) -> str:
    """The line `Written.orientation` of targets that keep the origin of the luminaire's file."""
    return f"{up} is up; the origin is that of the lamp's file"
