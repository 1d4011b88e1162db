"""Loading of a luminaire, from a file in any supported format, as a Mitsuba scene."""

import atexit
import contextlib
import dataclasses
import functools
import hashlib
import importlib
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.backend import load_mitsuba
from lumitree.core.file_kinds import what_it_is
from lumitree.core.frames import LocalFrame, float32_step, similarity, similarity_scale
from lumitree.core.reading import read_bytes
from lumitree.core.work_folder import scratch_folder
from lumitree.errors import LumitreeError, LumitreeWarning, shown, shown_names
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.far_coordinates import origin_near, warn_of_far_meshes
from lumitree.lamp.importers.model_folder import MAX_MODEL_BYTES
from lumitree.lamp.importers.overrides import Overrides, apply_overrides, check_emits, select_parts
from lumitree.lamp.importers.overrides_file import read_overrides
from lumitree.lamp.media import any_scatters
from lumitree.lamp.parts import Model
from lumitree.lamp.probe import check_evaluates
from lumitree.lamp.scene_file import SceneFile
from lumitree.lamp.scene_shapes import SceneShape, shape_of_object
from lumitree.lamp.scene_writer import model_shapes, write_scene
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


@dataclasses.dataclass(frozen=True)
class Luminaire:
    """A luminaire that has been loaded and checked.

    Attributes:
        name: built-in name, or the file's folder and name.
        source: name or file that it was loaded from; None for a `mi.Scene`.
        fingerprint: SHA-256 of the scene file and of every file that it refers to.
        scene: the Mitsuba scene, in the axes and units of the luminaire's file.
        has_media: whether there are participating media.
        scatters: whether one of them scatters light.
        frame: its local frame.
        bounding_radius: radius of the sphere around the centre of the bounding box that contains
            all geometry, local units.
        shapes: its shapes as the file names them, by which parts of it can be chosen.
        origin: [3] origin of the scene's coordinates, in the frame of the luminaire's file. It is
            (0, 0, 0), but for a lamp far from there, whose coordinates in float32 would be coarse.
    """

    name: str
    source: LuminaireSource | None
    fingerprint: str
    scene: Any
    has_media: bool
    scatters: bool
    frame: LocalFrame
    bounding_radius: float
    shapes: tuple[SceneShape, ...]
    origin: NDArray[np.float64] = dataclasses.field(default_factory=lambda: np.zeros(3))

    def __repr__(self) -> str:
        size = " x ".join(f"{side:.4g}" for side in self.size)
        return (
            f"Luminaire({shown(repr(self.name))}: {len(self.scene.shapes()):,} shapes, "
            f"{self.num_triangles:,} triangles, {self.num_emitters:,} emitters, size {size})"
        )

    @property
    def scene_frame(self) -> LocalFrame:
        """Its local frame, with the frame of `scene` as the world."""
        return self.frame.moved(-self.origin) if self.origin.any() else self.frame

    @property
    def num_triangles(self) -> int:
        """Number of triangles of its meshes."""
        return sum(shape.face_count() for shape in self.scene.shapes() if shape.is_mesh())

    @property
    def num_emitters(self) -> int:
        """Number of shapes that emit."""
        return len(self.scene.emitters())

    @property
    def size(self) -> NDArray[np.float64]:
        """[3] sides of the bounding box, in the unit of the luminaire's file."""
        return self.frame.size


LuminaireLike = str | os.PathLike[str] | LuminaireSource | Luminaire | Mapping[str, Any]
"""Types that are accepted as a luminaire, and `mi.Scene`, whose class depends on the variant."""


