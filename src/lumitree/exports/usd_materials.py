"""Materials of USD: UsdPreviewSurface, and `standard_surface` of MaterialX for glass and metal."""

from types import ModuleType
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


class MaterialWriter:
    """Defines materials in a stage, below a parent.

    Args:
        pxr, stage: the library (`load_usd`), and a stage of it.
        parent: path of the materials.
        images: files of textures; each is beside the stage.
        materialx: whether materials have a `standard_surface` too, where it is short.

    Attributes:
        lost: one line for each property that is not carried over.
    """

    def __init__(
        self, pxr: ModuleType, stage: Any, parent: str, images: PbrImages, *, materialx: bool
    ) -> None:
        self.pxr, self.stage, self.images = pxr, stage, images
        self._parent, self._materialx = parent, materialx
        self._previews: list[_Shader] = []
        self._standards: list[_Shader] = []
        self.lost: set[str] = set()

    def add(self, index: int, surface: Surface) -> Any:
        """Define the material of a surface, without its emission; returns it."""
        path = f"{self._parent}/material{index}"
        made = self.pxr.UsdShade.Material.Define(self.stage, path)
        preview = _Shader(self, f"{path}/preview", _PREVIEW, surface)
        self._preview(preview, surface.material)
        made.CreateSurfaceOutput().ConnectToSource(preview.output("surface"))
        self._previews.append(preview)
        material = surface.material
        # Glass or metal without textures.
        is_plain = ONE in (material.transmission, material.metallic) and not material.textures
        if self._materialx and is_plain and material.opacity == ONE:
            standard = _Shader(self, f"{path}/standard", _STANDARD, surface)
            _standard(standard, surface.material)
            made.CreateSurfaceOutput("mtlx").ConnectToSource(standard.output("out"))
            self._standards.append(standard)
        return made

    def add_emission(self) -> None:
        """Define what the surfaces emit, cd/m²."""
        for shader in (*self._previews, *self._standards):
            emission = shader.surface.material.emission.scaled(LUMENS_PER_WATT)
            if emission.is_black:
                continue
            if shader in self._previews:
                shader.layer("emissiveColor", emission, colour=True)
            else:
                shader.number("emission", 1.0)
                shader.colour("emission_color", emission.factor)

    def _preview(self, shader: "_Shader", material: PbrMaterial) -> None:
        shader.layer("diffuseColor", _diffuse(shader.surface), colour=True)
        shader.layer("metallic", material.metallic)
        shader.layer("roughness", material.roughness)
        shader.number("ior", material.index)
        if material.specular.is_black:
            shader.input("useSpecularWorkflow", "Int", 1)
            shader.colour("specularColor", (0.0, 0.0, 0.0))
        self._opacity(shader, material)
        if not material.diffuse_transmission.is_black:
            self.lost.add("thin sheets do not transmit diffuse light")
        if not material.clearcoat.is_black:
            shader.layer("clearcoat", material.clearcoat)
            shader.number("clearcoatRoughness", material.clearcoat_roughness.number)
        if not material.sheen.is_black:
            self.lost.add("sheen is dropped")
        if material.normal is not None:
            shader.normals(material.normal, material.normal_mirrored)

    def _opacity(self, shader: "_Shader", material: PbrMaterial) -> None:
        through, opacity = material.transmission, material.opacity
        if not through.is_black:
            self.lost.add(
                "UsdPreviewSurface does not refract: glass is a transparent surface with highlights"
            )
            # The mean of R, G and B at normal incidence.
            reflected = ((material.index - 1) / (material.index + 1)) ** 2
            crossing = float(np.mean(shader.surface.tint)) * (1 - reflected)
            opacity = opacity.scaled(1 - through.number * crossing)
        if through.texture is not None:
            self.lost.add("textures of transmission are replaced by 1")
        shader.layer("opacity", opacity)
        # A threshold would cut all of glass, whose opacity is small.
        if material.opacity.image is not None and through.is_black:
            values = self.images.number_pixels(material.opacity)
            if np.isin(values, (0, 255)).all():
                shader.number("opacityThreshold", _CUT)


