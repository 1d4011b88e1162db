"""From the source of a luminaire (a name, a file, a dictionary) to the parsed scene.

Models and built-in luminaires are written as a scene file, which is then read like the user's own.
"""

import dataclasses
import functools
import hashlib
import importlib
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from lumitree.core.backend import load_mitsuba
from lumitree.core.file_kinds import what_it_is
from lumitree.core.files import ScratchFolder
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, shown, shown_names
from lumitree.lamp.builtin import BUILTIN
from lumitree.lamp.importers.faults import warn_of_likely_faults, without_repeated
from lumitree.lamp.importers.model_files import MAX_MODEL_BYTES
from lumitree.lamp.importers.overrides import (
    Overrides,
    apply_overrides,
    check_emits,
    read_overrides,
    select_parts,
    sided_materials,
)
from lumitree.lamp.parts import Geometry
from lumitree.lamp.scene_file import SceneFile, refuse_kind
from lumitree.lamp.scene_shapes import SceneShape
from lumitree.lamp.scene_writer import write_scene
from lumitree.lamp.source import LuminaireSource, as_source, source_kind

_MAX_FILE_BYTES = 2**40
# Sources that have no shapes to load.
_NOT_LUMINAIRES: dict[str, str] = {
    "asset": "an asset, which is baked already",
    "photometric": "a photometric file, which has no shapes and is used as an asset",
    "dataset": "a dataset",
}
Opened = str | os.PathLike[str] | LuminaireSource | Mapping[str, Any]


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
    reader = importlib.import_module("lumitree.lamp.importers.obj")
    changes = overrides.materials.items()
    emitting = [name for name, change in changes if change.emission is not None]
    return reader.read_obj(path, emitting)


def _read_gltf(path: Path, overrides: Overrides) -> Geometry:
    reader = importlib.import_module("lumitree.lamp.importers.gltf")
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


def luminaire_source(luminaire: Opened) -> LuminaireSource:
    """The file or the name of a luminaire; a dictionary is written to a scene file.

    Raises:
        LumitreeError: it is none of these, or a dictionary is not a scene.
    """
    if isinstance(luminaire, Mapping):
        return _written_dictionary(dict(luminaire))
    if not isinstance(luminaire, str | os.PathLike | LuminaireSource):
        refuse_kind(luminaire, "a luminaire")
    return as_source(luminaire)


def _written(source: LuminaireSource) -> tuple[Path, ScratchFolder]:
    """The scene written for a source, and its folder."""
    folder = ScratchFolder()
    return write_scene(read_model(source), folder.path), folder


# A built-in lamp is always the same.
_written_builtin = functools.lru_cache(maxsize=16)(_written)


@dataclasses.dataclass(frozen=True)
class _DictionarySource(LuminaireSource):
    """The scene file of a dictionary, which lasts as long as its folder."""

    folder: ScratchFolder | None = dataclasses.field(default=None, compare=False)


def open_scene_file(source: LuminaireSource) -> SceneFile:
    """The parsed and checked scene of a source; its patterns are applied if its file is a scene."""
    path, folder = scene_path(source)
    patterns = (source.keep, source.drop) if path == Path(source.name) else ((), ())
    file = SceneFile(path, *patterns, folder=folder)
    kinds = [node.props.plugin_name() for node in file.nodes("Emitter")]
    check_emitters(str(file.path), file.shapes, file.loose_lights(), kinds)
    for node in file.nodes("Emitter"):
        # All emitters of a lamp count; the weight is for scenes.
        if "sampling_weight" in node.props:
            del node.props["sampling_weight"]
    return file