def load_luminaire(luminaire: "LuminaireLike | Any") -> Luminaire:
    """Load a luminaire, see `lumitree.load_luminaire`.

    Raises:
        LumitreeError: the name is unknown, the file cannot be read, or the scene is not a
            luminaire: it lacks geometry or area emitters, or has lights that cannot be baked.
    """
    if isinstance(luminaire, Luminaire):
        return luminaire
    if isinstance(luminaire, load_mitsuba().Scene):
        return _luminaire_of_scene(luminaire)
    source = luminaire_source(luminaire)
    file = open_scene_file(source)
    media = file.nodes("Medium")
    _check_media(str(file.path), {node.props.plugin_name() for node in media})
    # Computed first: creating the scene clears the parsed file, with the names of other files.
    fingerprint = _fingerprint(file, source)
    named = source.name in BUILTIN
    name = source.name if named else _folder_and_name(source.name)
    if isinstance(luminaire, Mapping):
        name = str(luminaire.get("id", "dictionary"))
    for note in file.notes:
        warnings.warn(f"{name}: {note}", LumitreeWarning, stacklevel=2)
    shapes = file.shapes if file.path == Path(source.name) else model_shapes(file.shapes)
    # Shapes that are much too small for their coordinates may not even be created.
    origin = origin_near(file.analytic_box(), tolerance=100)
    if origin.any():
        file.recentre(origin)
    mesh_files, scene = file.mesh_files(), file.instantiate()
    corners = np.array([scene.bbox().min, scene.bbox().max], np.float64).reshape(2, 3)
    offset = origin_near(corners)
    if offset.any():
        origin += offset
        file = open_scene_file(source, origin)
        mesh_files, scene = file.mesh_files(), file.instantiate()
    loaded = _luminaire(name, source, fingerprint, scene, bool(media), shapes, origin)
    warn_of_far_meshes(name, float(loaded.size.max()), loaded.scene_frame.centre, mesh_files)
    return loaded


def luminaire_source(luminaire: "LuminaireLike") -> LuminaireSource:
    """The file or the name of a luminaire; a dictionary is written to a scene file.

    Raises:
        LumitreeError: the luminaire has no file, or a dictionary is not a scene.
    """
    if isinstance(luminaire, Luminaire):
        if luminaire.source is None:
            raise LumitreeError(
                f"{luminaire.name} was made from a mi.Scene, whose shapes cannot be moved; give "
                "its dictionary or its file"
            )
        return luminaire.source
    if isinstance(luminaire, Mapping):
        return LuminaireSource(str(_written_dictionary(dict(luminaire))))
    if not isinstance(luminaire, str | os.PathLike | LuminaireSource):
        kind = type(luminaire).__name__
        raise LumitreeError(f"a luminaire is a name, path, dictionary or scene, not of type {kind}")
    return as_source(luminaire)


def _luminaire(
    name: str,
    source: LuminaireSource | None,
    fingerprint: str,
    scene: Any,
    has_media: bool,
    shapes: tuple[SceneShape, ...],
    origin: NDArray[np.float64] | None = None,
) -> Luminaire:
    check_evaluates(scene, shapes, name)
    origin = np.zeros(3) if origin is None else origin
    frame = LocalFrame.of_box(np.ravel(scene.bbox().min), np.ravel(scene.bbox().max))
    return Luminaire(
        name=name,
        source=source,
        fingerprint=fingerprint,
        scene=scene,
        has_media=has_media,
        scatters=has_media and any_scatters(scene),
        frame=frame.moved(origin) if origin.any() else frame,
        bounding_radius=_bounding_radius(scene, frame),
        shapes=shapes,
        origin=origin,
    )


def _luminaire_of_scene(scene: Any) -> Luminaire:
    """The luminaire of a `mi.Scene`."""
    what = "the scene"
    if not scene.shapes():
        raise LumitreeError(f"{what} holds no shapes; expected a luminaire's geometry")
    if scene.environment() is not None or any(e.get_shape() is None for e in scene.emitters()):
        raise LumitreeError(
            f"{what} holds a light without a surface, which does not belong to a luminaire; remove "
            "it, or replace it by a small shape with an area emitter"
        )
    if not scene.emitters():
        raise LumitreeError(f"{what} holds no emitter, so there is nothing to bake; add one")
    media = {
        medium.class_name()
        for shape in scene.shapes()
        for medium in (shape.interior_medium(), shape.exterior_medium())
        if medium is not None
    }
    _check_media(what, {"homogeneous" if "Homogeneous" in name else name for name in media})
    digest = hashlib.sha256(repr(scene).encode())
    for key, value in load_mitsuba().traverse(scene):
        digest.update(key.encode())
        digest.update(repr(value).encode() if not hasattr(value, "numpy") else _bytes_of(value))
    shapes = tuple(shape_of_object(*item) for item in enumerate(scene.shapes()))
    luminaire = _luminaire("scene", None, digest.hexdigest(), scene, bool(media), shapes)
    if luminaire.frame.is_far:
        step, size = float32_step(luminaire.frame.centre), luminaire.size.max()
        warnings.warn(
            f"{what} is so far from its origin that its coordinates are rounded to multiples of "
            f"{step:.2g}, {step / size:.2%} of the lamp's size; move it to the origin, or give its "
            "file or its dictionary",
            LumitreeWarning,
            stacklevel=3,
        )
    return luminaire


