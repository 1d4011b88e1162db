"""Figures of a lamp that need no rendering."""

import dataclasses

import numpy as np

from lumitree.core.images import linear_from_srgb
from lumitree.lamp.meshes import Floats
from lumitree.lamp.parts import Colour, Geometry, Glass, Material, Part, Texture, VertexColour


@dataclasses.dataclass(frozen=True)
class Figures:
    """A lamp in numbers, of all copies of all parts.

    `emitted_radiance` is the largest channel that any surface emits, W/(m² sr); `size` the sides of
    the bounding box, in the lamp's unit.
    """

    triangles: int
    emitters: int
    emitted_radiance: float
    size: tuple[float, float, float]
    has_media: bool


def figures(model: Geometry) -> Figures:
    """The figures of a lamp."""
    materials = {material.name: material for material in model.materials}
    emitting = [part for part in model.parts if materials[part.material].radiance is not None]
    boxes = np.array([_box(part, place) for part in model.parts for place in part.places])
    size = boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0)
    return Figures(
        triangles=sum(len(part.mesh.faces) * len(part.places) for part in model.parts),
        emitters=sum(len(part.places) for part in emitting),
        emitted_radiance=max(
            (_largest(materials[part.material].radiance, part) for part in emitting), default=0.0
        ),
        size=(float(size[0]), float(size[1]), float(size[2])),
        has_media=any(_has_medium(materials[part.material]) for part in model.parts),
    )


def _box(part: Part, place: Floats) -> tuple[Floats, Floats]:
    points = part.mesh.vertices @ place[:3, :3].T + place[:3, 3]
    return points.min(axis=0), points.max(axis=0)


def _largest(radiance: Colour | None, part: Part) -> float:
    """The largest channel of a radiance on a part."""
    if isinstance(radiance, Texture):
        value = float(radiance.pixels.max())
        if radiance.pixels.dtype != np.uint8:
            return value
        value /= 255
        return float(linear_from_srgb(value)) if radiance.encoded else value
    if isinstance(radiance, VertexColour):
        return 0.0 if part.mesh.colours is None else float(part.mesh.colours.max())
    return max(radiance or (0.0,))


def _has_medium(material: Material) -> bool:
    return isinstance(material.surface, Glass) and material.surface.medium is not None
