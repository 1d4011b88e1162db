"""The parsed scene of a built-in luminaire, a model, a scene file or a dictionary."""

import dataclasses
import functools
import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lumitree.core.backend import load_mitsuba
from lumitree.core.file_kinds import what_it_is
from lumitree.core.files import ScratchFolder
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, shown, shown_names
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.importers.model_folder import MAX_MODEL_BYTES, noted_files
from lumitree.lamp.model_reading import READERS, overrides_path, read_model
from lumitree.lamp.scene_file import SceneFile, refuse_kind
from lumitree.lamp.scene_names import scene_names
from lumitree.lamp.scene_writer import write_scene
from lumitree.lamp.source import LuminaireSource, as_source, source_kind

_ENVIRONMENTS = ("constant", "envmap", "sky", "sunsky", "directional")
_MAX_FILE_BYTES = 2**40
# Sources that have no shapes to load.
_NOT_LUMINAIRES: dict[str, str] = {
    "asset": "an asset, which is baked already",
    "photometric": "a photometric file, which has no shapes and is used as an asset",
    "dataset": "a dataset",
}
# Of a shape, but in one direction only.
_INVISIBLE = ("directionalarea",)


# A version of a file: its path, time, size and inode.
Stamp = tuple[str, int, int, int]
Opened = str | os.PathLike[str] | LuminaireSource | Mapping[str, Any]


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


def _stamp(path: Path) -> Stamp:
    if not os.path.exists(path):
        return str(path), 0, 0, 0
    status = path.stat()
    # Times of clocks that were set back may repeat.
    return str(path), status.st_mtime_ns, status.st_size, status.st_ino


@functools.lru_cache(maxsize=64)
def _written(
    source: LuminaireSource, stamps: tuple[Stamp, ...]
) -> tuple[Path, ScratchFolder, tuple[Stamp, ...]]:
    """The scene written for a source, its folder, and the files that its model names."""
    folder = ScratchFolder()
    with noted_files() as files:
        path = write_scene(read_model(source), folder.path)
    return path, folder, tuple(map(_stamp, files))


@dataclasses.dataclass(frozen=True)
class _DictionarySource(LuminaireSource):
    """The scene file of a dictionary, which lasts as long as its folder."""

    folder: ScratchFolder | None = dataclasses.field(default=None, compare=False)


def open_scene_file(source: LuminaireSource) -> SceneFile:
    """The parsed and checked scene of a source; its patterns are applied if its file is a scene."""
    path, folder = scene_path(source)
    own = path == Path(source.name)
    patterns = (source.keep, source.drop) if own else ((), ())
    file = SceneFile(path, *patterns, folder=folder)
    _check_emitters(file)
    for node in file.nodes("Emitter"):
        # All emitters of a lamp count; the weight is for scenes.
        if "sampling_weight" in node.props:
            del node.props["sampling_weight"]
    return file


def _check_emitters(file: SceneFile) -> None:
    if not file.nodes("Shape"):
        raise LumitreeError(f"{file.path} holds no shapes; expected a luminaire's geometry")
    kinds = [node.props.plugin_name() for node in file.nodes("Emitter")]
    loose = file.loose_lights()
    environments = [kind for kind in loose if kind in _ENVIRONMENTS]
    invisible = [kind for kind in kinds if kind in loose or kind in _INVISIBLE]
    if environments:
        raise LumitreeError(
            f"{file.path} holds an environment light ({environments[0]}), which does not belong "
            "to a luminaire; remove it from the file, or --keep only the lamp's shapes: "
            f"{shown_names(map(str, file.shapes))}"
        )
    if "area" in loose:
        raise LumitreeError(
            f"{file.path} holds an area emitter outside of a shape, which emits nothing; move it "
            "into the <shape> that emits, or remove it"
        )
    if invisible:
        raise LumitreeError(
            f"{file.path} holds a light without a surface ({invisible[0]}), which is invisible to "
            "cameras; replace it by a small shape with an area emitter"
        )
    if not kinds:
        raise LumitreeError(
            f"{file.path} holds no emitter, so there is nothing to bake; give a shape an "
            '<emitter type="area">'
        )


def fingerprint_of(file: SceneFile, source: LuminaireSource) -> str:
    """SHA-256 of the scene and its files, which include the overrides and selection of a model."""
    digest = hashlib.sha256(read_bytes(file.path, "a Mitsuba scene", MAX_MODEL_BYTES))
    if file.path == Path(source.name) and (source.keep or source.drop):
        digest.update(repr((source.keep, source.drop)).encode())
    names = scene_names(file.path)
    for path in names.included:
        digest.update(read_bytes(path, "a Mitsuba scene", MAX_MODEL_BYTES))
    if not names.complete:
        # Other parts may be included by parameters, or from other folders.
        digest.update(file.parsed_text().encode())
    for spectrum in file.listed_spectra():
        digest.update(spectrum.tobytes())
    for path in file.references():
        if os.path.isfile(path):
            digest.update(read_bytes(path, "a file of a scene", _MAX_FILE_BYTES))
    return digest.hexdigest()


def scene_path(source: LuminaireSource) -> tuple[Path, ScratchFolder | None]:
    """Path of the Mitsuba scene file of a luminaire, and its folder if that is a temporary one.

    Built-in luminaires and models are written to a temporary folder. A model is written again when
    the model or its overrides have changed.
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
    return _written_model(source)[:2]


def named_files(source: LuminaireSource) -> frozenset[Path]:
    """The files that a model has named when its scene was written, also missing ones."""
    return frozenset(Path(name) for name, *_ in _written_model(source)[2])


def _written_model(source: LuminaireSource) -> tuple[Path, ScratchFolder, tuple[Stamp, ...]]:
    builtin = source.name in BUILTIN
    files = () if builtin else (Path(source.name), overrides_path(source))
    stamps = tuple(_stamp(file) for file in files if file is not None)
    written = _written(source, stamps)
    path, _, named = written
    # Old temporary files are removed on many systems.
    if not path.is_file() or any(_stamp(Path(each[0])) != each for each in named):
        _written.cache_clear()
        written = _written(source, stamps)
    return written


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
