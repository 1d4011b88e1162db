"""Materials of an asset's geometry by metalness, roughness and transmission, as glTF and USD share.

What has no equal there is replaced by the nearest, and noted in `PbrMaterials.lost`.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from lumitree.asset.asset import NO_GAIN
from lumitree.asset.geometry import AssetGeometry
from lumitree.asset.geometry_media import scattering_sides, side_medium
from lumitree.asset.textures import ImageFacts, Json
from lumitree.core.photometry import RGB
from lumitree.lamp.scene_writer import normal_reflectance
from lumitree.output.optics import (
    LOST_REFLECTANCE,
    clearcoat_roughness,
    has_reflectance_factor,
    plastic_index,
    principled_index,
    relative_index,
)

_WHITE: RGB = (1.0, 1.0, 1.0)
_LOST = {
    "conductor": "metals have their reflectance at normal incidence for all angles",
    "roughconductor": "metals have their reflectance at normal incidence for all angles",
    "bumpmap": "bump maps are left out",
}


@dataclasses.dataclass(frozen=True)
class Layer:
    """A parameter of a material: numbers, times the image of a texture.

    Attributes:
        factor: R, G and B; three equal numbers for what has one.
        texture: see `asset.textures`; None for 1.
        exponent: of the values of the texture.
    """

    factor: RGB = _WHITE
    texture: Json | None = None
    exponent: float = 1.0

    @property
    def number(self) -> float:
        """The factor of what has one number."""
        return self.factor[0]

    @property
    def is_black(self) -> bool:
        """Whether it is 0 everywhere."""
        return not any(self.factor)

    def scaled(self, factor: Any) -> "Layer":
        """The layer times a number, or one for each channel."""
        red, green, blue = (np.array(self.factor) * factor).tolist()
        return dataclasses.replace(self, factor=(red, green, blue))


def layer(value: Any, exponent: float = 1.0) -> Layer:
    """The layer of a parameter of `asset.materials`, raised to a power."""
    if isinstance(value, dict):
        return Layer(texture=value, exponent=exponent)
    red, green, blue = (np.broadcast_to(np.asarray(value, np.float64), 3) ** exponent).tolist()
    return Layer((red, green, blue))


_BLACK, _ONE = layer(0.0), layer(1.0)


@dataclasses.dataclass(frozen=True)
class PbrMaterial:
    """A material, and what its shape emits.

    Attributes:
        colour: of diffuse reflection, of a metal's reflection, or of transmission.
        metallic: 0 for dielectrics, 1 for metals.
        roughness: square root of the alpha of microfacets.
        index: of refraction.
        specular: factor on the reflection of a dielectric.
        transmission: part of the light that is not reflected and crosses the surface, unscattered
            but for its roughness.
        thin: the surface does not refract: it is a sheet.
        diffuse_transmission: part of the diffuse light that leaves on the other side.
        absorption: R, G and B, of what is behind a surface that refracts, per unit of length of
            the luminaire's file.
        opacity: part of the surface that is there.
        clearcoat, clearcoat_roughness, sheen: as in glTF.
        normal: texture of normals in the tangent space; None for the mesh's normals.
        two_sided: whether the back reflects as the front does.
        emission: radiance of the front, W/(m² sr), with the asset's gain; black for none.
    """

    colour: Layer = _ONE
    metallic: Layer = _BLACK
    roughness: Layer = _ONE
    index: float = 1.5
    specular: float = 1.0
    transmission: Layer = _BLACK
    thin: bool = False
    diffuse_transmission: float = 0.0
    absorption: RGB | None = None
    opacity: Layer = _ONE
    clearcoat: Layer = _BLACK
    clearcoat_roughness: float = 0.0
    sheen: Layer = _BLACK
    normal: Json | None = None
    normal_mirrored: bool = False
    two_sided: bool = False
    emission: Layer = _BLACK


class PbrMaterials:
    """Converts the materials of a geometry.

    `gain` [3] is a factor on the R, G and B of its emission; `lost` has one line for each property
    that is not carried over.
    """

    def __init__(self, geometry: AssetGeometry, gain: RGB = NO_GAIN) -> None:
        self._geometry, self._gain = geometry, gain
        self._images = [ImageFacts.of(image) for image in geometry.images]
        self.lost: set[str] = set()

    def of(self, shape: Json) -> PbrMaterial:
        """The material of a shape of the geometry, with its emission and the medium in it."""
        if "exterior" in shape:
            self.lost.add("media outside of a shape are left out")
        if scattering_sides(shape):
            self.lost.add("media absorb light and do not scatter it: opal glass is clear")
        found = self._converted(self._geometry.materials[shape["material"]])
        absorption = None
        if "interior" in shape and not found.thin:
            red, green, blue = side_medium(shape["interior"]).absorption.tolist()
            absorption = (red, green, blue)
        emission = _BLACK if shape["radiance"] is None else layer(shape["radiance"])
        return dataclasses.replace(
            found, absorption=absorption, emission=emission.scaled(self._gain)
        )

    def _converted(self, material: Json) -> PbrMaterial:
        kind, inner = material["type"], material.get("nested", [])
        if kind in _LOST:
            self.lost.add(_LOST[kind])
        if kind == "blendbsdf":
            return self._blend(material, inner)
        if inner:
            found = self._converted(inner[0])
            return self._modified(kind, material, found)
        if has_reflectance_factor(material):
            self.lost.add(LOST_REFLECTANCE)
        convert: Callable[[Json], PbrMaterial] = getattr(self, f"_{kind}")
        return convert(material)

    def _modified(self, kind: str, material: Json, found: PbrMaterial) -> PbrMaterial:
        if kind == "twosided":
            if len(material["nested"]) == 2:
                self.lost.add("two-sided materials have that of the front on both sides")
            return dataclasses.replace(found, two_sided=True)
        if kind == "mask":
            if found.opacity != _ONE:
                self.lost.add("of masks within masks the outer one is kept")
            return dataclasses.replace(found, opacity=layer(material.get("opacity", 0.5)))
        if kind == "normalmap":
            return dataclasses.replace(found, normal=material["normalmap"])
        return found

    def _blend(self, material: Json, inner: list[Json]) -> PbrMaterial:
        self.lost.add("of blended materials the one with the larger weight is kept")
        weight = material["weight"]
        if isinstance(weight, dict):
            weight = float(np.mean(self._images[weight["image"]].values))
        return self._converted(inner[int(weight > 0.5)])

    def _diffuse(self, material: Json) -> PbrMaterial:
        return PbrMaterial(layer(material.get("reflectance", 0.5)), specular=0.0)

    def _dielectric(self, material: Json) -> PbrMaterial:
        return self._glass(material, _BLACK)

    def _roughdielectric(self, material: Json) -> PbrMaterial:
        return self._glass(material, self._roughness(material))

    def _glass(self, material: Json, roughness: Layer) -> PbrMaterial:
        # Light crosses a solid twice, and is multiplied by the colour of the material once.
        colour = layer(material.get("specular_transmittance", 1.0), exponent=2)
        index = relative_index(material)
        if index < 1:
            self.lost.add("glass that faces inwards refracts as if it faced outwards")
            index = 1 / index
        return PbrMaterial(colour, roughness=roughness, index=index, transmission=_ONE)

    def _thindielectric(self, material: Json) -> PbrMaterial:
        colour = layer(material.get("specular_transmittance", 1.0))
        index = relative_index(material)
        return PbrMaterial(
            colour,
            roughness=_BLACK,
            index=max(index, 1 / index),
            transmission=_ONE,
            thin=True,
            two_sided=True,
        )

    def _conductor(self, material: Json) -> PbrMaterial:
        return self._metal(material, _BLACK)

    def _roughconductor(self, material: Json) -> PbrMaterial:
        return self._metal(material, self._roughness(material))

    def _metal(self, material: Json, roughness: Layer) -> PbrMaterial:
        tint = layer(material.get("specular_reflectance", 1.0))
        colour = tint.scaled(normal_reflectance(material))
        return PbrMaterial(colour, metallic=_ONE, roughness=roughness)

    def _plastic(self, material: Json) -> PbrMaterial:
        return self._coated(material, _BLACK)

    def _roughplastic(self, material: Json) -> PbrMaterial:
        return self._coated(material, self._roughness(material))

    def _coated(self, material: Json, roughness: Layer) -> PbrMaterial:
        colour = layer(material.get("diffuse_reflectance", 0.5))
        return PbrMaterial(colour, roughness=roughness, index=plastic_index(material))

    def _principled(self, material: Json) -> PbrMaterial:
        unknown = ("flatness", "spec_tint", "sheen_tint", "anisotropic")
        if any(material.get(name) for name in unknown):
            self.lost.add("flatness, tints and anisotropy of principled materials are left out")
        return PbrMaterial(
            layer(material.get("base_color", 0.5)),
            metallic=layer(material.get("metallic", 0.0)),
            roughness=layer(material.get("roughness", 0.5)),
            index=principled_index(material),
            transmission=layer(material.get("spec_trans", 0.0)),
            clearcoat=layer(material.get("clearcoat", 0.0)),
            clearcoat_roughness=clearcoat_roughness(material),
            sheen=layer(material.get("sheen", 0.0)),
        )

    def _lumitree_metallic_roughness(self, material: Json) -> PbrMaterial:
        if material.get("anisotropic"):
            self.lost.add("anisotropic roughness is replaced by its mean")
        thin = material.get("thin", False)
        return PbrMaterial(
            layer(material.get("base_color", 0.5)),
            metallic=layer(material.get("metallic", 0.0)),
            roughness=layer(material.get("roughness", 0.5)),
            index=material.get("eta", 1.5),
            specular=self._mean(material.get("specular", 1.0)),
            transmission=layer(material.get("spec_trans", 0.0)),
            thin=thin,
            two_sided=thin,
            diffuse_transmission=self._mean(material.get("diff_trans", 0.0)) / 2,
            clearcoat=layer(material.get("clearcoat", 0.0)),
            clearcoat_roughness=self._mean(material.get("clearcoat_roughness", 0.0)),
            sheen=layer(material.get("sheen", 0.0)),
        )

    def _mean(self, value: Any) -> float:
        if not isinstance(value, dict):
            return float(value)
        self.lost.add("some textures of reflection and transmission are replaced by their mean")
        image = self._geometry.images[value["image"]]
        return float(image.mean()) / (255 if image.dtype == np.uint8 else 1)

    def _principledthin(self, material: Json) -> PbrMaterial:
        return PbrMaterial(
            layer(material.get("base_color", 0.5)),
            roughness=layer(material.get("roughness", 0.5)),
            index=principled_index(material),
            transmission=layer(material.get("spec_trans", 0.0)),
            thin=True,
            two_sided=True,
            diffuse_transmission=self._mean(material.get("diff_trans", 0.0)) / 2,
            sheen=layer(material.get("sheen", 0.0)),
        )

    def _roughness(self, material: Json) -> Layer:
        """Square root of the alpha of microfacets."""
        alphas = [material[name] for name in ("alpha_u", "alpha_v") if name in material]
        if alphas:
            self.lost.add("anisotropic roughness is replaced by that along u")
        found = layer(alphas[0] if alphas else material.get("alpha", 0.1), exponent=0.5)
        return found if found.texture is not None else layer(min(found.number, 1.0))