def check_emitters(
    what: str, shapes: Sequence[SceneShape], loose: Sequence[str], kinds: Sequence[str]
) -> None:
    """Refuse a scene without shapes or emitters, or with emitters that are no visible surfaces.

    `loose` are plugins or classes of the emitters without a shape, `kinds` of all emitters.
    """
    if not shapes:
        raise LumitreeError(f"{what} has no shapes; expected a luminaire's geometry")
    invisible = [*loose, *(kind for kind in kinds if kind.lower() == "directionalarea")]
    if invisible:
        raise LumitreeError(
            f"{what} has a light without a surface, or that cameras do not see ({invisible[0]}); "
            "remove it, replace it by a small shape with an area emitter, or --keep only the "
            f"lamp's shapes: {shown_names(map(str, shapes))}"
        )
    if not kinds:
        raise LumitreeError(
            f"{what} has no emitter, so there is nothing to bake; give a shape an "
            '<emitter type="area">'
        )


def fingerprint_of(file: SceneFile, source: LuminaireSource) -> str:
    """SHA-256 of the scene and its files, which include the overrides and selection of a model."""
    content = read_bytes(file.path, "a Mitsuba scene", MAX_MODEL_BYTES)
    digest = hashlib.sha256(content)
    if file.path == Path(source.name) and (source.keep or source.drop):
        digest.update(repr((source.keep, source.drop)).encode())
    # In UTF-16 every other byte is 0.
    if b"include" in content.replace(b"\0", b""):
        digest.update(file.parsed_text().encode())
    for spectrum in file.listed_spectra():
        digest.update(spectrum.tobytes())
    for path in file.references():
        if os.path.isfile(path):
            digest.update(read_bytes(path, "a file of a scene", _MAX_FILE_BYTES))
    return digest.hexdigest()


def scene_path(source: LuminaireSource) -> tuple[Path, ScratchFolder | None]:
    """Path of the Mitsuba scene file of a luminaire, and its folder if that is a temporary one.

    Built-in luminaires and models are written to a temporary folder.
    """
    path = Path(source.name)
    builtin = source.name in BUILTIN
    if not builtin and not os.path.exists(path):
        raise LumitreeError(
            f"no luminaire {shown(source.name, 300)!r}: neither a file nor built in "
            f"({', '.join(BUILTIN)}); see 'lumitree list'"
        )
    kind = path.suffix.lower()
    if not builtin and kind not in (".xml", *READERS):
        what = _NOT_LUMINAIRES.get(source_kind(source)) or what_it_is(path)
        raise LumitreeError(
            f"{shown(path, 300)} {f'is {what}' if what else 'has an unsupported format'}; expected "
            f".xml (a Mitsuba 3 scene), {', '.join(READERS)}, or a built-in name"
        )
    if kind == ".xml" and not builtin:
        if source.materials is not None:
            raise LumitreeError(
                f"{path} is a Mitsuba scene, to which --materials does not apply; edit its BSDFs"
            )
        return path, getattr(source, "folder", None)
    if not builtin:
        return _written(source)
    path, folder = _written_builtin(source)
    if not path.is_file():
        # Old temporary files are removed on many systems.
        _written_builtin.cache_clear()
        path, folder = _written_builtin(source)
    return path, folder


def _written_dictionary(description: dict[str, Any]) -> LuminaireSource:
    """The scene file of a dictionary, in a temporary folder."""
    mi, folder = load_mitsuba(), ScratchFolder()
    path = folder.path / "scene.xml"
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_meshes = config.merge_equivalent = False
    if description.get("type") != "scene":
        description = {"type": "scene", "luminaire": description}
    try:
        state = mi.parser.parse_dict(config, description)
        mi.parser.write_file(state, str(path))
    except (RuntimeError, TypeError, ValueError) as error:
        reason = shown(" ".join(str(error).split()), 300)
        if "unsupported type" in reason:
            raise LumitreeError(
                "the dictionary of a lamp holds objects that are created already, such as shapes "
                "or tensors; give mitsuba.load_dict of a whole scene, or the names of files"
            ) from None
        raise LumitreeError(f"the dictionary is not a Mitsuba scene: {reason}") from None
    return _DictionarySource(str(path), folder=folder)
