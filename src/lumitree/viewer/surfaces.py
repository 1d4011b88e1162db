"""How the page treats the surfaces of a lamp's geometry, and the images that give them a pattern.

The page follows rays through glass and from metals, rough ones too. Any other surface is *baked*: a
ray ends there with the mean radiance of the surface (`vertex_radiance`), which is the radiance of
its vertices times its pattern. A pattern is an image of its radiance or of its colour, relative to
the largest value.
"""

import base64
import dataclasses
import enum
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from lumitree.asset.geometry import AssetGeometry, MeshShape, Shape
from lumitree.asset.materials import (
    Diffuse,
    DisneyMaterial,
    Glass,
    Material,
    Metal,
    MetallicRoughness,
    Plastic,
    Texture,
    TwoSided,
    transmits,
)
from lumitree.core.images import linear_from_srgb, srgb_from_linear
from lumitree.core.photometry import RGB
from lumitree.exports.pbr import BLACK, ONE, WHITE, PbrMaterial, converted

# Metals of a larger alpha are baked: what they reflect has no directions.
_LARGEST_ALPHA = 1.0
# Pixels a side in the page, and the largest number of images.
SIDE, _MOST_IMAGES = 512, 64
_QUALITY = 90
# Numbers of what lies beyond the sides of an image, by `wrap_mode`.
WRAPS = {"repeat": 0, "mirror": 1, "clamp": 2}
# Least value of a pattern, by which radiance is divided.
_DARKEST = 0.02


class Kind(enum.IntEnum):
    """Effect of a surface on a ray. The numbers are the same in model.glsl."""

    BAKED = 0
    GLASS = 1
    THIN_GLASS = 2
    METAL = 3


@dataclasses.dataclass(frozen=True)
class PageSurface:
    """A surface of the page.

    Attributes:
        kind: what happens to a ray.
        has_back: whether its back is seen; else it is black.
        smooth: whether normals are interpolated.
        alpha: of microfacets; 0 for smooth surfaces.
        index: of refraction, behind over before the surface.
        reflected: [3] factor on reflected light: of a metal its reflectance at normal incidence, of
            glass one beside Fresnel's.
        transmitted: [3] factor on light that crosses glass.
        between_media: whether the surface is a border of media.
        emits: whether it emits, so that the page samples it.
        ggx: whether they have the distribution of Trowbridge and Reitz, else Beckmann's.
        pattern: number of the image that its radiance is in proportion to, from 1; 0 for none.
        wrap: what lies beyond the sides of this image: repetitions (0), mirror images (1), or the
            colours of the sides (2).
        inside, outside: [3] absorption behind and before it, per local unit.
    """

    kind: Kind
    has_back: bool = True
    smooth: bool = False
    alpha: float = 0.0
    index: float = 1.0
    reflected: RGB = WHITE
    transmitted: RGB = WHITE
    between_media: bool = False
    emits: bool = False
    ggx: bool = False
    pattern: int = 0
    wrap: int = 0
    inside: RGB = (0.0, 0.0, 0.0)
    outside: RGB = (0.0, 0.0, 0.0)

    def numbers(self) -> list[float]:
        """[20], five texels."""
        flags = (
            self.has_back
            + 2 * self.smooth
            + 4 * self.between_media
            + 8 * self.emits
            + 16 * self.ggx
            + 32 * self.wrap
        )
        colours = (self.reflected, self.transmitted, self.inside, self.outside)
        padded = [number for colour in colours for number in (*colour, 0.0)]
        padded[3] = float(self.pattern)
        return [float(self.kind), float(flags), self.alpha, self.index, *padded]


def page_surface(geometry: AssetGeometry, shape: Shape, scale: float) -> PageSurface:
    """The surface of a shape of the geometry; `scale` is lengths of its file per local unit."""
    material, two_sided = geometry.materials[shape.material], False
    while isinstance(material, TwoSided) and len(material.nested) == 1:
        (material,), two_sided = material.nested, True
    emits = shape.radiance is not None
    baked = PageSurface(Kind.BAKED, has_back=two_sided or _has_back(material), emits=emits)
    if emits or shape.scatters or not isinstance(material, Glass | Metal | MetallicRoughness):
        return baked
    pbr = converted(material)
    found = _traced(pbr, isinstance(material, MetallicRoughness))
    if found is None:
        return baked
    media = (
        (0.0, 0.0, 0.0) if each is None else each.scaled(1 / scale).absorption
        for each in (shape.interior, shape.exterior)
    )
    inside, outside = media
    return dataclasses.replace(
        found,
        has_back=found.has_back or two_sided,
        smooth=shape.normals if isinstance(shape, MeshShape) else True,
        ggx=pbr.ggx,
        between_media=bool(shape.media),
        inside=inside,
        outside=outside,
    )


