"""Materials of an asset by metalness, roughness and transmission, for exporters and the viewer.

`converted` takes a material that modifies no other one. `flattened` takes any material, for formats
without mixtures of materials. A property without an equal is replaced by the nearest, and noted in
`PbrMaterial.lost`.
"""

import dataclasses
from collections.abc import Sequence

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from lumitree.asset.geometry import AssetGeometry, Shape
from lumitree.asset.materials import (
    Blend,
    BumpMap,
    Diffuse,
    DisneyMaterial,
    Glass,
    Image,
    ImageFacts,
    Mask,
    Material,
    Metal,
    MetallicRoughness,
    Microfacets,
    NormalMap,
    Parameter,
    Plastic,
    Principled,
    PrincipledThin,
    RoughPlastic,
    Texture,
    ThinDielectric,
    TwoSided,
    VertexColours,
)
from lumitree.core.photometry import RGB
from lumitree.lamp.materials import normal_reflectance

WHITE: RGB = (1.0, 1.0, 1.0)
# Mitsuba's alpha of microfacets.
_DEFAULT_ALPHA = 0.1


@dataclasses.dataclass(frozen=True)
class Layer:
    """A parameter of a material: numbers, times the values of a texture.

    Attributes:
        factor: R, G and B; three equal numbers for what has one.
        texture: None for 1.
        exponent: of the values of the texture.
    """

    factor: RGB = WHITE
    texture: Texture | VertexColours | None = None
    exponent: float = 1.0

    @property
    def number(self) -> float:
        """The factor of what has one number."""
        return self.factor[0]

    @property
    def image(self) -> Texture | None:
        """The texture, if it is an image."""
        return self.texture if isinstance(self.texture, Texture) else None

    @property
    def is_black(self) -> bool:
        """Whether it is 0 everywhere."""
        return not any(self.factor)

    def scaled(self, factor: ArrayLike) -> "Layer":
        """The layer times a number, or one for each channel."""
        red, green, blue = (np.array(self.factor) * factor).tolist()
        return dataclasses.replace(self, factor=(red, green, blue))

    def root(self) -> "Layer":
        """The square root of the layer."""
        red, green, blue = np.sqrt(self.factor).tolist()
        return Layer((red, green, blue), self.texture, self.exponent / 2)

    def mean(self, images: Sequence[Image]) -> float:
        """The mean of a layer that has one number."""
        if self.image is None:
            return self.number
        image = images[self.image.image]
        return self.number * float(image.mean()) / (255 if image.dtype == np.uint8 else 1)


def layer(value: Parameter | None, default: float = 1.0, exponent: float = 1.0) -> Layer:
    """The layer of a parameter of a material, raised to a power."""
    if isinstance(value, Texture | VertexColours):
        return Layer(texture=value, exponent=exponent)
    given = np.asarray(default if value is None else value, np.float64)
    red, green, blue = (np.broadcast_to(given, 3) ** exponent).tolist()
    return Layer((red, green, blue))


BLACK, ONE = layer(0.0), layer(1.0)


@dataclasses.dataclass(frozen=True)
class PbrMaterial:
    """A material, and what its shape emits.

    Attributes:
        colour: of diffuse reflection, of a metal's reflection, or of light that crosses a sheet, or
            both surfaces of a solid.
        metallic: 0 for dielectrics, 1 for metals.
        roughness: square root of the alpha of microfacets; along u if there is `roughness_v`.
        roughness_v: along v, if it may differ.
        anisotropy: stretches highlights as `principled` does.
        ggx: whether microfacets have the distribution of Trowbridge and Reitz, else Beckmann's.
        index: of refraction, behind over before the surface.
        specular: factor on the reflection of the dielectric layer.
        reflectance: factor on what glass reflects, beside Fresnel's.
        transmission: part of the light that is not reflected and crosses the surface, unscattered
            but for its roughness.
        thin: the surface does not refract: it is a sheet.
        diffuse_transmission: twice the part of the diffuse light that leaves on the other side.
        clearcoat, clearcoat_roughness, sheen: as in glTF.
        two_sided: whether the back reflects as the front does.
        opacity: part of the surface that is there.
        normal: texture of normals in the tangent space; None for the mesh's normals.
        normal_mirrored: whether its second axis is turned round.
        absorption: R, G and B, of what is behind a surface that refracts, per unit of length of
            the luminaire's file.
        emission: radiance of the front, W/(m² sr), with the asset's factors; black for none.
        lost: one line for each property that is not carried over.
    """

    colour: Layer = ONE
    metallic: Layer = BLACK
    roughness: Layer = ONE
    roughness_v: Layer | None = None
    anisotropy: Layer = BLACK
    ggx: bool = False
    index: float = 1.5
    specular: Layer = ONE
    reflectance: Layer = ONE
    transmission: Layer = BLACK
    thin: bool = False
    diffuse_transmission: Layer = BLACK
    clearcoat: Layer = BLACK
    clearcoat_roughness: Layer = BLACK
    sheen: Layer = BLACK
    two_sided: bool = False
    opacity: Layer = ONE
    normal: Texture | None = None
    normal_mirrored: bool = False
    absorption: RGB | None = None
    emission: Layer = BLACK
    lost: frozenset[str] = frozenset()

    @property
    def textures(self) -> list[Texture | VertexColours]:
        """Its textures."""
        values = [getattr(self, field.name) for field in dataclasses.fields(self)]
        found = [each.texture if isinstance(each, Layer) else each for each in values]
        return [each for each in found if isinstance(each, Texture | VertexColours)]


