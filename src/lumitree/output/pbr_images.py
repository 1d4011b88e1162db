"""Images of `output.pbr.Layer` as PNG files: colours encoded by sRGB, and data of 8 bits.

Row 0 of an image of an asset is at v = 0; it is the first row of the file.
"""

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lumitree.asset.textures import Json
from lumitree.core.images import encode_png, linear_from_srgb, srgb_from_linear
from lumitree.core.photometry import LUMA
from lumitree.output.pbr import Layer

Pixels = NDArray[np.uint8]


class PbrImages:
    """PNG files of the images of an asset's geometry, each made once.

    `files` has their content by a name without suffix, in the order in which they were made.
    """

    def __init__(self, images: Sequence[NDArray[Any]]) -> None:
        self._images = images
        self._names: dict[str, str] = {}
        self.files: dict[str, bytes] = {}

    def colours(self, layer: Layer) -> tuple[str, float]:
        """Name of the file of a layer's colours, and the factor that its linear values need."""
        pixels, factor = self.colour_pixels(layer)
        return self.add(pixels), factor

    def colour_pixels(self, layer: Layer) -> tuple[Pixels, float]:
        """Pixels [H, W, 3] of a layer's colours, encoded by sRGB, and a factor on linear values."""
        assert layer.texture is not None
        image = self._images[layer.texture["image"]]
        if image.dtype == np.uint8 and not layer.texture["raw"] and layer.exponent == 1:
            return np.ascontiguousarray(np.broadcast_to(image[..., :3], (*image.shape[:2], 3))), 1.0
        values = self._linear(layer)
        largest = max(float(values.max()), 1e-30)
        factor = largest if largest > 1 or image.dtype != np.uint8 else 1.0
        encoded = np.broadcast_to(srgb_from_linear(values / factor), (*values.shape[:2], 3))
        return np.rint(255 * encoded).astype(np.uint8), factor

    def number_pixels(self, layer: Layer) -> Pixels:
        """Pixels [H, W] of a layer that has one number: its values in 255ths, clipped to 1."""
        values = self._linear(layer)
        weights = np.array(LUMA if values.shape[2] == 3 else [1.0])
        return np.rint(255 * np.clip(values @ weights, 0, 1)).astype(np.uint8)

    def data(self, layer: Layer) -> str:
        """Name of the file of a layer that has one number."""
        return self.add(self.number_pixels(layer))

    def normals(self, texture: Json, mirrored: bool) -> str:
        """Name of the file of a normal map; `mirrored`: with its second axis turned round."""
        values = self._linear(Layer(texture=texture))
        if mirrored:
            values[..., 1] = 1 - values[..., 1]
        return self.add(np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8))

    def add(self, pixels: Pixels) -> str:
        """Name of the file of pixels [H, W] or [H, W, C]; equal ones are one file."""
        key = hashlib.sha256(pixels.tobytes() + repr(pixels.shape).encode()).hexdigest()
        if key not in self._names:
            self._names[key] = name = f"image{len(self.files)}"
            self.files[name] = encode_png(pixels)
        return self._names[key]

    def _linear(self, layer: Layer) -> NDArray[np.float64]:
        """Linear values [H, W, C] of a layer's image, with C = 1 or 3."""
        assert layer.texture is not None
        image = self._images[layer.texture["image"]]
        values = image[..., :3].astype(np.float64)
        if image.dtype == np.uint8:
            values = values / 255
            if not layer.texture["raw"]:
                values = np.asarray(linear_from_srgb(values), np.float64)
        return np.maximum(values, 0) ** layer.exponent


def resized(pixels: Pixels, height: int, width: int) -> Pixels:
    """Pixels [H, W] in another size, interpolated linearly."""
    if pixels.shape == (height, width):
        return pixels
    return np.asarray(Image.fromarray(pixels).resize((width, height), Image.Resampling.BILINEAR))
