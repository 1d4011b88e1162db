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
from lumitree.exports.point_lights import PlacedLights, Up, place_lights, turn_up

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
        name: file name of the output, without folders.
    """

    asset: Asset
    lights: int
    up: Up
    seed: int = 0
    blender: FilePath | None = None
    importer: Importer = "any"
    name: str = "lamp"

    @property
    def stem(self) -> str:
        """The name without its suffix, of letters, digits, `_`, `.` and `-`.

        Where others are replaced, with a digest: two names do not become one.
        """
        stem = Path(self.name).stem
        plain = re.sub(r"[^\w.-]", "_", stem, flags=re.ASCII)
        if plain == stem:
            return stem
        return f"{plain}-{hashlib.sha256(os.fsencode(stem)).hexdigest()[:8]}"

    @property
    def side_folder(self) -> str:
        """Name of the folder of all other files, beside the output."""
        return f"{self.stem}_files"

    def place(self, up: Up) -> PlacedLights:
        """The point lights in a frame with this axis up."""
        return place_lights(self.asset, turn_up(self.up, up), self.lights, self.seed)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Written:
    """The output of a target, as in `ExportResult`; `units` if they differ from the target's."""

    lights: int
    not_carried_over: list[str]
    triangles: int = 0
    units: str | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Target:
    """A program, or a kind of file, that assets are written for.

    Attributes:
        name: of the program or the format.
        write: writes all files into an empty folder. The file with the name `ExportRequest.name`
            is the one to open, and others are in `ExportRequest.side_folder`; a target that is a
            folder writes files of any names.
        up: the axis that points up.
        units: one line: the units of lengths and of light.
        note: of other properties of its frame.
        is_folder: whether the output is a folder.
        importers: whether Blender's importer of the format needs other values.
        check: refuses, before any work, what cannot be written with the program that the user
            named in `ExportRequest.blender`.
    """

    name: str
    write: Callable[[ExportRequest, Path], Written]
    up: Up
    units: str
    note: str = ""
    is_folder: bool = False
    importers: bool = False
    check: Callable[[FilePath | None], object] | None = None


def blender_spots(request: ExportRequest) -> tuple[list[Spot], Written]:
    """The lights with y up that Blender's importers of glTF and OpenUSD turn into the lamp's."""
    spots = spots_of(request.place("y"))
    return spots, Written(
        units="metres; Blender's importer makes W of each of R, G and B",
        not_carried_over=[
            "the lamp's surfaces: they would illuminate and cast shadows a second time",
            "each light is the sum of spots that is nearest to its intensity, with one colour",
        ],
        lights=len(spots),
    )
