"""The targets of `lumitree export`, by the suffix of the output."""

import os
from pathlib import Path

from lumitree.core.files import FilePath
from lumitree.errors import LumitreeError, shown
from lumitree.output.targets import blender, gltf, ies_folder, pbrt, radiance, usd
from lumitree.output.targets.target import Target

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


def find_target(output: FilePath) -> Target:
    """The target of an output: by its suffix, or the one for folders if it ends in a slash.

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