def converted(material: Material) -> PbrMaterial:
    """A material without nested ones."""
    lost = set[str]()
    match material:
        case Diffuse():
            found = PbrMaterial(layer(material.reflectance, 0.5), specular=BLACK)
        case Glass():
            # Light crosses both surfaces of a solid, and is multiplied by the colour once.
            thin = isinstance(material, ThinDielectric)
            found = PbrMaterial(
                layer(material.specular_transmittance, exponent=1 if thin else 2),
                roughness=_roughness(material),
                index=relative_index(material),
                reflectance=layer(material.specular_reflectance),
                transmission=ONE,
                thin=thin,
                two_sided=thin,
            )
        case Metal():
            lost.add("metals have their reflectance at normal incidence for all angles")
            tint = layer(material.specular_reflectance)
            found = PbrMaterial(
                tint.scaled(normal_reflectance(material)),
                metallic=ONE,
                roughness=_roughness(material),
            )
        case Plastic():
            found = PbrMaterial(
                layer(material.diffuse_reflectance, 0.5),
                roughness=_roughness(material),
                index=relative_index(material),
                reflectance=layer(material.specular_reflectance),
            )
        case Principled():
            found = dataclasses.replace(
                _disney(material, lost),
                metallic=layer(material.metallic, 0.0),
                clearcoat=layer(material.clearcoat, 0.0),
                clearcoat_roughness=_clearcoat_roughness(material),
            )
        case PrincipledThin():
            found = dataclasses.replace(
                _disney(material, lost),
                thin=True,
                two_sided=True,
                diffuse_transmission=layer(material.diff_trans, 0.0),
            )
        case MetallicRoughness():
            found = PbrMaterial(
                layer(material.base_color),
                metallic=layer(material.metallic),
                roughness=layer(material.roughness),
                anisotropy=layer(material.anisotropic),
                ggx=True,
                index=material.eta,
                specular=layer(material.specular),
                transmission=layer(material.spec_trans),
                thin=material.thin,
                two_sided=material.thin,
                diffuse_transmission=layer(material.diff_trans),
                clearcoat=layer(material.clearcoat),
                clearcoat_roughness=layer(material.clearcoat_roughness),
                sheen=layer(material.sheen),
            )
        case _:
            raise AssertionError(f"{material.plugin} has nested materials")
    if isinstance(material, Microfacets):
        found = dataclasses.replace(found, ggx=material.distribution == "ggx")
        if material.alpha_v is not None:
            lost.add("anisotropic roughness is replaced by that along u")
            roughness_v = layer(material.alpha_v, exponent=0.5)
            found = dataclasses.replace(found, roughness_v=roughness_v)
    if found.reflectance != ONE:
        lost.add("factors of what glass and plastic reflect are dropped")
    return dataclasses.replace(found, lost=frozenset(lost))


def flattened(material: Material, images: Sequence[Image]) -> PbrMaterial:
    """Any material as one surface, without anisotropy and with indices above 1."""
    match material:
        case Blend(nested=(first, second)):
            weight = material.weight
            if isinstance(weight, Texture):
                weight = float(np.mean(ImageFacts.of(images[weight.image]).values))
            found = flattened(second if weight > 0.5 else first, images)
            return _losing(found, "of blended materials the one with the larger weight is kept")
        case TwoSided(nested=(front, *back)):
            found = dataclasses.replace(flattened(front, images), two_sided=True)
            line = "two-sided materials have the material of the front on both sides"
            return _losing(found, line) if back else found
        case Mask(nested=(inner,)):
            found = flattened(inner, images)
            if found.opacity != ONE:
                found = _losing(found, "of masks within masks the outer one is kept")
            return dataclasses.replace(found, opacity=layer(material.opacity, 0.5))
        case NormalMap(nested=(inner,)):
            return dataclasses.replace(flattened(inner, images), normal=material.normalmap)
        case BumpMap(nested=(inner,)):
            return _losing(flattened(inner, images), "bump maps are dropped")
        case _:
            return _simplified(converted(material), images)


