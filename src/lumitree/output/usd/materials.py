"""Materials of USD: UsdPreviewSurface, and `standard_surface` of MaterialX for glass and metal."""

from typing import Any

import numpy as np

from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.output.pbr import Layer, PbrMaterial
from lumitree.output.pbr_meshes import Surface, textures_used
from lumitree.output.usd.shaders import Shader, ShaderPlace

_PREVIEW, _STANDARD = "UsdPreviewSurface", "ND_standard_surface_surfaceshader"
# Opacity at which a mask of two values is cut.
_CUT = 0.5


class MaterialWriter:
    """Defines materials in a stage, below a parent.

    With `materialx` they have a `standard_surface` too, where it is short.
    """

    def __init__(self, place: ShaderPlace, parent: str, *, materialx: bool) -> None:
        self._place, self._parent, self._materialx = place, parent, materialx
        self._previews: list[Shader] = []
        self._standards: list[Shader] = []

    def add(self, index: int, surface: Surface) -> Any:
        """Define the material of a surface, without its emission; returns it."""
        path = f"{self._parent}/material{index}"
        made = self._place.pxr.UsdShade.Material.Define(self._place.stage, path)
        preview = Shader(self._place, f"{path}/preview", _PREVIEW, surface)
        self._preview(preview, surface.material)
        made.CreateSurfaceOutput().ConnectToSource(preview.output("surface"))
        self._previews.append(preview)
        if self._materialx and _is_plain(surface.material):
            standard = Shader(self._place, f"{path}/standard", _STANDARD, surface)
            _standard(standard, surface.material)
            made.CreateSurfaceOutput("mtlx").ConnectToSource(standard.output("out"))
            self._standards.append(standard)
        return made

    def add_emission(self) -> None:
        """Define what the surfaces emit, cd/m²."""
        for shader in self._previews:
            emission = shader.surface.material.emission.scaled(LUMENS_PER_WATT)
            if not emission.is_black:
                shader.coloured("emissiveColor", emission)
        for shader in self._standards:
            emission = shader.surface.material.emission.scaled(LUMENS_PER_WATT)
            if not emission.is_black:
                shader.number("emission", 1.0)
                shader.colour("emission_color", emission.factor)

    def _preview(self, shader: Shader, material: PbrMaterial) -> None:
        lost = self._place.lost
        shader.coloured("diffuseColor", _diffuse(shader.surface))
        shader.numbered("metallic", material.metallic)
        shader.numbered("roughness", material.roughness)
        shader.number("ior", material.index)
        if material.specular == 0:
            shader.integer("useSpecularWorkflow", 1)
            shader.colour("specularColor", (0.0, 0.0, 0.0))
        self._opacity(shader, material)
        if material.diffuse_transmission > 0:
            lost.add("thin sheets do not transmit diffuse light")
        if not material.clearcoat.is_black:
            shader.numbered("clearcoat", material.clearcoat)
            shader.number("clearcoatRoughness", material.clearcoat_roughness)
        if not material.sheen.is_black:
            lost.add("sheen is left out")
        if material.normal is not None:
            shader.normals(material.normal, material.normal_mirrored)

    def _opacity(self, shader: Shader, material: PbrMaterial) -> None:
        through, opacity = material.transmission, material.opacity
        if not through.is_black:
            self._place.lost.add(
                "UsdPreviewSurface does not refract: glass is a transparent surface with highlights"
            )
            opacity = opacity.scaled(1 - through.number * _transmitted(shader.surface))
        if through.texture is not None:
            self._place.lost.add("textures of transmission are replaced by 1")
        shader.numbered("opacity", opacity)
        # A threshold would cut all of glass, whose opacity is small.
        if material.opacity.texture is not None and through.is_black:
            values = self._place.images.number_pixels(material.opacity)
            if np.isin(values, (0, 255)).all():
                shader.number("opacityThreshold", _CUT)


def _diffuse(surface: Surface) -> Layer:
    """The colour; for clear glass, the part of its tint above the least channel.

    What is not transparent of a surface is diffuse here: near a lamp grey glass would glow.
    """
    material = surface.material
    if material.transmission == Layer() and material.colour.texture is None:
        red, green, blue = surface.tint
        least = min(surface.tint)
        return Layer((red - least, green - least, blue - least))
    return material.colour


def _transmitted(surface: Surface) -> float:
    """Part of the light that crosses a surface at normal incidence: the mean of R, G and B."""
    index = surface.material.index
    reflected = ((index - 1) / (index + 1)) ** 2
    return float(np.mean(surface.tint)) * (1 - reflected)


def _is_plain(material: PbrMaterial) -> bool:
    """Whether it is glass or metal without textures."""
    kind = Layer() in (material.transmission, material.metallic)
    return kind and material.opacity == Layer() and not textures_used(material)


def _standard(shader: Shader, material: PbrMaterial) -> None:
    metal = material.metallic.number
    shader.number("base", metal)
    shader.colour("base_color", material.colour.factor)
    shader.number("metalness", metal)
    shader.number("specular", 1.0)
    shader.number("specular_roughness", min(material.roughness.number, 1.0))
    shader.number("specular_IOR", material.index)
    if metal == 1:
        return
    shader.number("transmission", 1.0)
    shader.boolean("thin_walled", material.thin)
    # Light crosses a solid twice.
    tint = np.array(material.colour.factor) ** (1.0 if material.thin else 0.5)
    absorption = np.array(material.absorption or (0.0, 0.0, 0.0))
    if absorption.any():
        # The colour of white light after the depth.
        depth = 1 / float(absorption.max())
        tint = np.exp(-absorption * depth)
        shader.number("transmission_depth", depth)
    red, green, blue = tint.tolist()
    shader.colour("transmission_color", (red, green, blue))
