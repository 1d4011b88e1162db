"""The files that the text of a Mitsuba scene names, found without Mitsuba."""

import dataclasses
import os
from pathlib import Path
from xml.parsers import expat

from lumitree.core.reading import read_bytes
from lumitree.lamp.importers.model_folder import MAX_MODEL_BYTES

# Longest attribute that may be the name of a file.
_MAX_NAME = 1000


@dataclasses.dataclass
class SceneNames:
    """All files that a scene names, itself included, and the scenes among them that it includes.

    Names with parameters, and names that are looked up in other folders than the scene's, are not
    known; the names are then not `complete`.
    """

    files: set[Path] = dataclasses.field(default_factory=set)
    included: list[Path] = dataclasses.field(default_factory=list)
    complete: bool = True


def scene_names(path: Path) -> SceneNames:
    """The files that a scene names, which Mitsuba has read."""
    names = SceneNames()
    _add_names(path, path.parent, names)
    return names


def _add_names(path: Path, folder: Path, names: SceneNames) -> None:
    """Add what a scene names; `folder` is the outermost scene's."""
    names.files.add(path)
    included = []

    def opened(name: str, attributes: dict[str, str]) -> None:
        if name == "path" or any("$" in value for value in attributes.values()):
            names.complete = False
        for value in attributes.values():
            if 0 < len(value) <= _MAX_NAME and os.path.isfile(folder / value):
                names.files.add(folder / value)
        if name == "include":
            included.append(folder / attributes.get("filename", ""))

    parser = expat.ParserCreate()
    parser.StartElementHandler = opened
    try:
        parser.Parse(read_bytes(path, "a Mitsuba scene", MAX_MODEL_BYTES), True)
    except (expat.ExpatError, ValueError):
        # Mitsuba's parser accepts more.
        names.complete = False
    for each in included:
        if each.is_file() and each not in names.included:
            names.included.append(each)
            _add_names(each, folder, names)
        else:
            names.complete = False