def _simplified(material: PbrMaterial, images: Sequence[Image]) -> PbrMaterial:
    """The material with numbers in place of textures and anisotropy that formats do not have."""
    lost = set[str]()
    numbers = {}
    for name in ("specular", "diffuse_transmission", "clearcoat_roughness"):
        given: Layer = getattr(material, name)
        numbers[name] = layer(given.mean(images))
        if given.texture is not None:
            lost.add("some textures of reflection and transmission are replaced by their mean")
    if not material.anisotropy.is_black:
        lost.add("anisotropic roughness is replaced by its mean")
    index = material.index
    if index < 1:
        index = 1 / index
        if not material.thin:
            lost.add("glass that faces inwards refracts as if it faced outwards")
    changed = {"anisotropy": BLACK, "roughness_v": None, "reflectance": ONE, "index": index}
    return _losing(dataclasses.replace(material, **numbers, **changed), *lost)


def shape_material(geometry: AssetGeometry, shape: Shape, factors: RGB) -> PbrMaterial:
    """The material of a shape of a geometry as one surface, with its emission and medium.

    `factors` are of the R, G and B of its emission (`Asset.light_factors`).
    """
    found = flattened(geometry.materials[shape.material], geometry.images)
    emission = BLACK if shape.radiance is None else layer(shape.radiance)
    inside = None if found.thin or shape.interior is None else shape.interior.absorption
    return dataclasses.replace(
        _losing(found, *lost_media(shape)), absorption=inside, emission=emission.scaled(factors)
    )


def lost_media(shape: Shape) -> list[str]:
    """One line for each property of the media of a shape that no exporter carries over."""
    lost = []
    if shape.exterior is not None:
        lost.append("media outside of a shape are dropped")
    if shape.scatters:
        lost.append("media absorb light and do not scatter it: opal glass is clear")
    return lost


def relative_index(material: Glass | Plastic) -> float:
    """Index of refraction behind a surface over the one before it."""
    given = {"int_ior": material.int_ior, "ext_ior": material.ext_ior}
    if isinstance(material, Plastic) and material.int_ior is None:
        given["int_ior"] = "polypropylene"
    plugin = {name: value for name, value in given.items() if value is not None}
    return float(mi.traverse(mi.load_dict({"type": "dielectric", **plugin}))["eta"])


def principled_index(material: DisneyMaterial) -> float:
    """Index of refraction of a principled material, at least 1."""
    if material.eta is not None:
        return material.eta
    # As Mitsuba has it: the reflectance at normal incidence is 8 % of `specular`.
    specular = material.specular if isinstance(material, Principled) else None
    root = np.sqrt(0.08 * (0.5 if specular is None else specular))
    return max(float((1 + root) / (1 - root)), 1.0)


def _disney(material: DisneyMaterial, lost: set[str]) -> PbrMaterial:
    if material.flatness or material.spec_tint or material.sheen_tint:
        lost.add("flatness and tints of principled materials are dropped")
    return PbrMaterial(
        layer(material.base_color, 0.5),
        roughness=layer(material.roughness, 0.5),
        anisotropy=layer(material.anisotropic, 0.0),
        index=principled_index(material),
        transmission=layer(material.spec_trans, 0.0),
        sheen=layer(material.sheen, 0.0),
    )


def _roughness(material: Material) -> Layer:
    """Square root of the alpha of microfacets, along u if there are two."""
    match material:
        case Microfacets():
            alpha = material.alpha if material.alpha_u is None else material.alpha_u
        case RoughPlastic():
            alpha = material.alpha
        case _:
            return BLACK
    return layer(alpha, _DEFAULT_ALPHA, exponent=0.5)


def _clearcoat_roughness(material: Principled) -> Layer:
    """Roughness of the clear coat; a texture of the gloss counts as a gloss of 0.5."""
    gloss = material.clearcoat_gloss or 0.0
    # As Mitsuba has it: alpha is 0.1 at gloss 0, and 0.001 at gloss 1.
    alpha = 0.1 - 0.099 * (0.5 if isinstance(gloss, Texture) else gloss)
    return layer(alpha, exponent=0.5)


def _losing(material: PbrMaterial, *lines: str) -> PbrMaterial:
    """The material with more lines of what it loses."""
    return dataclasses.replace(material, lost=material.lost.union(lines))
