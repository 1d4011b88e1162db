"""Patches of squares inside the box of a lamp, and what of the lamp is near them.

Symbols
    P       patches along a side of a rectangle
    side    of a rectangle: 0 is lit from above its axis, 1 from below; normals are + and - the axis
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.lamp.luminaire import Luminaire

Floats = NDArray[np.float64]

# Normals of the sides along a rectangle's axis.
NORMALS = (1.0, -1.0)
# Rays from the centre of a patch, which find the surfaces around it.
_RAYS = 2048


@dataclasses.dataclass(frozen=True)
class Rectangle:
    """A rectangle across the box, perpendicular to an axis of the local frame; it blocks no light.

    Attributes:
        axis: 0 to 2.
        height: place on the axis as a part of the box's side, 0 at its lower face, 1 at the upper.
        patches: P.
        part: of the box's other two sides that it covers, about the box's middle.
    """

    axis: int
    height: float
    patches: int
    part: float = 0.9

    @property
    def name(self) -> str:
        """Its axis and its height in percent."""
        return f"{'xyz'[self.axis]} {100 * self.height:g} %"

    @property
    def others(self) -> tuple[int, int]:
        """The axes along the patches' rows and columns."""
        first, second = (each for each in range(3) if each != self.axis)
        return first, second

    def level(self, half: Floats) -> float:
        """Local coordinate on the axis, in a box of half extents [3]."""
        return float((2 * self.height - 1) * half[self.axis])

    def steps(self, half: Floats) -> Floats:
        """[2] local lengths of a patch."""
        return 2 * self.part * half[list(self.others)] / self.patches

    def points(self, half: Floats, inside: Floats) -> Floats:
        """Points [P², K, 3] at places in each patch.

        Args:
            half: [3] half extents of the box.
            inside: [P², K, 2] places in a patch, 0 to 1.
        """
        rows, columns = np.divmod(np.arange(self.patches**2), self.patches)
        cells = np.stack([rows, columns], axis=1)[:, None] + inside
        points = np.full((*inside.shape[:2], 3), self.level(half))
        points[..., list(self.others)] = (cells - self.patches / 2) * self.steps(half)
        return points


def surroundings(luminaire: Luminaire, rectangle: Rectangle) -> tuple[Floats, Floats]:
    """Surfaces that rays from the centres of the patches hit.

    Returns:
        [P, P] distance to the nearest surface of the luminaire, local units; and [P, P] share of
        the rays that leave the luminaire without crossing a surface.
    """
    import mitsuba as mi

    from lumitree.core.device import on_device

    side = rectangle.patches
    centres = rectangle.points(luminaire.frame.half_extents, np.full((side**2, 1, 2), 0.5))[:, 0]
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(_RAYS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    matrix = luminaire.scene_frame.world_from_local
    origins = np.repeat(centres @ matrix[:3, :3].T + matrix[:3, 3], _RAYS, axis=0)
    towards = np.tile(directions @ luminaire.scene_frame.rotation.T, (side**2, 1))
    ray = mi.Ray3f(on_device(mi.Point3f, origins), on_device(mi.Vector3f, towards))
    distance = np.array(luminaire.scene.ray_intersect_preliminary(ray).t, np.float64)
    distance = distance.reshape(side, side, _RAYS) / luminaire.frame.scale
    return distance.min(axis=-1), np.isinf(distance).mean(axis=-1)