def _traced(material: PbrMaterial, is_model: bool) -> PageSurface | None:
    """Glass or metal; None for another surface. `is_model`: of `MetallicRoughness`."""
    layers = material.metallic, material.transmission, material.clearcoat, material.anisotropy
    metallic, transmission, *others = layers
    plain = [*layers, material.roughness] + ([material.colour] if is_model else [])
    if any(each.texture is not None for each in plain) or not all(each.is_black for each in others):
        return None
    if material.roughness_v not in (None, material.roughness) or (is_model and material.thin):
        return None
    alpha = material.roughness.number**2
    if metallic == ONE and transmission == BLACK:
        if alpha > _LARGEST_ALPHA:
            return None
        return PageSurface(
            Kind.METAL, has_back=False, alpha=alpha, reflected=material.colour.factor
        )
    if metallic == BLACK and transmission == ONE:
        # The colour of the material multiplies light that crosses both surfaces of a solid.
        tint = material.colour if material.thin else material.colour.root()
        return PageSurface(
            Kind.THIN_GLASS if material.thin else Kind.GLASS,
            alpha=alpha,
            index=material.index,
            # Factors without their textures.
            reflected=material.reflectance.factor,
            transmitted=tint.factor,
        )
    return None


def _has_back(material: Material) -> bool:
    thin = isinstance(material, MetallicRoughness) and material.thin
    if isinstance(material, TwoSided) or thin or transmits(material):
        return True
    return any(map(_has_back, material.nested))


class Patterns:
    """The patterns of a geometry's shapes, numbered in the order of their first use."""

    def __init__(self, geometry: AssetGeometry) -> None:
        self._geometry = geometry
        self._known: dict[tuple[int, bool], int] = {}
        self._images: list[PillowImage.Image] = []
        self._values: list[NDArray[np.float32]] = []

    def of(self, shape: Shape) -> tuple[int, Texture] | None:
        """Number of the pattern of a shape of the geometry, and its texture; None without one."""
        texture = shape.radiance
        if not isinstance(texture, Texture) and not np.any(texture or 0):
            # It does not emit.
            texture = _colour_texture(self._geometry.materials[shape.material])
        if not isinstance(texture, Texture):
            return None
        key = texture.image, texture.raw
        if key not in self._known:
            if len(self._known) == _MOST_IMAGES:
                return None
            self._known[key] = len(self._images)
            self._add(*key)
        return self._known[key], texture

    def values(
        self, number: int, texcoords: NDArray[np.floating], wrap: str = "repeat"
    ) -> NDArray[np.float32]:
        """Values [N, 3] of a pattern at places [N, 2] of its image, also beyond its sides."""
        if wrap == "clamp":
            places = texcoords.clip(0, 1)
        elif wrap == "mirror":
            places = 1 - np.abs(texcoords % 2 - 1)
        else:
            places = texcoords % 1
        column, row = (places * SIDE).astype(np.int64).clip(0, SIDE - 1).T
        return self._values[number][row, column]

    def encoded(self) -> list[str]:
        """The images as JPEG files in base64, row 0 at v = 0."""
        found = []
        for image in self._images:
            stream = io.BytesIO()
            image.save(stream, "JPEG", quality=_QUALITY)
            found.append(base64.b64encode(stream.getvalue()).decode())
        return found

    def _add(self, index: int, raw: bool) -> None:
        image = self._geometry.images[index]
        colours = np.broadcast_to(image[..., :3], (*image.shape[:2], 3)).astype(np.float64)
        linear = colours if image.dtype != np.uint8 or raw else linear_from_srgb(colours / 255)
        relative = linear / max(float(linear.max()), 1e-20)
        pixels = np.rint(255 * srgb_from_linear(relative)).astype(np.uint8)
        shown = PillowImage.fromarray(pixels).resize((SIDE, SIDE))
        self._images.append(shown)
        self._values.append(np.maximum(linear_from_srgb(np.asarray(shown) / 255), _DARKEST))


def _colour_texture(material: Material) -> Texture | None:
    """The image that a material has as its colour."""
    match material:
        case DisneyMaterial() | MetallicRoughness():
            colour = material.base_color
        case Diffuse():
            colour = material.reflectance
        case Plastic():
            colour = material.diffuse_reflectance
        case Glass():
            colour = material.specular_transmittance
        case _:
            colour = None
    if isinstance(colour, Texture):
        return colour
    return next((found for each in material.nested if (found := _colour_texture(each))), None)
