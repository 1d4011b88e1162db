"""Conversion of the reflection and transmission of glTF materials to surfaces of the model."""

import dataclasses

import numpy as np

from lumitree.lamp.importers.gltf.base import Base
from lumitree.lamp.importers.gltf.layers import Layers
from lumitree.lamp.importers.gltf.maps import Array, Map, Textures, constant
from lumitree.lamp.parts import RGB, Diffuse, Glass, Medium, Principled, Surface

# Roughness below which a surface is smooth: alpha would be less than 0.001, the smallest of
# Mitsuba's rough models.
SMOOTH = 0.03
# Limits of the index of refraction in the geometry of an asset. An attenuation colour of 0 has no
# logarithm.
_MIN_IOR, _MAX_IOR, _MIN_ATTENUATION = 1.001, 10.0, 1e-4


@dataclasses.dataclass(frozen=True)
class Volume:
    """KHR_materials_volume: thickness in the mesh's unit, 0 for a sheet; absorption per metre."""

    thickness: float
    absorption: RGB


def read_volume(layers: Layers) -> Volume:
    """The volume of a material; without the extension, a thin sheet."""
    extension = layers.item.extension("KHR_materials_volume")
    if extension is None:
        return Volume(0.0, (0.0, 0.0, 0.0))
    thickness = extension.number("thicknessFactor", 0.0, 0.0)
    colour = np.array(extension.numbers("attenuationColor", (1.0, 1.0, 1.0), 0.0, 1.0))
    absorption = (0.0, 0.0, 0.0)
    if "attenuationDistance" in extension:
        distance = extension.number("attenuationDistance", 1.0, 1e-9)
        red, green, blue = (-np.log(np.maximum(colour, _MIN_ATTENUATION)) / distance + 0.0).tolist()
        absorption = (red, green, blue)
    return Volume(thickness, absorption)


def read_surface(
    layers: Layers, textures: Textures, base: Base, solid: bool, thickness: float
) -> Surface:
    """The surface of a material.

    Light that crosses a solid is multiplied by the base colour once: by its square root at each of
    the two crossings. Light that crosses a thin sheet is multiplied at its only crossing. A thin
    sheet represents a solid of a thickness in metres.
    """
    if layers.item.extension("KHR_materials_unlit") is not None:
        layers.note("unlit (a diffuse reflector)")
        return Diffuse(textures.colour(base.colour))
    transmission = _transmission(layers)
    through = not transmission.black()
    scattered = _diffuse_transmission(layers, solid)
    volume = read_volume(layers)
    glass = (
        through
        and transmission.constant
        and transmission.mean() == (1.0,)
        and base.metallic.black()
        and base.colour.constant
        and base.roughness.constant
        and scattered == 0
        and (solid or base.roughness.mean()[0] <= SMOOTH)
    )
    if glass:
        return _glass(layers, base, volume, solid, thickness)
    thin = (through or scattered > 0) and not solid
    if through or scattered > 0:
        base = _absorbed(layers, base, volume, thickness)
    return _principled(layers, textures, base, transmission, scattered, thin)


def _glass(layers: Layers, base: Base, volume: Volume, solid: bool, thickness: float) -> Glass:
    coats = {"clear coat": _clearcoat(layers)[0], "sheen": _sheen(layers)}
    for name in (name for name, coat in coats.items() if not coat.black()):
        layers.note(f"{name} of clear glass (left out)")
    roughness = base.roughness.mean()[0]
    roughness = 0.0 if roughness <= SMOOTH else roughness
    ior = _reflection(layers, transmits=True)[0]
    if solid:
        absorbing = any(volume.absorption)
        medium = Medium(volume.absorption) if absorbing else None
        red, green, blue = np.sqrt(base.colour.mean()).tolist()
        return Glass(ior, roughness, (red, green, blue), medium=medium)
    red, green, blue = _absorbed(layers, base, volume, thickness).colour.mean()
    return Glass(ior, 0.0, (red, green, blue), thin=True)


def _principled(
    layers: Layers,
    textures: Textures,
    base: Base,
    transmission: Map,
    scattered: float,
    thin: bool,
) -> Principled:
    roughness, anisotropy = _anisotropy(layers, base.roughness)
    clearcoat, clearcoat_roughness = _clearcoat(layers)
    ior, specular = _reflection(layers, transmits=not transmission.black())
    return Principled(
        textures.colour(base.colour),
        textures.value(base.metallic),
        textures.value(roughness),
        textures.value(anisotropy),
        ior,
        textures.value(specular),
        sheen=textures.value(_sheen(layers)),
        clearcoat=textures.value(clearcoat),
        clearcoat_roughness=clearcoat_roughness,
        transmission=textures.value(transmission),
        diffuse_transmission=2 * scattered,
        thin=thin,
    )


def _absorbed(layers: Layers, base: Base, volume: Volume, thickness: float) -> Base:
    """With the base colour multiplied by the transmittance of the volume over its thickness."""
    if thickness == 0 or not any(volume.absorption):
        return base
    layers.note("attenuation (a tint, since the surface does not bound a clear solid)")
    left = np.exp(-thickness * np.array(volume.absorption)).tolist()
    return dataclasses.replace(base, colour=base.colour.scaled(*left))


def _transmission(layers: Layers) -> Map:
    extension = layers.item.extension("KHR_materials_transmission")
    if extension is None:
        return constant(0.0)
    return layers.value(extension, "transmissionFactor", 0.0, "R", "transmissionTexture")


def _diffuse_transmission(layers: Layers, solid: bool) -> float:
    """Share of the diffuse light that leaves on the other side of a thin sheet."""
    extension = layers.item.extension("KHR_materials_diffuse_transmission")
    if extension is None:
        return 0.0
    name = "diffuseTransmission"
    share = layers.value(extension, f"{name}Factor", 0.0, "A", f"{name}Texture")
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
        factor = layers.value(specular, "specularFactor", 1.0, "A", "specularTexture")
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
    coat = layers.value(extension, "clearcoatFactor", 0.0, "R", "clearcoatTexture")
    if coat.black():
        return coat, 0.0
    rough = layers.value(
        extension, "clearcoatRoughnessFactor", 0.0, "G", "clearcoatRoughnessTexture"
    )
    own = extension.item("clearcoatNormalTexture").index("index")
    if own != layers.item.item("normalTexture").index("index"):
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


def note_ignored(layers: Layers) -> None:
    """Note the extensions that have no counterpart in the model."""
    for name, key in (("iridescence", "iridescenceFactor"), ("dispersion", "dispersion")):
        extension = layers.item.extension(f"KHR_materials_{name}")
        if extension is not None and extension.number(key, 0.0, 0.0) > 0:
            layers.note(f"{name} (left out)")
