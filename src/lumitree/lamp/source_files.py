"""The files on which a luminaire depends, by which a change of it is noticed without loading it."""

from pathlib import Path

from lumitree.core.dataset import MANIFEST
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.luminaire import Luminaire
from lumitree.lamp.opening import named_files
from lumitree.lamp.scene_names import scene_names
from lumitree.lamp.source import LuminaireSource, dataset_folder, gldf_variant, source_kind


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
        names = scene_names(path)
        if luminaire is None or not names.complete:
            return None
        return sorted(names.files | set(luminaire.parsed.references()))
    overrides = path.with_suffix(".toml") if source.materials is None else Path(source.materials)
    return sorted({path, overrides, *named_files(source)})
