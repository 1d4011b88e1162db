"""A luminaire: a lamp from whatever file as a Mitsuba scene, and its local frame."""

import atexit
import contextlib
import dataclasses
import functools
import hashlib
import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.builtin.registry import BUILTIN
from lumitree.core.backend import load_mitsuba
from lumitree.core.frames import proxy_box, similarity_scale
from lumitree.core.work_folder import scratch_folder
from lumitree.errors import LumitreeError, shown
from lumitree.importers.model_folder import read_limited
from lumitree.importers.overrides import Overrides, apply_overrides, check_emits, select_parts
from lumitree.importers.overrides_file import read_overrides
from lumitree.luminaire.scene_file import SceneFile
from lumitree.luminaire.scene_writer import write_scene
from lumitree.luminaire.source import LuminaireSource, Source, as_source
from lumitree.model.model import Model

_ENVIRONMENTS = ("constant", "envmap", "sky", "sunsky", "directional")
_MAX_FILE_BYTES = 2**40
_INVISIBLE = ("point", "spot", "projector", "directionalarea")


@dataclasses.dataclass(frozen=True)
class Luminaire:
    """A luminaire that has been loaded and checked.

    Attributes:
        name: built-in name, or the file's folder and name.
        path: its Mitsuba scene.
        fingerprint: SHA-256 of the scene and every file it names.
        scene: the Mitsuba scene, in the luminaire's own frame and units.
        has_media: whether paths cross participating media.
        world_from_proxy: [4, 4] local frame (D8).
        half_extents: [3] bounding box, local units.
        bounding_radius: of the sphere about the box's centre that holds all geometry, local
            units.
    """

    name: str
    path: Path
    fingerprint: str
    scene: Any
    has_media: bool
    world_from_proxy: NDArray[np.float64]
    half_extents: NDArray[np.float64]
    bounding_radius: float

    @property
    def num_triangles(self) -> int:
        """Triangles of its meshes; other shapes have none."""
        return sum(shape.face_count() for shape in self.scene.shapes() if shape.is_mesh())

    @property
    def num_emitters(self) -> int:
        """Shapes that emit."""
        return len(self.scene.emitters())

    @property
    def size(self) -> NDArray[np.float64]:
        """[3] sides of the bounding box, the file's unit."""
        return 2 * self.half_extents * self.world_from_proxy[0, 0]


def load_luminaire(source: Source) -> Luminaire:
    """Load a built-in luminaire by name, or a file that holds one.

    Raises:
        LumitreeError: unknown name, unreadable file, or a scene that is no luminaire: without
            geometry, without area emitters, or with lights that cannot be baked.
    """
    source = as_source(source)
    file = _open(source)
    path = file.path
    media = file.nodes("Medium")
    if any(node.props.plugin_name() != "homogeneous" for node in media):
        raise LumitreeError(
            f"{path} holds a heterogeneous medium, whose straight-through opacity is not "
            "supported; use homogeneous media"
        )
    # Creating the scene uses up what the file said, the names of other files with it.
    fingerprint = _fingerprint(file, source)
    scene = file.instantiate()
    world_from_proxy, half_extents = proxy_box(
        np.ravel(scene.bbox().min), np.ravel(scene.bbox().max)
    )
    return Luminaire(
        name=source.name if source.name in BUILTIN else _folder_and_name(source.name),
        path=path,
        fingerprint=fingerprint,
        scene=scene,
        has_media=bool(media),
        world_from_proxy=world_from_proxy,
        half_extents=half_extents,
        bounding_radius=_bounding_radius(scene, world_from_proxy, half_extents),
    )


def luminaire_path(source: Source) -> Path:
    """Mitsuba scene of a LUMINAIRE argument; what is none is written as one to a temporary folder.

    The folder lasts as long as the process. A model is read again when it or its overrides have
    changed.

    Raises:
        LumitreeError: unknown name or format, unreadable file, wrong overrides.
    """
    source = as_source(source)
    path = Path(source.name)
    builtin = source.name in BUILTIN
    if not builtin and not os.path.exists(path):
        raise LumitreeError(
            f"no luminaire {shown(source.name, 300)!r}: neither a file nor built in "
            f"({', '.join(BUILTIN)}); see 'lumitree list'"
        )
    kind = path.suffix.lower()
    if not builtin and kind not in (".xml", *_READERS):
        raise LumitreeError(
            f"{shown(path, 300)} is in no format that is read; expected .xml (a Mitsuba 3 scene), "
            f"{', '.join(_READERS)}, or a built-in name"
        )
    if kind == ".xml" and not builtin:
        if source.materials is not None:
            raise LumitreeError(
                f"{path} is a Mitsuba scene, which --materials does not change; edit its BSDFs"
            )
        return path
    files = () if builtin else (path, _overrides_path(source))
    return _written(source, tuple(_stamp(file) for file in files if file is not None))


