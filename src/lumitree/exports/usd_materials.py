"""Materials of USD: UsdPreviewSurface, and `standard_surface` of MaterialX for glass and metal."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from lumitree.asset.materials import Texture, VertexColours
from lumitree.core.photometry import LUMENS_PER_WATT, RGB
from lumitree.exports.pbr import ONE, Layer, PbrMaterial
from lumitree.exports.surfaces import PbrImages, Surface

_PREVIEW, _STANDARD = "UsdPreviewSurface", "ND_standard_surface_surfaceshader"
# Opacity at which a mask of two values is cut.
_CUT = 0.5


def primvar_name(uv_set: int) -> str:
    """Name of the primvar of texture coordinates by their number."""
    return "st" if uv_set == 0 else f"st{uv_set}"


@dataclasses.dataclass(frozen=True, eq=False)
class ShaderPlace:
    """Where shaders are defined, and the images of their textures.

    Attributes:
        image_path: path of an image beside the stage, by its name in `images`.
        lost: one line for each property that is not carried over; shaders add to it.
    """

    pxr: Any
    stage: Any
    images: PbrImages
    image_path: Callable[[str], str]
    lost: set[str]


class Shader:
    """A shader of a surface's material; the paths of its textures begin with its own."""

    def __init__(self, place: ShaderPlace, path: str, name: str, surface: Surface) -> None:
        self.surface = surface
        self._place, self._path = place, path
        self._types = place.pxr.Sdf.ValueTypeNames
        self._shader = place.pxr.UsdShade.Shader.Define(place.stage, path)
        self._shader.CreateIdAttr(name)

    def output(self, name: str) -> Any:
        """Its output, a token, to which a material is connected."""
        return self._shader.CreateOutput(name, self._types.Token)

    def number(self, name: str, value: float) -> None:
        """An input that is a number."""
        self._shader.CreateInput(name, self._types.Float).Set(float(value))

    def integer(self, name: str, value: int) -> None:
        """An input that is an integer."""
        self._shader.CreateInput(name, self._types.Int).Set(value)

    def boolean(self, name: str, value: bool) -> None:
        """An input that is true or false."""
        self._shader.CreateInput(name, self._types.Bool).Set(value)

    def colour(self, name: str, value: RGB) -> None:
        """An input that is a colour."""
        self._shader.CreateInput(name, self._types.Color3f).Set(self._place.pxr.Gf.Vec3f(*value))

    def coloured(self, name: str, layer: Layer) -> None:
        """An input that is a colour, by a texture if the layer has one."""
        if layer.texture is None:
            self.colour(name, layer.factor)
            return
        given = self._shader.CreateInput(name, self._types.Color3f)
        if isinstance(layer.texture, VertexColours):
            reader = self._node(name, "UsdPrimvarReader_float3")
            reader.CreateInput("varname", self._types.String).Set("displayColor")
            given.ConnectToSource(reader.CreateOutput("result", self._types.Float3))
            return
        file, scale = self._place.images.colours(layer)
        node = self._texture(name, layer.texture, file, "sRGB")
        self._scale(node, np.array(layer.factor) * scale)
        given.ConnectToSource(node.CreateOutput("rgb", self._types.Float3))

    def numbered(self, name: str, layer: Layer) -> None:
        """An input that is a number from 0 to 1, by a texture if the layer has one."""
        if layer.image is None:
            self.number(name, min(layer.number, 1.0))
            return
        node = self._texture(name, layer.image, self._place.images.data(layer), "raw")
        self._scale(node, np.array(layer.factor))
        given = self._shader.CreateInput(name, self._types.Float)
        given.ConnectToSource(node.CreateOutput("r", self._types.Float))

    def normals(self, texture: Texture, mirrored: bool) -> None:
        """The input "normal", of the values of a normal map, from -1 to 1."""
        file = self._place.images.normals(texture, mirrored)
        node = self._texture("normal", texture, file, "raw")
        vector = self._place.pxr.Gf.Vec4f
        node.CreateInput("scale", self._types.Float4).Set(vector(2, 2, 2, 1))
        node.CreateInput("bias", self._types.Float4).Set(vector(-1, -1, -1, 0))
        given = self._shader.CreateInput("normal", self._types.Normal3f)
        given.ConnectToSource(node.CreateOutput("rgb", self._types.Float3))

    def _scale(self, node: Any, factor: Any) -> None:
        if not (factor == 1).all():
            scale = self._place.pxr.Gf.Vec4f(*factor.tolist(), 1.0)
            node.CreateInput("scale", self._types.Float4).Set(scale)

    def _texture(self, name: str, texture: Texture, file: str, space: str) -> Any:
        if texture.filter_type == "nearest":
            self._place.lost.add("images without interpolation are interpolated")
        node = self._node(name, "UsdUVTexture")
        path = self._place.pxr.Sdf.AssetPath(self._place.image_path(file))
        node.CreateInput("file", self._types.Asset).Set(path)
        node.CreateInput("sourceColorSpace", self._types.Token).Set(space)
        for axis in ("wrapS", "wrapT"):
            node.CreateInput(axis, self._types.Token).Set(texture.wrap_mode)
        reader = self._node(f"{name}_st", "UsdPrimvarReader_float2")
        varname = primvar_name(self.surface.uv_set(texture))
        reader.CreateInput("varname", self._types.String).Set(varname)
        places = node.CreateInput("st", self._types.Float2)
        places.ConnectToSource(reader.CreateOutput("result", self._types.Float2))
        return node

    def _node(self, name: str, kind: str) -> Any:
        node = self._place.pxr.UsdShade.Shader.Define(self._place.stage, f"{self._path}_{name}")
        node.CreateIdAttr(kind)
        return node


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
        if material.specular.is_black:
            shader.integer("useSpecularWorkflow", 1)
            shader.colour("specularColor", (0.0, 0.0, 0.0))
        self._opacity(shader, material)
        if not material.diffuse_transmission.is_black:
            lost.add("thin sheets do not transmit diffuse light")
        if not material.clearcoat.is_black:
            shader.numbered("clearcoat", material.clearcoat)
            shader.number("clearcoatRoughness", material.clearcoat_roughness.number)
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
    if material.transmission == ONE and material.colour.texture is None:
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
    kind = ONE in (material.transmission, material.metallic)
    return kind and material.opacity == ONE and not material.textures


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
