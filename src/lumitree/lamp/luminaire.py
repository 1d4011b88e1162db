"""A luminaire that has been loaded, and what can be given as one."""

import dataclasses
import functools
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.frames import LocalFrame
from lumitree.errors import LumitreeError, shown
from lumitree.lamp.scene_file import SceneFile
from lumitree.lamp.scene_shapes import SceneShape
from lumitree.lamp.source import LuminaireSource

if TYPE_CHECKING:
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
        file: the parsed file of `scene`, of which its shapes can be created again in another place;
            None for a `mi.Scene`.
        origin: [3] origin of the scene's coordinates, in the frame of the luminaire's file. It is
            (0, 0, 0), but for a lamp far from there, whose coordinates in float32 would be coarse.
    """

    name: str
    fingerprint: str
    scene: Any
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
