"""Conversion of glTF materials to materials of the model."""

import dataclasses
import re

import numpy as np

from lumitree.asset import materials as surfaces
from lumitree.asset.geometry import Medium
from lumitree.asset.materials import Texture, VertexColours
from lumitree.core.photometry import LUMENS_PER_WATT, RGB
from lumitree.errors import shown
from lumitree.lamp.importers.gltf_document import Document, Item, Notes
from lumitree.lamp.importers.gltf_maps import Array, Layers, Map, Textures, constant, uv_transform
from lumitree.lamp.materials import Material, glass
from lumitree.lamp.parts import Names

# Roughness below which a surface is smooth: alpha would be less than 0.001, the smallest of
# Mitsuba's rough models.
SMOOTH = 0.03
# Limits of the index of refraction in the geometry of an asset. An attenuation colour of 0 has no
# logarithm.
_MIN_IOR, _MAX_IOR, _MIN_ATTENUATION = 1.001, 10.0, 1e-4


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
        layers.value(core, "metallic", 1.0, "B", texture),
        layers.value(core, "roughness", 1.0, "G", texture),
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
    gloss = layers.value(item, "glossiness", 1.0, "A", texture)
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


@dataclasses.dataclass(frozen=True)
class Volume:
    """KHR_materials_volume: thickness in the mesh's unit, 0 for a sheet; absorption per metre."""

    thickness: float = 0.0
    absorption: RGB = (0.0, 0.0, 0.0)


def read_volume(layers: Layers) -> Volume:
    """The volume of a material; without the extension, a thin sheet."""
    extension = layers.item.extension("KHR_materials_volume")
    if extension is None:
        return Volume()
    thickness = extension.number("thicknessFactor", 0.0, 0.0)
    colour = np.array(extension.numbers("attenuationColor", (1.0, 1.0, 1.0), 0.0, 1.0))
    if "attenuationDistance" not in extension:
        return Volume(thickness)
    distance = extension.number("attenuationDistance", 1.0, 1e-9)
    red, green, blue = (-np.log(np.maximum(colour, _MIN_ATTENUATION)) / distance + 0.0).tolist()
    return Volume(thickness, (red, green, blue))


def read_surface(
    layers: Layers, textures: Textures, base: Base, solid: bool, thickness: float
) -> tuple[surfaces.Material, Medium | None]:
    """The surface of a material, and what fills it.

    Light that crosses a solid is multiplied by the base colour once: by its square root at each of
    the two crossings. Light that crosses a thin sheet is multiplied at its only crossing. A thin
    sheet represents a solid of a thickness in metres.
    """
    if layers.item.extension("KHR_materials_unlit") is not None:
        layers.note("unlit (a diffuse reflector)")
        return surfaces.Diffuse(reflectance=textures.colour(base.colour)), None
    extension = layers.item.extension("KHR_materials_transmission")
    transmission = constant(0.0)
    if extension is not None:
        transmission = layers.value(extension, "transmission", 0.0, "R")
    through = not transmission.black()
    scattered = _diffuse_transmission(layers, solid)
    volume = read_volume(layers)
    clear = (
        through
        and transmission.constant
        and transmission.mean() == (1.0,)
        and base.metallic.black()
        and base.colour.constant
        and base.roughness.constant
        and scattered == 0
        and (solid or base.roughness.mean()[0] <= SMOOTH)
    )
    if clear:
        return _glass(layers, base, volume, solid, thickness)
    thin = (through or scattered > 0) and not solid
    if through or scattered > 0:
        base = _absorbed(layers, base, volume, thickness)
    return _metallic_roughness(layers, textures, base, transmission, scattered, thin), None


def _glass(
    layers: Layers, base: Base, volume: Volume, solid: bool, thickness: float
) -> tuple[surfaces.Material, Medium | None]:
    for name, coat in (("clear coat", _clearcoat(layers)[0]), ("sheen", _sheen(layers))):
        if not coat.black():
            layers.note(f"{name} of clear glass (left out)")
    roughness = base.roughness.mean()[0]
    ior = _reflection(layers, transmits=True)[0]
    if solid:
        roughness = 0.0 if roughness <= SMOOTH else roughness
        medium = Medium(volume.absorption) if any(volume.absorption) else None
        red, green, blue = np.sqrt(base.colour.mean()).tolist()
        return glass(ior, roughness, (red, green, blue)), medium
    red, green, blue = _absorbed(layers, base, volume, thickness).colour.mean()
    return glass(ior, tint=(red, green, blue), thin=True), None


