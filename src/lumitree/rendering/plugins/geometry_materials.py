"""The materials of an asset's geometry as BSDFs of Mitsuba."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset import materials as asset_materials
from lumitree.asset.materials import Image, Material, Parameter, Texture, VertexColours
from lumitree.core.device import parameter
from lumitree.core.mitsuba_meshes import VERTEX_COLOUR
from lumitree.rendering.plugins.objects import load_ordered, make_object, make_properties


class Radiance:
    """RGB radiance of the front of a surface.

    Args:
        source: a texture that has it, or R, G and B.

    Attributes:
        constant: the radiance if it is everywhere the same, else None.
    """

    def __init__(self, source: mi.Texture | Sequence[float]) -> None:
        self.constant: NDArray[np.float64] | None = None
        if isinstance(source, mi.Texture):
            self._texture = source
        else:
            self.constant = np.array(source, np.float64)
            self._colour = parameter(mi.Color3f, *source)

    def __call__(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Color3f:
        if self.constant is not None:
            return self._colour
        if mi.is_spectral:
            return self._texture.eval_3(si, active)
        return mi.Color3f(self._texture.eval(si, active))


class Materials:
    """Makes BSDFs; equal textures are made once."""

    def __init__(self, images: Sequence[Image]) -> None:
        """Materials whose textures are of these images, see `AssetGeometry.images`."""
        self._images = images
        self._textures: dict[Texture | VertexColours, mi.Texture] = {}

    def bsdf(self, material: Material) -> mi.BSDF:
        """The BSDF of a material."""
        values = {f"nested_{i}": self.bsdf(nested) for i, nested in enumerate(material.nested)}
        values |= {name: self._value(value) for name, value in material.parameters.items()}
        return make_object(material.plugin, values)

    def _value(self, value: Parameter) -> Any:
        if isinstance(value, tuple):
            return mi.ScalarColor3d(list(value))
        if isinstance(value, Texture | VertexColours):
            return self._texture(value)
        # JSON writes 1.0 as 1, too; Mitsuba refuses an integer as an index of refraction.
        return float(value) if type(value) is int else value

    def radiance(self, radiance: asset_materials.Radiance) -> Radiance:
        """Emission of a shape."""
        if not isinstance(radiance, Texture):
            return Radiance(np.broadcast_to(radiance, 3).tolist())
        if not mi.is_spectral:
            values = {"radiance": self._value(radiance)}
            return Radiance(make_properties("", values).get_emissive_texture("radiance"))
        description = self._description(radiance)
        pixels = mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False
        description["bitmap"] = description["bitmap"].convert(*pixels)
        return Radiance(load_ordered(description | {"raw": True}))

    def _texture(self, texture: Texture | VertexColours) -> mi.Texture:
        if texture not in self._textures:
            self._textures[texture] = load_ordered(self._description(texture))
        return self._textures[texture]

    def _description(self, texture: Texture | VertexColours) -> dict[str, Any]:
        if isinstance(texture, VertexColours):
            return {"type": "mesh_attribute", "name": VERTEX_COLOUR}
        image = self._images[texture.image]
        bitmap = mi.Bitmap(np.ascontiguousarray(image))
        bitmap.set_srgb_gamma(image.dtype == np.uint8 and not texture.raw)
        return {
            "type": "bitmap",
            "bitmap": bitmap,
            "raw": texture.raw,
            "filter_type": texture.filter_type,
            "wrap_mode": texture.wrap_mode,
            "to_uv": mi.ScalarTransform4f(np.array(texture.to_uv)),
        }