def place_shapes(source: Source, scene_from_world: ArrayLike) -> dict[str, Any]:
    """Shapes of an explicit luminaire moved into a scene, for `mitsuba.load_dict`.

    Args:
        source: LUMINAIRE argument.
        scene_from_world: [4, 4] similarity from the luminaire's own frame. Interior media get
            denser as the luminaire gets smaller, so that it looks the same at every size.
    """
    mi = load_mitsuba()
    matrix = np.asarray(scene_from_world, np.float64)
    scale = similarity_scale(matrix, "placement")
    file = _open(as_source(source))
    for node in file.nodes("Shape"):
        # The parser keeps transforms in double precision.
        own = node.props.get("to_world", mi.ScalarTransform4d())
        node.props["to_world"] = mi.ScalarTransform4d(matrix @ np.array(own.matrix))
    for node in file.nodes("Medium"):
        node.props["scale"] = node.props.get("scale", 1.0) / scale
    return {f"luminaire_{i}": shape for i, shape in enumerate(file.instantiate().shapes())}


def read_model(source: Source) -> Model:
    """Model of a built-in luminaire or a model file, with its overrides: metres, y up.

    Raises:
        LumitreeError: unreadable file, wrong overrides, patterns that match nothing, no emitter.
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
    shown = overrides_path or path.with_suffix(".toml")
    check_emits(model, str(path), shown.name)
    return model


def _read_obj(path: Path, overrides: Overrides) -> Model:
    if overrides.variant is not None:
        raise LumitreeError(f"{overrides.file}: variant is only for glTF, not for {path.name}")
    # Readers are imported when they are needed: most runs need none.
    reader = importlib.import_module("lumitree.importers.obj.reader")
    return reader.read_obj(path)


def _read_gltf(path: Path, overrides: Overrides) -> Model:
    reader = importlib.import_module("lumitree.importers.gltf.reader")
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
    """Scene written for a source whose files look as `stamps` say."""
    return write_scene(read_model(source), _until_exit.enter_context(scratch_folder()))


_until_exit = contextlib.ExitStack()
atexit.register(_until_exit.close)


def _open(source: LuminaireSource) -> SceneFile:
    """The source's scene, checked to be a luminaire; patterns select in what is a scene itself."""
    path = luminaire_path(source)
    own = path == Path(source.name)
    file = SceneFile(path, source.keep, source.drop) if own else SceneFile(path)
    _check_emitters(file)
    return file


def _folder_and_name(path: str) -> str:
    # Many files are called luminaire.xml; their folder tells them apart.
    return f"{Path(path).resolve().parent.name}/{Path(path).stem}"


def _check_emitters(file: SceneFile) -> None:
    if not file.nodes("Shape"):
        raise LumitreeError(f"{file.path} holds no shapes; expected a luminaire's geometry")
    kinds = [node.props.plugin_name() for node in file.nodes("Emitter")]
    environments = [kind for kind in kinds if kind in _ENVIRONMENTS]
    invisible = [kind for kind in kinds if kind in _INVISIBLE]
    if environments:
        raise LumitreeError(
            f"{file.path} holds an environment light ({environments[0]}), which does not belong "
            "to a luminaire; remove it from the file, or --keep only the lamp's shapes"
        )
    if invisible:
        raise LumitreeError(
            f"{file.path} holds a light without a surface ({invisible[0]}), which no camera can "
            "see; replace it by a small shape with an area emitter"
        )
    if not kinds:
        raise LumitreeError(
            f"{file.path} holds no emitter, so there is nothing to bake; give a shape an "
            '<emitter type="area">'
        )


def _fingerprint(file: SceneFile, source: LuminaireSource) -> str:
    """SHA-256 of the scene and its files; a model's overrides and selection are already in them."""
    digest = hashlib.sha256(read_limited(file.path))
    if file.path == Path(source.name) and (source.keep or source.drop):
        digest.update(repr((source.keep, source.drop)).encode())
    for path in file.references():
        digest.update(read_limited(path, _MAX_FILE_BYTES) if os.path.isfile(path) else b"")
    return digest.hexdigest()


def _bounding_radius(
    scene: Any, world_from_proxy: NDArray[np.float64], half_extents: NDArray[np.float64]
) -> float:
    """Largest distance of a vertex (of a box corner, for what is not a mesh) from the centre."""
    centre, scale = world_from_proxy[:3, 3], world_from_proxy[0, 0]
    farthest = 0.0
    for shape in scene.shapes():
        if shape.is_mesh():
            points = np.array(shape.vertex_positions_buffer()).reshape(-1, 3)
        else:
            low, high = np.ravel(shape.bbox().min), np.ravel(shape.bbox().max)
            points = np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)
        if len(points):
            farthest = max(farthest, float(np.linalg.norm(points - centre, axis=1).max()))
    return min(farthest / scale, float(np.linalg.norm(half_extents)))