def _metallic_roughness(
    layers: Layers, textures: Textures, base: Base, transmission: Map, scattered: float, thin: bool
) -> surfaces.MetallicRoughness:
    roughness, anisotropy = _anisotropy(layers, base.roughness)
    clearcoat, clearcoat_roughness = _clearcoat(layers)
    ior, specular = _reflection(layers, transmits=not transmission.black())
    return surfaces.MetallicRoughness(
        base_color=textures.colour(base.colour),
        metallic=textures.value(base.metallic),
        roughness=textures.value(roughness),
        anisotropic=textures.value(anisotropy),
        eta=ior,
        specular=textures.value(specular),
        sheen=textures.value(_sheen(layers)),
        clearcoat=textures.value(clearcoat),
        clearcoat_roughness=clearcoat_roughness,
        spec_trans=textures.value(transmission),
        diff_trans=2 * scattered,
        thin=thin,
    )


def _absorbed(layers: Layers, base: Base, volume: Volume, thickness: float) -> Base:
    """With the base colour multiplied by the transmittance of the volume over its thickness."""
    if thickness == 0 or not any(volume.absorption):
        return base
    layers.note("attenuation (a tint, since the surface does not bound a clear solid)")
    left = np.exp(-thickness * np.array(volume.absorption)).tolist()
    return dataclasses.replace(base, colour=base.colour.scaled(*left))


def _diffuse_transmission(layers: Layers, solid: bool) -> float:
    """Share of the diffuse light that leaves on the other side of a thin sheet."""
    extension = layers.item.extension("KHR_materials_diffuse_transmission")
    if extension is None:
        return 0.0
    name = "diffuseTransmission"
    share = layers.value(extension, name, 0.0, "A")
    if share.black():
        return 0.0
    if solid:
        layers.note("diffuse transmission of a solid (left out)")
        return 0.0
    if f"{name}ColorFactor" in extension or f"{name}ColorTexture" in extension:
        layers.note("colour of the diffuse transmission (the base colour is used)")
    return layers.single(share, "texture of the diffuse transmission")[0]


def _reflection(layers: Layers, transmits: bool) -> tuple[float, Map]:
    """Index of refraction of the dielectric, and the factor of its reflection."""
    extension = layers.item.extension("KHR_materials_ior")
    ior = 1.5 if extension is None else extension.number("ior", 1.5, 0.0)
    if 0 < ior < 1 and extension is not None:
        raise extension.error(f"is damaged: ior is {ior:g}; expected 0, or at least 1")
    specular, factor = layers.item.extension("KHR_materials_specular"), constant(1.0)
    if ior > _MAX_IOR:
        layers.note(f"ior of {ior:g} ({_MAX_IOR:g} is used)")
    if transmits and specular is not None:
        layers.note("specular factors (light is refracted by the ior alone)")
    elif specular is not None:
        factor = layers.value(specular, "specular", 1.0, "A")
        colour = layers.colour(specular, "specularColor", (1.0, 1.0, 1.0), np.inf)
        tint = layers.single(colour, "texture of the specular colour")
        if max(tint) > min(tint):
            layers.note("specular colour (its mean is used)")
        # The colour is a factor of the reflectance at normal incidence.
        root = min(abs(ior - 1) / (ior + 1) * float(np.mean(tint)) ** 0.5, 1.0)
        # Beyond the largest ior the factor has the rest.
        largest = (_MAX_IOR - 1) / (_MAX_IOR + 1)
        excess = max(root / largest, 1.0) ** 2
        factor = factor.applied(lambda values: np.minimum(values * excess, 1))
        root = min(root, largest)
        ior = (1 + root) / (1 - root)
    if ior == 0:
        # It stands for an infinite one.
        ior = 1.5 if transmits else _MAX_IOR
    return min(max(ior, _MIN_IOR), _MAX_IOR), factor


def _clearcoat(layers: Layers) -> tuple[Map, float]:
    """The clear coat and its roughness."""
    extension = layers.item.extension("KHR_materials_clearcoat")
    if extension is None:
        return constant(0.0), 0.0
    coat = layers.value(extension, "clearcoat", 0.0, "R")
    if coat.black():
        return coat, 0.0
    rough = layers.value(extension, "clearcoatRoughness", 0.0, "G")
    normals = extension.item("clearcoatNormalTexture").index("index")
    if normals != layers.item.item("normalTexture").index("index"):
        layers.note("normals of the clear coat (the material's are used)")
    return coat, layers.single(rough, "texture of the clear coat's roughness")[0]


