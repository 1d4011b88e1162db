"""A luminaire that has been loaded, and its loading from files, dictionaries and scenes."""

import dataclasses
import functools
import hashlib
import os
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from lumitree.core.backend import in_turn, load_mitsuba
from lumitree.core.executor import packed, unpacked
from lumitree.core.frames import LocalFrame, float32_step, is_far
from lumitree.core.mitsuba_meshes import mesh_vertices
from lumitree.core.results import Json
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.lamp.builtin import BUILTIN
from lumitree.lamp.media import any_scatters, media_of
from lumitree.lamp.read_source import (
    Opened,
    check_emitters,
    fingerprint_of,
    luminaire_source,
    open_scene_file,
)
from lumitree.lamp.scene_file import SceneFile
from lumitree.lamp.scene_shapes import SceneShape, shape_of_object
from lumitree.lamp.scene_writer import model_shapes
from lumitree.lamp.source import LuminaireSource

if TYPE_CHECKING:
    import mitsuba as mi

    from lumitree.lamp.emitting_surfaces import EmittingSurfaces


@dataclasses.dataclass(frozen=True)
class Luminaire:
    """A luminaire that has been loaded and checked.

    Attributes:
        name: built-in name, or the file's folder and name.
        fingerprint: SHA-256 of the scene file and of every file that it refers to.
        scene: the Mitsuba scene, in the axes and units of the luminaire's file.
        has_media: whether there are participating media.
        scatters: whether one of them scatters light.
        frame: its local frame.
        bounding_radius: radius of the sphere around the centre of the bounding box that contains
            all geometry, local units.
        shapes: its shapes as the file names them, by which parts of it can be chosen.
        file: the parsed file of `scene`, which creates its shapes again in another place; None for
            a `mi.Scene`.
        origin: [3] origin of the scene's coordinates, in the frame of the luminaire's file. It is
            (0, 0, 0), but for a lamp far from there, whose coordinates in float32 would be coarse.
    """

    name: str
    fingerprint: str
    scene: "mi.Scene"
    has_media: bool
    scatters: bool
    frame: LocalFrame
    bounding_radius: float
    shapes: tuple[SceneShape, ...]
    file: SceneFile | None = None
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

    @functools.cached_property
    def emitting_surfaces(self) -> "EmittingSurfaces":
        """Its surfaces that emit, on the device."""
        from lumitree.lamp.emitting_surfaces import emitting_surfaces

        return emitting_surfaces(self.scene)

    @property
    def parsed(self) -> SceneFile:
        """Its parsed file.

        Raises:
            LumitreeError: it was made from a `mi.Scene`.
        """
        if self.file is None:
            raise LumitreeError(
                f"{self.name} was made from a mi.Scene, whose shapes cannot be moved; give "
                "its dictionary or its file"
            )
        return self.file


LuminaireLike = str | os.PathLike[str] | LuminaireSource | Luminaire | Mapping[str, Any]
"""Types that are accepted as a luminaire, and `mi.Scene`, whose class depends on the variant."""


def builtin_luminaires() -> dict[str, Json]:
    """Describe the built-in luminaires.

    Returns:
        Dictionary from the name to a dictionary with `description`; the numbers of `triangles`
        and of `emitters`; `emitted_radiance`, the largest radiance of any emitter and channel,
        W/(m² sr); `size`, the sides of the bounding box, m; and `has_media`, whether there are
        participating media.
    """
    return {name: lamp.figures() for name, lamp in BUILTIN.items()}


