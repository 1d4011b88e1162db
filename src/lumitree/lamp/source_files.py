"""The files on which a luminaire depends, by which a change of it is noticed without loading it."""

import os
from pathlib import Path
from xml.parsers import expat

from lumitree.core.dataset import MANIFEST
from lumitree.core.reading import read_bytes
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.importers.model_folder import MAX_MODEL_BYTES
from lumitree.lamp.luminaire import Luminaire
from lumitree.lamp.opening import named_files
from lumitree.lamp.source import LuminaireSource, dataset_folder, gldf_variant, source_kind

# Longest attribute of a scene that may be the name of a file.
_MAX_NAME = 1000


def source_files(source: LuminaireSource, luminaire: Luminaire | None) -> list[Path] | None:
    """The files on which a luminaire depends, in order.

    Args:
        source: what was loaded.
        luminaire: the same, loaded; None for photometric files and datasets.

    Returns:
        Paths, also of files that are missing and would be read; None where the files are not
        known: of built-in luminaires, and of scenes whose names have parameters.
    """
    if source.name in BUILTIN:
        return None
    if source_kind(source) == "photometric":
        return [Path(gldf_variant(source.name)[0])]
    if (dataset := dataset_folder(source)) is not None:
        return [dataset / MANIFEST]
    path = Path(source.name)
    if path.suffix.lower() == ".xml":
        found = _scene_files(path, path.parent)
        if found is None or luminaire is None:
            return None
        return sorted(found | set(luminaire.parsed.references()))
    overrides = path.with_suffix(".toml") if source.materials is None else Path(source.materials)
    return sorted({path, overrides, *named_files(source)})


def _scene_files(path: Path, folder: Path) -> set[Path] | None:
    """A scene file, and the files that it and the scenes in it name; None if not known.

    Args:
        path: of a file that Mitsuba can read.
        folder: of the outermost scene.
    """
    files, included, known = {path}, [], True

    def opened(name: str, attributes: dict[str, str]) -> None:
        nonlocal known
        # Parameters in names, and folders in which names are looked up.
        known &= name != "path" and not any("$" in value for value in attributes.values())
        for value in attributes.values():
            if 0 < len(value) <= _MAX_NAME and os.path.isfile(folder / value):
                files.add(folder / value)
        if name == "include":
            included.append(folder / attributes.get("filename", ""))

    parser = expat.ParserCreate()
    parser.StartElementHandler = opened
    parser.Parse(read_bytes(path, "a Mitsuba scene", MAX_MODEL_BYTES), True)
    for each in included:
        inner = _scene_files(each, folder) if known and each.is_file() else None
        if inner is None:
            return None
        files |= inner
    return files if known else None