def _bytes_of(value: Any) -> bytes:
    return np.ascontiguousarray(np.array(value)).tobytes()


def _check_media(what: str, kinds: set[str]) -> None:
    if kinds - {"homogeneous"}:
        raise LumitreeError(
            f"{what} holds a heterogeneous medium, whose straight-through opacity is not "
            "supported; use homogeneous media"
        )


def _written_dictionary(description: dict[str, Any]) -> Path:
    """Path of a dictionary's scene file, in a temporary folder."""
    mi = load_mitsuba()
    path = _until_exit.enter_context(scratch_folder()) / "scene.xml"
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_meshes = config.merge_equivalent = False
    if description.get("type") != "scene":
        description = {"type": "scene", "luminaire": description}
    try:
        state = mi.parser.parse_dict(config, description)
        mi.parser.write_file(state, str(path))
    except (RuntimeError, TypeError, ValueError) as error:
        reason = shown(" ".join(str(error).split()), 300)
        raise LumitreeError(f"the dictionary is not a Mitsuba scene: {reason}") from None
    return path


def luminaire_path(source: LuminaireLike) -> Path:
    """Path of the Mitsuba scene file of a luminaire.

    Built-in luminaires and models are written to a temporary folder, which lasts as long as the
    process. A model is read again when the model or its overrides have changed.

    Raises:
        LumitreeError: the name or the format is unknown, the file cannot be read, or its overrides
            are invalid.
    """
    source = luminaire_source(source)
    path = Path(source.name)
    builtin = source.name in BUILTIN
    if not builtin and not os.path.exists(path):
        raise LumitreeError(
            f"no luminaire {shown(source.name, 300)!r}: neither a file nor built in "
            f"({', '.join(BUILTIN)}); see 'lumitree list'"
        )
    kind = path.suffix.lower()
    if not builtin and kind not in (".xml", *_READERS):
        what = _NOT_LUMINAIRES.get(source_kind(source)) or what_it_is(path)
        raise LumitreeError(
            f"{shown(path, 300)} {f'is {what}' if what else 'has an unsupported format'}; expected "
            f".xml (a Mitsuba 3 scene), {', '.join(_READERS)}, or a built-in name"
        )
    if kind == ".xml" and not builtin:
        if source.materials is not None:
            raise LumitreeError(
                f"{path} is a Mitsuba scene, to which --materials does not apply; edit its BSDFs"
            )
        return path
    files = () if builtin else (path, _overrides_path(source))
    return _written(source, tuple(_stamp(file) for file in files if file is not None))


def place_shapes(luminaire: LuminaireLike, scene_from_world: ArrayLike) -> dict[str, Any]:
    """Shapes of an explicit luminaire placed in a scene, for `mitsuba.load_dict`.

    Args:
        luminaire: as for `load_luminaire`, but with a file.
        scene_from_world: [4, 4] similarity from the frame of the luminaire's file. The
            extinction of interior media is divided by its scale, so that the appearance of the
            luminaire does not depend on its size.
    """
    matrix = np.asarray(scene_from_world, np.float64)
    scale = similarity_scale(matrix, "placement")
    origin = luminaire.origin if isinstance(luminaire, Luminaire) else np.zeros(3)
    file = open_scene_file(luminaire_source(luminaire), origin)
    file.move(matrix @ similarity(np.eye(3), 1.0, origin) if origin.any() else matrix)
    for node in file.nodes("Medium"):
        node.props["scale"] = node.props.get("scale", 1.0) / scale
    return {f"luminaire_{i}": shape for i, shape in enumerate(file.instantiate().shapes())}