@in_turn
def load_luminaire(
    luminaire: LuminaireLike | Any,
    *,
    materials: str | os.PathLike[str] | None = None,
    keep: Sequence[str] = (),
    drop: Sequence[str] = (),
    variant: str | None = None,
) -> Luminaire:
    """Load and check a luminaire, to use it in several calls or to select its parts.

    Args:
        luminaire: name of a built-in luminaire; path of a Mitsuba 3 scene (`.xml`) or of a model
            (`.obj`, `.gltf`, `.glb`); a dictionary as for `mitsuba.load_dict`; or a
            `mitsuba.Scene`.
        materials: path of a TOML file that overrides materials, unit and up axis of a model.
            Default: the file with the model's name and the suffix `.toml`, if there is one.
        keep: patterns, with `*` and `?`, of the shapes to take: ids of shapes or of their BSDFs in
            a Mitsuba scene, names of parts or of materials in a model. In a Mitsuba scene "#3" is
            the shape with this number, as `preview` lists it. Default: all.
        drop: patterns of the shapes to leave out. Default: none.
        variant: Mitsuba variant; see `bake`.

    Returns:
        The luminaire, which all functions accept in place of a name or file.

    Raises:
        LumitreeError: the name is unknown; a file cannot be read; a pattern matches nothing; or
            there is no geometry, no area emitter, or an emitter that is not a surface.
    """
    mi = load_mitsuba(variant)
    if materials is not None or keep or drop:
        if not isinstance(luminaire, str | os.PathLike):
            raise LumitreeError("materials, keep and drop are for built-in names and files")
        chosen = None if materials is None else os.fspath(materials)
        luminaire = LuminaireSource(os.fspath(luminaire), chosen, keep, drop)
    if isinstance(luminaire, Luminaire):
        return luminaire
    if isinstance(luminaire, mi.Scene):
        return _luminaire_of_scene(cast("mi.Scene", luminaire))
    return _luminaire_of_source(luminaire)


def _luminaire_of_source(luminaire: Opened) -> Luminaire:
    source = luminaire_source(luminaire)
    file = open_scene_file(source)
    media = file.nodes("Medium")
    _check_media(str(file.path), {node.props.plugin_name() for node in media})
    # Many files are called luminaire.xml, so the name includes the folder.
    path = Path(source.name)
    name = source.name if source.name in BUILTIN else f"{path.resolve().parent.name}/{path.stem}"
    if isinstance(luminaire, Mapping):
        name = str(luminaire.get("id", "dictionary"))
    for note in file.notes:
        warnings.warn(f"{name}: {note}", LumitreeWarning, stacklevel=2)
    shapes = file.shapes if file.path == path else model_shapes(file.shapes)
    # Shapes that are much too small for their coordinates may not even be created.
    origin = _origin_near(file.analytic_box(), tolerance=100)
    placed = file.recentred(origin) if origin.any() else file
    scene = placed.instantiate()
    offset = _origin_near(np.array([scene.bbox().min, scene.bbox().max], np.float64).reshape(2, 3))
    if offset.any():
        origin += offset
        placed = file.recentred(origin)
        scene = placed.instantiate()
    fingerprint = fingerprint_of(file, source)
    return _luminaire(name, fingerprint, scene, bool(media), shapes, placed, origin)


def _origin_near(box: NDArray[np.float64], tolerance: float = 1) -> NDArray[np.float64]:
    """[3] an origin near a box [2, 3], if its coordinates are too coarse in float32; else 0.

    They may be `tolerance` times as coarse.
    """
    # Not even the size of a damaged lamp need be finite.
    with np.errstate(over="ignore", invalid="ignore"):
        size = tolerance * np.ptp(box, axis=0).max()
    if not np.isfinite(box).all() or not is_far(box, size):
        return np.zeros(3)
    # Exact in float32, so that vertices of mesh files are moved exactly.
    return box.mean(axis=0).astype(np.float32).astype(np.float64)


def _luminaire(
    name: str,
    fingerprint: str,
    scene: "mi.Scene",
    has_media: bool,
    shapes: tuple[SceneShape, ...],
    file: SceneFile | None,
    origin: NDArray[np.float64],
) -> Luminaire:
    frame = LocalFrame.of_box(np.ravel(scene.bbox().min), np.ravel(scene.bbox().max))
    return Luminaire(
        name=name,
        fingerprint=fingerprint,
        scene=scene,
        has_media=has_media,
        scatters=has_media and any_scatters(scene),
        frame=frame.moved(origin) if origin.any() else frame,
        bounding_radius=_bounding_radius(scene, frame),
        shapes=shapes,
        file=file,
        origin=origin,
    )


