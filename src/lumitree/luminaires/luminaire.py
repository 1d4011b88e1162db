"""A luminaire: a Mitsuba scene that holds nothing but a lamp, and its local frame."""

import dataclasses
import functools
import hashlib
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.backend import load_mitsuba
from lumitree.core.frames import proxy_box, similarity_scale
from lumitree.errors import LumitreeError
from lumitree.luminaires.builtin.registry import BUILTIN
from lumitree.luminaires.scene_file import SceneFile
from lumitree.luminaires.scene_writer import write_scene

_ENVIRONMENTS = ("constant", "envmap", "sky", "sunsky", "directional")
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


def load_luminaire(source: str | os.PathLike[str]) -> Luminaire:
    """Load a built-in luminaire by name, or a Mitsuba 3 XML that holds one.

    Raises:
        LumitreeError: unknown name, unreadable file, or a scene that is no luminaire: without
            geometry, without area emitters, or with lights that cannot be baked.
    """
    path = luminaire_path(source)
    file = SceneFile(path)
    _check_emitters(file)
    media = file.nodes("Medium")
    if any(node.props.plugin_name() != "homogeneous" for node in media):
        raise LumitreeError(
            f"{path} holds a heterogeneous medium, whose straight-through opacity is not "
            "supported; use homogeneous media"
        )
    scene = file.instantiate()
    world_from_proxy, half_extents = proxy_box(
        np.ravel(scene.bbox().min), np.ravel(scene.bbox().max)
    )
    return Luminaire(
        # Many files are called luminaire.xml; their folder tells them apart.
        name=str(source) if str(source) in BUILTIN else f"{path.resolve().parent.name}/{path.stem}",
        path=path,
        fingerprint=_fingerprint(file),
        scene=scene,
        has_media=bool(media),
        world_from_proxy=world_from_proxy,
        half_extents=half_extents,
        bounding_radius=_bounding_radius(scene, world_from_proxy, half_extents),
    )


def luminaire_path(source: str | os.PathLike[str]) -> Path:
    """Scene file of a LUMINAIRE argument; a built-in is written out to a temporary folder."""
    if str(source) in BUILTIN:
        return _written_builtin(str(source))
    path = Path(source)
    if not path.exists():
        raise LumitreeError(
            f"no luminaire {str(source)!r}: neither a file nor built in "
            f"({', '.join(BUILTIN)}); see 'lumitree list'"
        )
    if path.suffix.lower() != ".xml":
        raise LumitreeError(f"{path} is not a Mitsuba 3 scene (.xml), the only format read so far")
    return path


def place_shapes(source: str | os.PathLike[str], scene_from_world: ArrayLike) -> dict[str, Any]:
    """Shapes of an explicit luminaire moved into a scene, for `mitsuba.load_dict`.

    Args:
        source: LUMINAIRE argument.
        scene_from_world: [4, 4] similarity from the luminaire's own frame. Interior media get
            denser as the luminaire gets smaller, so that it looks the same at every size.
    """
    mi = load_mitsuba()
    matrix = np.asarray(scene_from_world, np.float64)
    scale = similarity_scale(matrix, "placement")
    file = SceneFile(luminaire_path(source))
    _check_emitters(file)
    for node in file.nodes("Shape"):
        # The parser keeps transforms in double precision.
        own = node.props.get("to_world", mi.ScalarTransform4d())
        node.props["to_world"] = mi.ScalarTransform4d(matrix @ np.array(own.matrix))
    for node in file.nodes("Medium"):
        node.props["scale"] = node.props.get("scale", 1.0) / scale
    return {f"luminaire_{i}": shape for i, shape in enumerate(file.instantiate().shapes())}


@functools.cache
def _written_builtin(name: str) -> Path:
    folder = tempfile.TemporaryDirectory(prefix=f"lumitree-{name}-")
    _temporary_folders.append(folder)
    return write_scene(BUILTIN[name].build(), folder.name)


# Held until the process ends, when each removes itself.
_temporary_folders: list[tempfile.TemporaryDirectory[str]] = []


def _check_emitters(file: SceneFile) -> None:
    if not file.nodes("Shape"):
        raise LumitreeError(f"{file.path} holds no shapes; expected a luminaire's geometry")
    kinds = [node.props.plugin_name() for node in file.nodes("Emitter")]
    environments = [kind for kind in kinds if kind in _ENVIRONMENTS]
    invisible = [kind for kind in kinds if kind in _INVISIBLE]
    if environments:
        raise LumitreeError(
            f"{file.path} holds an environment light ({environments[0]}), which does not belong "
            "to a luminaire; remove it from the file"
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


def _fingerprint(file: SceneFile) -> str:
    digest = hashlib.sha256(file.path.read_bytes())
    for path in file.references():
        digest.update(path.read_bytes() if path.is_file() else b"")
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
