"""Point and spot lights of KHR_lights_punctual, as small emitting surfaces that cameras see."""

import numpy as np

from lumitree.errors import shown
from lumitree.importers.gltf.item import Item
from lumitree.importers.gltf.notes import Notes
from lumitree.model.geometry import Floats, Mesh, area_normals, lathe
from lumitree.model.model import RGB, Diffuse, Material, Part
from lumitree.model.photometry import LUMENS_PER_WATT

# Metres, about the size of a filament: small compared with a lamp, but large enough that paths
# hit it.
LIGHT_RADIUS = 0.005
_SEGMENTS = 32


def light_part(light: Item, world: Floats, name: str, notes: Notes) -> tuple[Part, Material] | None:
    """A light as a part and its material; None where it emits nothing or is directional.

    A point light becomes a sphere, a spot light a disk, of radius LIGHT_RADIUS. Their radiance
    is such that their luminous intensity, in cd, is that of the file.

    Args:
        light: its JSON.
        world: `world_from_node` [4, 4]; a light ignores its scale.
        name: of the part and the material.
        notes: where approximations are noted.

    Raises:
        LumitreeError: unknown type, or negative values.
    """
    kind = light.string("type", "none")
    colour = light.numbers("color", (1.0, 1.0, 1.0), 0.0)
    intensity = light.number("intensity", 1.0, 0.0)
    if kind not in ("point", "spot", "directional"):
        raise light.error(f"is of type {shown(kind, 20)!r}; expected point, spot or directional")
    if kind == "directional":
        notes.file("a directional light (it belongs to a room, not to a lamp)")
        return None
    if intensity == 0 or max(colour) == 0:
        return None
    if kind == "point":
        mesh = _sphere()
        # The mean projected area of a convex body is a quarter of its surface.
        area = _area(mesh) / 4
    else:
        mesh = _disk(world)
        area = _area(mesh)
        notes.file("the cone of a spot light (it emits like a small Lambertian disk)")
    red, green, blue = (intensity / area / LUMENS_PER_WATT * channel for channel in colour)
    radiance: RGB = (red, green, blue)
    place = np.eye(4)
    place[:3, 3] = world[:3, 3]
    material = Material(name, Diffuse((0.0, 0.0, 0.0)), radiance=radiance)
    return Part(name, mesh, name, (place,)), material


def _sphere() -> Mesh:
    angle = np.linspace(-np.pi / 2, np.pi / 2, _SEGMENTS // 2 + 1)
    profile = LIGHT_RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    profile[[0, -1], 0] = 0.0
    return lathe(profile, _SEGMENTS)


def _disk(world: Floats) -> Mesh:
    """A disk whose normal is the node's -z axis."""
    axis = -world[:3, 2]
    length = np.linalg.norm(axis)
    axis = axis / length if length > 0 else np.array([0.0, 0.0, -1.0])
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    angle = 2 * np.pi * np.arange(_SEGMENTS)[:, None] / _SEGMENTS
    ring = LIGHT_RADIUS * (np.cos(angle) * side + np.sin(angle) * np.cross(axis, side))
    around = np.arange(1, _SEGMENTS + 1)
    faces = np.stack([np.zeros_like(around), around, np.roll(around, -1)], axis=1)
    vertices = np.concatenate([np.zeros((1, 3)), ring]).astype(np.float64)
    return Mesh(vertices, np.broadcast_to(axis, vertices.shape).copy(), faces)


def _area(mesh: Mesh) -> float:
    return float(np.linalg.norm(area_normals(mesh.vertices, mesh.faces), axis=1).sum() / 2)
