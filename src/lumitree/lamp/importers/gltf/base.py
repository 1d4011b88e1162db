"""The metallic-roughness core of a glTF material."""

import dataclasses

import numpy as np

from lumitree.lamp.importers.gltf.item import Item
from lumitree.lamp.importers.gltf.layers import Layers
from lumitree.lamp.importers.gltf.maps import Array, Map, constant


@dataclasses.dataclass(frozen=True)
class Base:
    """The metallic-roughness core of a material; all but the colour (RGB) have one channel."""

    colour: Map
    alpha: Map
    metallic: Map
    roughness: Map


def read_base(layers: Layers) -> Base:
    """The core of a material, converted from specular-glossiness where it is given so."""
    other = layers.item.extension("KHR_materials_pbrSpecularGlossiness")
    if other is not None:
        return _from_specular_glossiness(layers, other)
    core = layers.item.item("pbrMetallicRoughness")
    texture = "metallicRoughnessTexture"
    return Base(
        layers.colour(core, "baseColor", (1.0, 1.0, 1.0, 1.0)),
        _alpha(layers, core, "baseColor"),
        layers.value(core, "metallicFactor", 1.0, "B", texture),
        layers.value(core, "roughnessFactor", 1.0, "G", texture),
    )


def _alpha(layers: Layers, parent: Item, name: str) -> Map:
    if layers.item.string("alphaMode", "OPAQUE") == "OPAQUE":
        return constant(1.0)
    factor = parent.numbers(f"{name}Factor", (1.0, 1.0, 1.0, 1.0), 0.0)[3]
    texture = layers.texture(parent, f"{name}Texture", "A")
    return constant(factor) if texture is None else texture.scaled(factor)


def _from_specular_glossiness(layers: Layers, item: Item) -> Base:
    """Metallic-roughness of similar appearance, by the conversion that Khronos published."""
    layers.note("specular-glossiness (converted to metallic-roughness)")
    diffuse = layers.colour(item, "diffuse", (1.0, 1.0, 1.0, 1.0))
    texture = "specularGlossinessTexture"
    specular = constant(*item.numbers("specularFactor", (1.0, 1.0, 1.0), 0.0, 1.0))
    if (found := layers.texture(item, texture, "RGB", encoded=True)) is not None:
        specular = found.scaled(*specular.mean())
    gloss = layers.value(item, "glossinessFactor", 1.0, "A", texture)
    metallic = layers.combined(_metallic, diffuse, specular)

    def colour(diffuse: Array, specular: Array, metallic: Array) -> Array:
        strength = 1 - specular.max(axis=2, keepdims=True)
        from_diffuse = diffuse * strength / 0.96 / np.maximum(1 - metallic, 1e-6)
        from_specular = (specular - 0.04 * (1 - metallic)) / np.maximum(metallic, 1e-6)
        return np.clip(from_diffuse + (from_specular - from_diffuse) * metallic**2, 0, 1)

    return Base(
        layers.combined(colour, diffuse, specular, metallic),
        _alpha(layers, item, "diffuse"),
        metallic,
        gloss.applied(lambda values: 1 - values),
    )


def _metallic(diffuse: Array, specular: Array) -> Array:
    def brightness(colour: Array) -> Array:
        return np.sqrt((colour**2 * np.array([0.299, 0.587, 0.114])).sum(axis=2, keepdims=True))

    shiny = brightness(specular)
    strength = 1 - specular.max(axis=2, keepdims=True)
    b = brightness(diffuse) * strength / 0.96 + shiny - 0.08
    root = np.sqrt(np.maximum(b * b - 0.16 * (0.04 - shiny), 0))
    return np.where(shiny < 0.04, 0.0, np.clip((root - b) / 0.08, 0, 1))