def read_model(source: str | os.PathLike[str] | LuminaireSource) -> Model:
    """Model of a built-in luminaire or a model file with its overrides, in metres, y up.

    Raises:
        LumitreeError: the file cannot be read, its overrides are invalid, a pattern matches
            nothing, or nothing emits.
    """
    source = as_source(source)
    path = Path(source.name)
    if source.name in BUILTIN:
        if source.materials is not None:
            raise LumitreeError(f"built-in luminaire {source.name!r} takes no --materials")
        return select_parts(BUILTIN[source.name].build(), source.keep, source.drop, source.name)
    overrides_path = _overrides_path(source)
    overrides = read_overrides(overrides_path) if overrides_path is not None else Overrides()
    model = _READERS[path.suffix.lower()](path, overrides)
    model = select_parts(model, source.keep, source.drop, str(path))
    model = apply_overrides(model, overrides)
    named = overrides_path or path.with_suffix(".toml")
    check_emits(model, str(path), named.name)
    return model


def _read_obj(path: Path, overrides: Overrides) -> Model:
    if overrides.variant is not None:
        raise LumitreeError(f"{overrides.file}: variant is only for glTF, not for {path.name}")
    # Imported here, because most runs need no reader.
    reader = importlib.import_module("lumitree.lamp.importers.obj.reader")
    return reader.read_obj(path)


def _read_gltf(path: Path, overrides: Overrides) -> Model:
    reader = importlib.import_module("lumitree.lamp.importers.gltf.reader")
    return reader.read_gltf(path, variant=overrides.variant)


_READERS: dict[str, Callable[[Path, Overrides], Model]] = {
    ".obj": _read_obj,
    ".gltf": _read_gltf,
    ".glb": _read_gltf,
}


def _overrides_path(source: LuminaireSource) -> Path | None:
    if source.materials is not None:
        return Path(source.materials)
    beside = Path(source.name).with_suffix(".toml")
    return beside if os.path.isfile(beside) else None


def _stamp(path: Path) -> tuple[str, int, int]:
    status = path.stat() if os.path.exists(path) else None
    return (str(path), status.st_mtime_ns, status.st_size) if status else (str(path), 0, 0)


@functools.lru_cache(maxsize=64)
def _written(source: LuminaireSource, stamps: tuple[tuple[str, int, int], ...]) -> Path:
    """Path of the scene written for a source; `stamps` identify the versions of its files."""
    return write_scene(read_model(source), _until_exit.enter_context(scratch_folder()))


_until_exit = contextlib.ExitStack()
atexit.register(_until_exit.close)


def open_scene_file(
    source: LuminaireSource, origin: NDArray[np.float64] | None = None
) -> SceneFile:
    """The parsed and checked scene of a source; its patterns are applied if its file is a scene.

    Args:
        source: what to open.
        origin: [3] of the scene's coordinates, as `Luminaire.origin`.
    """
    path = luminaire_path(source)
    own = path == Path(source.name)
    file = SceneFile(path, source.keep, source.drop) if own else SceneFile(path)
    _check_emitters(file)
    if origin is not None and origin.any():
        file.recentre(origin)
    return file


def _folder_and_name(path: str) -> str:
    # Many files are called luminaire.xml, so the name includes the folder.
    return f"{Path(path).resolve().parent.name}/{Path(path).stem}"


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


def _fingerprint(file: SceneFile, source: LuminaireSource) -> str:
    """SHA-256 of the scene and its files, which include the overrides and selection of a model."""
    digest = hashlib.sha256(read_bytes(file.path, "a Mitsuba scene", MAX_MODEL_BYTES))
    if file.path == Path(source.name) and (source.keep or source.drop):
        digest.update(repr((source.keep, source.drop)).encode())
    for path in file.references():
        if os.path.isfile(path):
            digest.update(read_bytes(path, "a file of a scene", _MAX_FILE_BYTES))
    return digest.hexdigest()


def _bounding_radius(scene: Any, frame: LocalFrame) -> float:
    """Largest distance from the centre to a vertex, or to a box corner of a shape without any."""
    farthest = 0.0
    for shape in scene.shapes():
        if shape.is_mesh():
            points = np.array(shape.vertex_positions_buffer()).reshape(-1, 3)
        else:
            low, high = np.ravel(shape.bbox().min), np.ravel(shape.bbox().max)
            points = np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)
        if len(points):
            farthest = max(farthest, float(np.linalg.norm(points - frame.centre, axis=1).max()))
    return min(farthest / frame.scale, float(np.linalg.norm(frame.half_extents)))
