"""Loading of luminaires: built-in ones, files, dictionaries, and Mitsuba scenes."""

import dataclasses
import hashlib
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.backend import in_turn, load_mitsuba
from lumitree.core.frames import LocalFrame, float32_step
from lumitree.core.mitsuba_meshes import mesh_vertices
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.far_coordinates import origin_near, warn_of_far_meshes
from lumitree.lamp.luminaire import Luminaire, LuminaireLike
from lumitree.lamp.media import any_scatters
from lumitree.lamp.opening import Opened, fingerprint_of, luminaire_source, open_scene_file
from lumitree.lamp.probe import check_evaluates
from lumitree.lamp.scene_file import SceneFile
from lumitree.lamp.scene_shapes import SceneShape, shape_of_object
from lumitree.lamp.scene_writer import model_shapes
from lumitree.lamp.source import LuminaireSource


def builtin_luminaires() -> dict[str, dict[str, Any]]:
    """Describe the built-in luminaires.

    Returns:
        Dictionary from the name to a dictionary with `description`; the numbers of `triangles`
        and of `emitters`; `emitted_radiance`, the largest radiance of any emitter and channel,
        W/(m² sr); `size`, the sides of the bounding box, m; and `has_media`, whether there are
        participating media.
    """
    from lumitree.lamp.figures import figures

    return {
        name: {"description": item.description, **dataclasses.asdict(figures(item.build()))}
        for name, item in BUILTIN.items()
    }


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
        return _luminaire_of_scene(luminaire)
    return _luminaire_of_source(luminaire)


def _luminaire_of_source(luminaire: Opened) -> Luminaire:
    """The luminaire of a name, a file or a dictionary."""
    source = luminaire_source(luminaire)
    file = open_scene_file(source)
    media = file.nodes("Medium")
    _check_media(str(file.path), {node.props.plugin_name() for node in media})
    fingerprint = fingerprint_of(file, source)
    # Many files are called luminaire.xml, so the name includes the folder.
    path = Path(source.name)
    name = source.name if source.name in BUILTIN else f"{path.resolve().parent.name}/{path.stem}"
    if isinstance(luminaire, Mapping):
        name = str(luminaire.get("id", "dictionary"))
    for note in file.notes:
        warnings.warn(f"{name}: {note}", LumitreeWarning, stacklevel=2)
    shapes = file.shapes if file.path == Path(source.name) else model_shapes(file.shapes)
    # Shapes that are much too small for their coordinates may not even be created.
    origin = origin_near(file.analytic_box(), tolerance=100)
    placed = file.recentred(origin) if origin.any() else file
    scene = placed.instantiate()
    corners = np.array([scene.bbox().min, scene.bbox().max], np.float64).reshape(2, 3)
    offset = origin_near(corners)
    if offset.any():
        origin += offset
        placed = file.recentred(origin)
        scene = placed.instantiate()
    loaded = _luminaire(name, fingerprint, scene, bool(media), shapes, placed, origin)
    centre = loaded.scene_frame.centre
    warn_of_far_meshes(name, float(loaded.size.max()), centre, placed.mesh_files())
    return loaded


def _luminaire(
    name: str,
    fingerprint: str,
    scene: Any,
    has_media: bool,
    shapes: tuple[SceneShape, ...],
    file: SceneFile | None = None,
    origin: NDArray[np.float64] | None = None,
) -> Luminaire:
    check_evaluates(scene, shapes, name)
    origin = np.zeros(3) if origin is None else origin
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
    if any(each.class_name() == "DirectionalArea" for each in scene.emitters()):
        raise LumitreeError(
            f"{what} holds a light that is invisible to cameras (directionalarea); replace it by a "
            "small shape with an area emitter"
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
        is_array = hasattr(value, "numpy")
        digest.update(np.array(value).tobytes() if is_array else repr(value).encode())
    shapes = tuple(shape_of_object(*item) for item in enumerate(scene.shapes()))
    luminaire = _luminaire("scene", digest.hexdigest(), scene, bool(media), shapes)
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


def _check_media(what: str, kinds: set[str]) -> None:
    if kinds - {"homogeneous"}:
        raise LumitreeError(
            f"{what} holds a heterogeneous medium, whose straight-through opacity is not "
            "supported; use homogeneous media"
        )


def _bounding_radius(scene: Any, frame: LocalFrame) -> float:
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
