"""How the page treats the surfaces of a lamp's geometry.

The page follows rays through glass and from metals, rough ones too. At any other surface a ray
ends, with the mean radiance that the surface sends out (`surface_radiance`).
"""

import dataclasses
import enum
from typing import Any

import numpy as np

from lumitree.asset.geometry import AssetGeometry
from lumitree.asset.geometry_media import MEDIA_SIDES, scattering_sides, side_medium
from lumitree.asset.materials import transmits
from lumitree.asset.textures import Json
from lumitree.lamp.parts import METALLIC_ROUGHNESS
from lumitree.lamp.scene_writer import normal_reflectance
from lumitree.output.optics import relative_index

# Metals of a larger alpha end rays: what they reflect has no directions. Mitsuba's default.
_LARGEST_ALPHA, _DEFAULT_ALPHA = 1.0, 0.1
_WHITE = (1.0, 1.0, 1.0)


class Kind(enum.IntEnum):
    """Effect of a surface on a ray. The numbers are the same in model.glsl."""

    ENDS = 0
    GLASS = 1
    THIN_GLASS = 2
    METAL = 3


@dataclasses.dataclass(frozen=True)
class Surface:
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
    reflected: tuple[float, ...] = _WHITE
    transmitted: tuple[float, ...] = _WHITE
    between_media: bool = False
    emits: bool = False
    ggx: bool = False
    pattern: int = 0
    wrap: int = 0
    inside: tuple[float, ...] = (0.0, 0.0, 0.0)
    outside: tuple[float, ...] = (0.0, 0.0, 0.0)

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


def page_surface(geometry: AssetGeometry, shape: Json, scale: float) -> Surface:
    """The surface of a shape of the geometry; `scale` is lengths of its file per local unit."""
    material, two_sided = geometry.materials[shape["material"]], False
    while material["type"] == "twosided" and len(material["nested"]) == 1:
        material, two_sided = material["nested"][0], True
    emits = shape["radiance"] is not None
    ends = Surface(Kind.ENDS, has_back=two_sided or _has_back(material), emits=emits)
    if emits or scattering_sides(shape):
        return ends
    name, alpha = material["type"], _alpha(material)
    common = {
        "smooth": shape.get("normals", shape["type"] != "mesh"),
        "ggx": name == METALLIC_ROUGHNESS or material.get("distribution") == "ggx",
        **_media(shape, scale),
    }
    if name in ("dielectric", "thindielectric", "roughdielectric") and alpha is not None:
        return Surface(
            Kind.THIN_GLASS if name == "thindielectric" else Kind.GLASS,
            alpha=alpha,
            index=relative_index(material),
            reflected=_colour(material, "specular_reflectance"),
            transmitted=_colour(material, "specular_transmittance"),
            **common,
        )
    if name == METALLIC_ROUGHNESS and (found := _metallic_roughness(material)) is not None:
        return dataclasses.replace(found, has_back=found.has_back or two_sided, **common)
    if name in ("conductor", "roughconductor") and alpha is not None and alpha <= _LARGEST_ALPHA:
        tint = np.array(_colour(material, "specular_reflectance"))
        return Surface(
            Kind.METAL,
            has_back=two_sided,
            alpha=alpha,
            reflected=tuple((tint * normal_reflectance(material)).tolist()),
            **common,
        )
    return ends


def _metallic_roughness(material: Json) -> Surface | None:
    """Rough glass or metal; None for another surface, where rays end."""
    keys = ("metallic", "spec_trans", "roughness", "clearcoat", "anisotropic", "base_color")
    values = [material.get(key, 0.5 if key in ("roughness", "base_color") else 0) for key in keys]
    if material.get("thin", False) or any(isinstance(value, dict) for value in values):
        return None
    metallic, transmission, roughness, coat, anisotropy, colour = values
    base = tuple(np.broadcast_to(np.array(colour, float), 3).tolist())
    if coat or anisotropy or metallic + transmission != 1 or 0 < metallic < 1:
        return None
    if metallic == 1:
        return Surface(Kind.METAL, has_back=False, alpha=roughness**2, reflected=base)
    tint = tuple(np.sqrt(base).tolist())
    index = material.get("eta", 1.5)
    return Surface(Kind.GLASS, alpha=roughness**2, index=index, transmitted=tint)


def _has_back(material: Json) -> bool:
    if material["type"] == "twosided" or material.get("thin", False) or transmits(material):
        return True
    return any(map(_has_back, material.get("nested", [])))


def _alpha(material: Json) -> float | None:
    """Roughness, 0 for smooth; None if a texture has it, or if it differs by direction."""
    if not material["type"].startswith("rough"):
        return 0.0
    alphas = {
        material[name] if not isinstance(material[name], dict) else None
        for name in ("alpha", "alpha_u", "alpha_v")
        if name in material
    } or {_DEFAULT_ALPHA}
    return float(alphas.pop() or 0.0) if len(alphas) == 1 and None not in alphas else None


def _colour(material: Json, name: str) -> tuple[float, ...]:
    """A factor [3]; one of a texture is left out."""
    value = material.get(name, 1.0)
    return _WHITE if isinstance(value, dict) else tuple(np.broadcast_to(value, 3).tolist())


def _media(shape: Json, scale: float) -> dict[str, Any]:
    sides = [side_medium(shape[side]) if side in shape else None for side in MEDIA_SIDES]
    inside, outside = (
        (0.0, 0.0, 0.0) if each is None else tuple((each.absorption * scale).tolist())
        for each in sides
    )
    return {"between_media": sides != [None, None], "inside": inside, "outside": outside}
