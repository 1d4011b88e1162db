"""Images that give a surface of the page its pattern.

Where rays end, the radiance of a surface is that of its vertices times its pattern: an image of its
radiance or of its colour, relative to the largest value.
"""

import base64
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lumitree.asset.geometry import AssetGeometry
from lumitree.asset.textures import Json
from lumitree.core.images import linear_from_srgb, srgb_from_linear

# Pixels a side in the page, and the largest number of images.
SIDE, _MOST_IMAGES = 512, 64
_QUALITY = 90
# Numbers of what lies beyond the sides of an image, by `wrap_mode`.
WRAPS = {"repeat": 0, "mirror": 1, "clamp": 2}
# Colours of materials by the names of parameters, the first of which counts that is an image.
_COLOURS = ("base_color", "reflectance", "diffuse_reflectance", "specular_transmittance")
# Least value of a pattern, by which radiance is divided.
_DARKEST = 0.02


class Patterns:
    """The patterns of a geometry's shapes, numbered as they are asked for."""

    def __init__(self, geometry: AssetGeometry) -> None:
        self._geometry = geometry
        self._known: dict[tuple[int, bool], int] = {}
        self._images: list[Image.Image] = []
        self._values: list[NDArray[np.float32]] = []

    def of(self, shape: Json) -> tuple[int, Json] | None:
        """Number of the pattern of a shape of the geometry, and its texture; None without one."""
        colour = shape["radiance"]
        if not isinstance(colour, dict) and not np.any(colour or 0):
            # It does not emit.
            colour = self._geometry.materials[shape["material"]]
        if (texture := _texture(colour)) is None:
            return None
        key = texture["image"], texture["raw"]
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
        image: NDArray[Any] = self._geometry.images[index]
        colours = np.broadcast_to(image[..., :3], (*image.shape[:2], 3)).astype(np.float64)
        linear = colours if image.dtype != np.uint8 or raw else linear_from_srgb(colours / 255)
        relative = linear / max(float(linear.max()), 1e-20)
        pixels = np.rint(255 * srgb_from_linear(relative)).astype(np.uint8)
        shown = Image.fromarray(pixels).resize((SIDE, SIDE))
        self._images.append(shown)
        self._values.append(np.maximum(linear_from_srgb(np.asarray(shown) / 255), _DARKEST))


def _texture(value: Any) -> Json | None:
    """The texture of an image that a colour is, or that a material has as its colour."""
    if not isinstance(value, dict):
        return None
    if "image" in value:
        return value
    parts: Sequence[Any] = [value.get(name) for name in _COLOURS] + value.get("nested", [])
    return next((found for each in parts if (found := _texture(each)) is not None), None)