def _sheen(layers: Layers) -> Map:
    extension = layers.item.extension("KHR_materials_sheen")
    if extension is None:
        return constant(0.0)
    colour = layers.colour(extension, "sheenColor", (0.0, 0.0, 0.0))
    if not colour.black():
        layers.note("sheen (without its colour and roughness)")
    return layers.combined(lambda values: np.clip(values.max(axis=2, keepdims=True), 0, 1), colour)


def _anisotropy(layers: Layers, roughness: Map) -> tuple[Map, Map]:
    """Roughness and anisotropy along the texture coordinates' u axis.

    A highlight of glTF is stretched along a direction at an angle θ to u. Only its component along
    u is kept: the logarithm of the ratio of the two alphas is multiplied by cos 2θ. The product of
    the alphas is kept.
    """
    extension = layers.item.extension("KHR_materials_anisotropy")
    if extension is None:
        return roughness, constant(0.0)
    strength = extension.number("anisotropyStrength", 0.0, 0.0, 1.0)
    if strength == 0:
        return roughness, constant(0.0)
    rotation = extension.number("anisotropyRotation", 0.0)
    texture = layers.texture(extension, "anisotropyTexture", "RGB")
    if texture is None:
        texture = constant(1.0, 0.5, 1.0)

    def ellipse(roughness: Array, direction: Array) -> Array:
        across = np.maximum(roughness**2, 1e-3)
        along = across + (1 - across) * (strength * direction[..., 2:]) ** 2
        turn = np.arctan2(2 * direction[..., 1:2] - 1, 2 * direction[..., :1] - 1) + rotation
        ratio = (along / across) ** np.cos(2 * turn)
        # Mitsuba: alpha along u over alpha across it is 1 / (1 - 0.9 anisotropic).
        anisotropy = np.clip((1 - 1 / ratio) / 0.9, 0, 1)
        lost = (along > 1.01 * across) & (np.cos(2 * turn) < 0.98)
        mean = (along * across) ** 0.25
        return np.concatenate([mean, anisotropy, lost.astype(mean.dtype)], axis=2)

    result = layers.combined(ellipse, roughness, texture)
    if not result.channel(2).black():
        layers.note("anisotropy (only what lies along the texture coordinates)")
    return result.channel(0), result.channel(1)


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
        self._textures = Textures(document)
        self.images = self._textures.images
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
        if (index, use) not in self._read:
            self._read[index, use] = self._convert(index, use)
        return self._read[index, use]

    def _convert(self, index: int | None, use: Use) -> tuple[Material, RGB | None]:
        layers = self.layers(index)
        item = layers.item
        for name, key in (("iridescence", "iridescenceFactor"), ("dispersion", "dispersion")):
            extension = item.extension(f"KHR_materials_{name}")
            if extension is not None and extension.number(key, 0.0, 0.0) > 0:
                layers.note(f"{name} (left out)")
        base = read_base(layers)
        solid = use.closed and self.solid(index)
        thickness = read_volume(layers).thickness * use.scale
        surface, medium = read_surface(layers, self._textures, base, solid, thickness)
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
            medium,
        )
        return material, factor

    def _normal_map(self, layers: Layers, mirrored: bool) -> Texture | None:
        """Normals for the tangent frame that Mitsuba builds: along u, and across it.

        The second axis of glTF's frame points up in the image. Mitsuba's second axis does so
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


def _painted(
    layers: Layers, surface: surfaces.Material, base: Base
) -> tuple[surfaces.Material, RGB | None]:
    """The surface with the colours of its vertices, if it has them, and their factor."""
    if layers.item.string("alphaMode", "OPAQUE") != "OPAQUE":
        layers.note("opacity of the vertex colours")
    match surface:
        case surfaces.Diffuse() if base.colour.constant:
            painted = surfaces.Diffuse(reflectance=VertexColours())
        case surfaces.MetallicRoughness() if base.colour.constant:
            painted = dataclasses.replace(surface, base_color=VertexColours())
        case _:
            layers.note("vertex colours (left out: glass or a texture has the colour)")
            return surface, None
    red, green, blue = base.colour.mean()
    return painted, (red, green, blue)


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
