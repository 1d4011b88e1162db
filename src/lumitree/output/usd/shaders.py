"""Shaders of USD, whose inputs are numbers, or the nodes of a texture."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from lumitree.asset.textures import Json
from lumitree.core.photometry import RGB
from lumitree.output.pbr import Layer
from lumitree.output.pbr_images import PbrImages
from lumitree.output.pbr_meshes import Surface


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
        if "attribute" in layer.texture:
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
        if layer.texture is None:
            self.number(name, min(layer.number, 1.0))
            return
        node = self._texture(name, layer.texture, self._place.images.data(layer), "raw")
        self._scale(node, np.array(layer.factor))
        given = self._shader.CreateInput(name, self._types.Float)
        given.ConnectToSource(node.CreateOutput("r", self._types.Float))

    def normals(self, texture: Json, mirrored: bool) -> None:
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

    def _texture(self, name: str, texture: Json, file: str, space: str) -> Any:
        if texture["filter_type"] == "nearest":
            self._place.lost.add("images without interpolation are interpolated")
        node = self._node(name, "UsdUVTexture")
        path = self._place.pxr.Sdf.AssetPath(self._place.image_path(file))
        node.CreateInput("file", self._types.Asset).Set(path)
        node.CreateInput("sourceColorSpace", self._types.Token).Set(space)
        for axis in ("wrapS", "wrapT"):
            node.CreateInput(axis, self._types.Token).Set(texture["wrap_mode"])
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