def _luminaire_of_scene(scene: "mi.Scene") -> Luminaire:
    """The luminaire of a `mi.Scene`."""
    shapes = tuple(shape_of_object(*item) for item in enumerate(scene.shapes()))
    loose = [each.class_name() for each in scene.emitters() if each.get_shape() is None]
    check_emitters("the scene", shapes, loose, [each.class_name() for each in scene.emitters()])
    media = {medium.class_name() for medium in media_of(scene.shapes())}
    _check_media("the scene", {"homogeneous" if "Homogeneous" in name else name for name in media})
    digest = hashlib.sha256(repr(scene).encode())
    for key, value in load_mitsuba().traverse(scene):
        digest.update(key.encode())
        is_array = hasattr(value, "numpy")
        digest.update(np.array(value).tobytes() if is_array else repr(value).encode())
    fingerprint = digest.hexdigest()
    luminaire = _luminaire("scene", fingerprint, scene, bool(media), shapes, None, np.zeros(3))
    if luminaire.frame.is_far:
        step, size = float32_step(luminaire.frame.centre), luminaire.size.max()
        warnings.warn(
            "the scene is so far from its origin that its coordinates are rounded to multiples of "
            f"{step:.2g}, {step / size:.2%} of the lamp's size; move it to the origin, or give its "
            "file or its dictionary",
            LumitreeWarning,
            stacklevel=3,
        )
    return luminaire


def _check_media(what: str, kinds: set[str]) -> None:
    if kinds - {"homogeneous"}:
        raise LumitreeError(f"{what} has a heterogeneous medium; use homogeneous media")


def _bounding_radius(scene: "mi.Scene", frame: LocalFrame) -> float:
    """Largest distance from the centre to a vertex, or to a box corner of a shape without any."""
    farthest = 0.0
    for shape in scene.shapes():
        if shape.is_mesh():
            points = mesh_vertices(shape)
        else:
            low, high = np.ravel(shape.bbox().min), np.ravel(shape.bbox().max)
            points = np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)
        if len(points):
            farthest = max(farthest, float(np.linalg.norm(points - frame.centre, axis=1).max()))
    return min(farthest / frame.scale, float(np.linalg.norm(frame.half_extents)))


@dataclasses.dataclass(frozen=True)
class LampWorkers:
    """An executor of workers, and the luminaire that they load by `received_luminaire`."""

    executor: Executor
    luminaire: bytes


def lamp_workers(
    executor: Executor | None, source: LuminaireLike, luminaire: Luminaire
) -> LampWorkers | None:
    """Workers that load a luminaire as this process did; None without an executor.

    Args:
        executor: of the workers.
        source: what `load_luminaire` was given.
        luminaire: what it returned.

    Raises:
        LumitreeError: the source cannot be sent to other processes.
    """
    if executor is None:
        return None
    sent = absolute_source(source), luminaire.fingerprint
    return LampWorkers(executor, packed(sent, luminaire.name, "its path"))


@functools.lru_cache(maxsize=1)
def received_luminaire(data: bytes) -> Luminaire:
    """The luminaire that was sent to this process; its warnings are given where it was sent.

    Raises:
        LumitreeError: its files differ from the files of the process that sent it.
    """
    source, fingerprint = unpacked(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LumitreeWarning)
        luminaire = load_luminaire(source)
    if luminaire.fingerprint != fingerprint:
        raise LumitreeError(
            f"{luminaire.name} differs between a worker and the process that sent the task; give "
            "all the same files, and do not change them meanwhile"
        )
    return luminaire


def absolute_source(source: Any) -> Any:
    """A source of light, or a scene, with absolute paths: workers may run in another folder.

    Raises:
        LumitreeError: it is a loaded luminaire.
    """
    if isinstance(source, Luminaire):
        raise LumitreeError(
            f"{source.name} is loaded already, and cannot be sent to other processes; give its "
            "name, its path, its LuminaireSource or its dictionary"
        )
    if isinstance(source, LuminaireSource):
        materials = None if source.materials is None else os.path.abspath(source.materials)
        return dataclasses.replace(source, name=absolute_source(source.name), materials=materials)
    if isinstance(source, str | os.PathLike) and os.fspath(source) not in BUILTIN:
        return os.path.abspath(source)
    return source
