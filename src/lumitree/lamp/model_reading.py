"""Models of built-in luminaires and of model files, with their overrides."""

import importlib
import os
from collections.abc import Callable
from pathlib import Path

from lumitree.errors import LumitreeError
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.importers.likely_faults import warn_of_likely_faults
from lumitree.lamp.importers.overrides import (
    Overrides,
    apply_overrides,
    check_emits,
    select_parts,
    sided_materials,
)
from lumitree.lamp.importers.overrides_file import read_overrides
from lumitree.lamp.importers.repeated_faces import without_repeated
from lumitree.lamp.parts import Geometry
from lumitree.lamp.source import LuminaireSource, as_source


def read_model(source: str | os.PathLike[str] | LuminaireSource) -> Geometry:
    """Geometry of a built-in luminaire or a model file with its overrides, in metres, y up."""
    source = as_source(source)
    path = Path(source.name)
    if source.name in BUILTIN:
        if source.materials is not None:
            raise LumitreeError(f"built-in luminaire {source.name!r} takes no --materials")
        return select_parts(BUILTIN[source.name].build(), source.keep, source.drop, source.name)
    chosen = overrides_path(source)
    overrides = read_overrides(chosen) if chosen is not None else Overrides()
    model = READERS[path.suffix.lower()](path, overrides)
    model = select_parts(model, source.keep, source.drop, str(path))
    model = without_repeated(model, sided_materials(model, overrides), str(path))
    toml = (chosen or path.with_suffix(".toml")).name
    warn_of_likely_faults(model, overrides, str(path), toml)
    model = apply_overrides(model, overrides)
    check_emits(model, str(path), toml)
    return model


def _read_obj(path: Path, overrides: Overrides) -> Geometry:
    if overrides.variant is not None:
        raise LumitreeError(f"{overrides.file}: variant is only for glTF, not for {path.name}")
    # Imported here, because most runs need no reader.
    reader = importlib.import_module("lumitree.lamp.importers.obj.reader")
    changes = overrides.materials.items()
    emitting = [name for name, change in changes if change.emission is not None]
    return reader.read_obj(path, emitting)


def _read_gltf(path: Path, overrides: Overrides) -> Geometry:
    reader = importlib.import_module("lumitree.lamp.importers.gltf.reader")
    return reader.read_gltf(path, variant=overrides.variant)


READERS: dict[str, Callable[[Path, Overrides], Geometry]] = {
    ".obj": _read_obj,
    ".gltf": _read_gltf,
    ".glb": _read_gltf,
}


def overrides_path(source: LuminaireSource) -> Path | None:
    """The file of overrides of a model, if there is one."""
    if source.materials is not None:
        return Path(source.materials)
    beside = Path(source.name).with_suffix(".toml")
    return beside if os.path.isfile(beside) else None