class _Shader:
    """A shader of a surface's material, whose inputs are numbers, or the nodes of a texture."""

    def __init__(self, writer: MaterialWriter, path: str, name: str, surface: Surface) -> None:
        self.surface = surface
        self._writer, self._pxr, self._path = writer, writer.pxr, path
        self._types = writer.pxr.Sdf.ValueTypeNames
        self._shader = self._define(path, name)

    def output(self, name: str) -> Any:
        """Its output, a token, to which a material is connected."""
        return self._shader.CreateOutput(name, self._types.Token)

    def input(self, name: str, kind: str, value: object) -> None:
        """An input of a type of USD."""
        self._shader.CreateInput(name, getattr(self._types, kind)).Set(value)

    def number(self, name: str, value: float) -> None:
        """An input that is a number."""
        self.input(name, "Float", float(value))

    def colour(self, name: str, value: RGB) -> None:
        """An input that is a colour."""
        self.input(name, "Color3f", self._pxr.Gf.Vec3f(*value))

    def layer(self, name: str, layer: Layer, *, colour: bool = False) -> None:
        """An input that is a colour, or a number from 0 to 1, by a texture if the layer has one."""
        if layer.texture is None or not (colour or layer.image):
            if colour:
                self.colour(name, layer.factor)
            else:
                self.number(name, min(layer.number, 1.0))
            return
        given = self._shader.CreateInput(name, self._types.Color3f if colour else self._types.Float)
        if isinstance(layer.texture, VertexColours):
            reader = self._node(name, "UsdPrimvarReader_float3")
            reader.CreateInput("varname", self._types.String).Set("displayColor")
            given.ConnectToSource(reader.CreateOutput("result", self._types.Float3))
            return
        images = self._writer.images
        file, scale = images.colours(layer) if colour else (images.data(layer), 1.0)
        node = self._texture(name, layer.texture, file, "sRGB" if colour else "raw")
        factor = layer.scaled(scale).factor
        if factor != (1.0, 1.0, 1.0):
            node.CreateInput("scale", self._types.Float4).Set(self._pxr.Gf.Vec4f(*factor, 1.0))
        channels = ("rgb", self._types.Float3) if colour else ("r", self._types.Float)
        given.ConnectToSource(node.CreateOutput(*channels))

    def normals(self, texture: Texture, mirrored: bool) -> None:
        """The input "normal", of the values of a normal map, from -1 to 1."""
        file = self._writer.images.normals(texture, mirrored)
        node = self._texture("normal", texture, file, "raw")
        vector = self._pxr.Gf.Vec4f
        node.CreateInput("scale", self._types.Float4).Set(vector(2, 2, 2, 1))
        node.CreateInput("bias", self._types.Float4).Set(vector(-1, -1, -1, 0))
        given = self._shader.CreateInput("normal", self._types.Normal3f)
        given.ConnectToSource(node.CreateOutput("rgb", self._types.Float3))

    def _texture(self, name: str, texture: Texture, file: str, space: str) -> Any:
        if texture.filter_type == "nearest":
            self._writer.lost.add("images without interpolation are interpolated")
        node = self._node(name, "UsdUVTexture")
        path = self._pxr.Sdf.AssetPath(f"./{file}.png")
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
        return self._define(f"{self._path}_{name}", kind)

    def _define(self, path: str, kind: str) -> Any:
        node = self._pxr.UsdShade.Shader.Define(self._writer.stage, path)
        node.CreateIdAttr(kind)
        return node


def _diffuse(surface: Surface) -> Layer:
    """The colour; for clear glass, the part of its tint above the least channel.

    The part of a surface that is not transparent is diffuse here: near a lamp grey glass would
    glow.
    """
    material = surface.material
    if material.transmission == ONE and material.colour.texture is None:
        red, green, blue = surface.tint
        least = min(surface.tint)
        return Layer((red - least, green - least, blue - least))
    return material.colour


def _standard(shader: _Shader, material: PbrMaterial) -> None:
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
    shader.input("thin_walled", "Bool", material.thin)
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
