"""Conversion of glTF materials to materials of the model."""

import dataclasses
import re

import numpy as np

from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.errors import shown
from lumitree.lamp.importers.gltf.base import Base, read_base
from lumitree.lamp.importers.gltf.container import Document
from lumitree.lamp.importers.gltf.images import GltfImages
from lumitree.lamp.importers.gltf.item import Item
from lumitree.lamp.importers.gltf.layers import Layers
from lumitree.lamp.importers.gltf.maps import Array, Map, Textures, constant, uv_transform
from lumitree.lamp.importers.gltf.notes import Notes
from lumitree.lamp.importers.gltf.surfaces import note_ignored, read_surface, read_volume
from lumitree.lamp.importers.images import Images
from lumitree.lamp.importers.mesh_faces import painted
from lumitree.lamp.names import Names
from lumitree.lamp.parts import RGB, Material, Surface, Texture


@dataclasses.dataclass(frozen=True)
class Use:
    """Properties of a mesh that the conversion of its material depends on.

    `closed` means solid (`lamp.importers.topology`); `mirrored` is about its texture coordinates,
    `coloured` about its vertices; `scale` is its unit, metres.
    """

    closed: bool = False
    mirrored: bool = False
    coloured: bool = False
    scale: float = 1.0


def safe_name(wanted: str) -> str:
    """`wanted` with what does not fit into file names and XML replaced."""
    return re.sub(r"[^A-Za-z0-9]+", "_", wanted).strip("_")[:48] or "unnamed"


class Materials:
    """Converts materials, each once for every use."""

    def __init__(self, document: Document, notes: Notes, names: Names) -> None:
        self._document, self._notes, self._names = document, notes, names
        images = Images()
        self._textures = Textures(images, GltfImages(document, images))
        self._layers: dict[int | None, Layers] = {}
        # Unique, also where a file has two materials of one name.
        self._titles = Names("_")
        self._title_of: dict[int | None, str] = {}
        self._read: dict[tuple[int | None, Use], tuple[Material, RGB | None]] = {}

    @property
    def all(self) -> tuple[Material, ...]:
        """Every material read so far."""
        return tuple(material for material, _ in self._read.values())

    def layers(self, index: int | None) -> Layers:
        """The layers of a material; None is glTF's default material."""
        if index not in self._layers:
            if index is None:
                item, name = Item({}, f"{self._document.name}: default material"), "default"
            else:
                item = self._document.entry("materials", index)
                name = item.string("name", f"#{index}")
            self._layers[index] = Layers(item, name, self._textures, self._notes)
        return self._layers[index]

    def depends_on_closure(self, index: int | None) -> bool:
        """Whether the conversion depends on whether the mesh is closed."""
        layers = self.layers(index)
        emits = any(layers.item.numbers("emissiveFactor", (0.0, 0.0, 0.0), 0.0))
        return self.solid(index) or (emits and layers.item.flag("doubleSided"))

    def solid(self, index: int | None) -> bool:
        """Whether a closed mesh with this material is a solid that transmits light."""
        layers = self.layers(index)
        transmits = layers.item.extension("KHR_materials_transmission") is not None
        return transmits and read_volume(layers).thickness > 0

    def bumpy(self, index: int | None) -> bool:
        """Whether it has a normal map."""
        return "normalTexture" in self.layers(index).item

    def read(self, index: int | None, use: Use) -> tuple[Material, RGB | None]:
        """A material, and the factor of its mesh's vertex colours; None where it ignores them."""
        key = (index, use)
        if key not in self._read:
            self._read[key] = self._convert(index, use)
        return self._read[key]

    def _convert(self, index: int | None, use: Use) -> tuple[Material, RGB | None]:
        layers = self.layers(index)
        item = layers.item
        note_ignored(layers)
        base = read_base(layers)
        solid = use.closed and self.solid(index)
        thickness = read_volume(layers).thickness * use.scale
        surface = read_surface(layers, self._textures, base, solid, thickness)
        factor = None
        if use.coloured:
            surface, factor = _painted(layers, surface, base)
        if index not in self._title_of:
            self._title_of[index] = self._titles.unique(layers.name)
        opacity = _opacity(layers, base)
        radiance = _radiance(layers)
        if not radiance.black() and item.flag("doubleSided") and not use.closed:
            layers.note("emission (from the front only)")
        material = Material(
            self._names.unique(safe_name(layers.name)),
            surface,
            None if radiance.black() else self._textures.radiance(radiance),
            self._textures.value(opacity),
            self._normal_map(layers, use.mirrored),
            item.flag("doubleSided"),
            self._title_of[index],
        )
        return material, factor

    def _normal_map(self, layers: Layers, mirrored: bool) -> Texture | None:
        """Normals for the tangent frame that Mitsuba builds: along u, and across it.

        The second axis of glTF's frame points up in the image. That of Mitsuba's frame does so
        too, but points down where the texture coordinates are mirrored. A rotated texture rotates
        both axes of glTF's frame.
        """
        texture = layers.texture(layers.item, "normalTexture", "RGB")
        if texture is None:
            return None
        info = layers.item.item("normalTexture")
        scale = info.number("scale", 1.0)
        # Columns: how the mesh's (u, v) change along the image's (u, v).
        inverse = np.linalg.pinv(uv_transform(info)[:2, :2])
        axes = inverse / np.maximum(np.linalg.norm(inverse, axis=0), 1e-12)
        # Both v axes point down, both frames' second axes up.
        turn = np.array([[axes[0, 0], -axes[0, 1]], [-axes[1, 0], axes[1, 1]]])
        if mirrored:
            turn[1] *= -1

        def framed(values: Array) -> Array:
            normal = 2 * values - 1
            normal[..., :2] = scale * normal[..., :2] @ turn.T.astype(values.dtype)
            normal[..., 2] = np.maximum(normal[..., 2], 1e-3)
            normal /= np.linalg.norm(normal, axis=2, keepdims=True)
            return normal / 2 + 0.5

        return self._textures.data(layers.combined(framed, texture))


def _painted(layers: Layers, surface: Surface, base: Base) -> tuple[Surface, RGB | None]:
    """A surface with the mesh's vertex colours, and their factor."""
    if layers.item.string("alphaMode", "OPAQUE") != "OPAQUE":
        layers.note("opacity of the vertex colours")
    result = painted(surface) if base.colour.constant else None
    if result is None:
        layers.note("vertex colours (left out: glass or a texture has the colour)")
        return surface, None
    red, green, blue = base.colour.mean()
    return result, (red, green, blue)


def _opacity(layers: Layers, base: Base) -> Map:
    mode = layers.item.string("alphaMode", "OPAQUE")
    if mode == "OPAQUE":
        return constant(1.0)
    if mode == "BLEND":
        return base.alpha.applied(lambda values: np.clip(values, 0, 1))
    if mode != "MASK":
        raise layers.item.error(
            f"has alphaMode {shown(mode, 20)!r}; expected OPAQUE, MASK or BLEND"
        )
    cutoff = layers.item.number("alphaCutoff", 0.5, 0.0)
    return base.alpha.applied(lambda values: (values >= cutoff).astype(values.dtype))


def _radiance(layers: Layers) -> Map:
    """Emitted radiance, W/(m² sr), from the file's cd/m²."""
    extension = layers.item.extension("KHR_materials_emissive_strength")
    strength = 1.0 if extension is None else extension.number("emissiveStrength", 1.0, 0.0)
    emitted = layers.colour(layers.item, "emissive", (0.0, 0.0, 0.0), np.inf)
    return emitted.scaled(strength / LUMENS_PER_WATT)
