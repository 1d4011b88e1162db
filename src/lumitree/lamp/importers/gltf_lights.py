"""Point and spot lights of KHR_lights_punctual, as small emitting surfaces that cameras see."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.materials import Diffuse, Texture
from lumitree.core.photometry import LUMENS_PER_WATT, RGB
from lumitree.errors import shown
from lumitree.lamp.importers.gltf_document import Item, Notes
from lumitree.lamp.importers.model_files import Images
from lumitree.lamp.materials import Material
from lumitree.lamp.meshes import Floats, Mesh, area_normals, lathe, sphere
from lumitree.lamp.parts import Part

# Metres, about the size of a filament: small compared with a lamp, but large enough that paths
# hit it.
LIGHT_RADIUS = 0.005
_SEGMENTS = 32
# The emitter in the shade of a spot light: the smaller it is beside the shade, the sharper is
# the cone. The shade sees it under this part of the cone's angle, but not under less than this.
_BLUR, _MIN_BLUR = 1 / 30, 0.01
# Inner angles up to which the emitter is a disk; a wider cone would use little of its light.
_MAX_DISK = np.pi / 3
# Facets of the shade around the axis and along it, and rows of its opacity.
_FACETS, _RINGS, _ROWS = 128, 16, 256
# Rows of opacity end at the outer angle times this; there it is 1.
_MARGIN = 1 + 1 / 64
_BLACK = Diffuse(reflectance=(0.0, 0.0, 0.0))


def light_parts(
    light: Item, worlds: Sequence[Floats], name: str, notes: Notes, images: Images
) -> list[tuple[Part, Material]]:
    """A light as parts and their materials; none where it emits nothing or is directional.

    A point light becomes a sphere of radius LIGHT_RADIUS. A spot light becomes a smaller emitter in
    a black sphere of that radius, which transmits light by the cone's attenuation. Their radiance
    gives the luminous intensity of the file, cd. `worlds` are `world_from_node` [4, 4] of all nodes
    with the light, which ignores their scale. `name` is for the first part; a shade adds "_shade".
    """
    kind = light.string("type", "none")
    colour = light.numbers("color", (1.0, 1.0, 1.0), 0.0)
    intensity = light.number("intensity", 1.0, 0.0)
    if kind not in ("point", "spot", "directional"):
        raise light.error(f"is of type {shown(kind, 20)!r}; expected point, spot or directional")
    cone = _cone(light) if kind == "spot" else None
    if kind == "directional":
        notes.file("a directional light (it belongs to a room, not to a lamp)")
        return []
    if "range" in light:
        notes.file("the range of lights (there is no distance at which light ends)")
    if intensity == 0 or max(colour) == 0:
        return []
    emitter = sphere(LIGHT_RADIUS, _SEGMENTS)
    places = tuple(_place(world, turned=cone is not None) for world in worlds)
    # The mean projected area of a convex body is a quarter of its surface.
    area, others = _area(emitter) / 4, []
    if cone is not None:
        emitter, area, pixels = _spot(*cone)
        opacity = Texture(image=images.add(pixels), raw=True, wrap_mode="clamp")
        shade = Material(f"{name}_shade", _BLACK, opacity=opacity)
        mesh = _shade(cone[1])
        others = [(Part(shade.name, mesh, shade.name, places, in_metres=True), shade)]
    red, green, blue = (intensity / area / LUMENS_PER_WATT * channel for channel in colour)
    radiance: RGB = (red, green, blue)
    material = Material(name, _BLACK, radiance=radiance)
    part = Part(name, emitter, name, places, in_metres=True)
    return [(part, material), *others]


def attenuation(inner: float, outer: float, angle: Floats) -> Floats:
    """Intensity of a spot light at angles to its axis, over that on the axis.

    The recommended implementation of KHR_lights_punctual.
    """
    scale = 1 / max(0.001, np.cos(inner) - np.cos(outer))
    return np.clip((np.cos(angle) - np.cos(outer)) * scale, 0, 1) ** 2


def _cone(light: Item) -> tuple[float, float]:
    """Inner and outer angle, radians."""
    spot = light.item("spot")
    # Programs write both angles alike for a cone with a sharp edge, and π/2 in single precision.
    outer = min(spot.number("outerConeAngle", np.pi / 4, 0.0, np.pi / 2 + 1e-5), np.pi / 2)
    inner = min(spot.number("innerConeAngle", 0.0, 0.0), np.pi / 2)
    if not (inner <= outer and outer > 0):
        raise spot.error(
            f"has innerConeAngle {inner:g} and outerConeAngle {outer:g}; expected 0 <= inner < "
            "outer <= π/2"
        )
    return inner, outer


def _spot(inner: float, outer: float) -> tuple[Mesh, float, NDArray[np.float32]]:
    """Emitter about the origin, area that gives its intensity, and opacity [H, 1, 1] of its shade.

    Light crosses the shade at an angle θ in proportion to the attenuation over the emitter's
    projected area, which is in proportion to cos θ for a disk and the same everywhere for a sphere.
    """
    radius = LIGHT_RADIUS * max(outer * _BLUR, _MIN_BLUR)
    disk = inner <= _MAX_DISK
    emitter = lathe([[radius, 0.0], [0.0, 0.0]], _SEGMENTS) if disk else sphere(radius, _SEGMENTS)
    area = _area(emitter) if disk else _area(emitter) / 4
    samples = 16
    angle = (np.arange(_ROWS * samples) + 0.5) / (_ROWS * samples) * outer * _MARGIN
    transmitted = attenuation(inner, outer, angle)
    if disk:
        transmitted = np.where(transmitted > 0, transmitted / np.cos(angle), 0.0)
    brightest = float(transmitted.max())
    # Means over the solid angle of each row keep the flux.
    weights = np.sin(angle).reshape(_ROWS, samples)
    rows = (transmitted.reshape(_ROWS, samples) * weights).sum(axis=1) / weights.sum(axis=1)
    pixels = (1 - rows / brightest).astype(np.float32)[:, None, None]
    return emitter, area / brightest, pixels


def _shade(outer: float) -> Mesh:
    """Sphere; v is 0 at +y, and 1 where the rows of opacity end."""
    end = outer * _MARGIN
    angle = np.concatenate([np.linspace(np.pi, end, _RINGS + 1)[:-1], np.linspace(end, 0, _RINGS)])
    profile = LIGHT_RADIUS * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    profile[[0, -1], 0] = 0.0
    mesh = lathe(profile, _FACETS)
    height = np.clip(mesh.vertices[:, 1] / LIGHT_RADIUS, -1, 1)
    v = np.arccos(height) / end
    return dataclasses.replace(mesh, uv=np.stack([np.full_like(v, 0.5), v], axis=1))


def _place(world: Floats, turned: bool) -> Floats:
    """`world_from_part` [4, 4]; if `turned`, +y becomes the node's -z axis."""
    place = np.eye(4)
    place[:3, 3] = world[:3, 3]
    if turned:
        axis = -world[:3, 2]
        length = np.linalg.norm(axis)
        axis = axis / length if length > 0 else np.array([0.0, 0.0, -1.0])
        side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        side /= np.linalg.norm(side)
        place[:3, :3] = np.stack([side, axis, np.cross(side, axis)], axis=1)
    return place


def _area(mesh: Mesh) -> float:
    return float(np.linalg.norm(area_normals(mesh.vertices, mesh.faces), axis=1).sum() / 2)
