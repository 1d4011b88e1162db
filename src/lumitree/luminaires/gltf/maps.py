"""Arithmetic with what glTF lays over a surface: constants and textures alike.

A map holds linear values, so that factors, products and conversions are the same for a constant
and for an image; only the finished map is turned into a `Texture` or a number.
"""

import dataclasses
import hashlib
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lumitree.errors import LumitreeError
from lumitree.luminaires.geometry import Floats
from lumitree.luminaires.gltf.images import MAX_IMAGE_PIXELS, Images, Sampler
from lumitree.luminaires.gltf.item import Item
from lumitree.luminaires.model import RGB, Texture

Array = NDArray[np.floating]


@dataclasses.dataclass(frozen=True, eq=False)
class Map:
    """Values over a surface.

    Attributes:
        values: [H, W, C], linear; [1, 1, C] is a constant.
        sampler: how the image is looked up; None for a constant.
        uv_transform: [3, 3] from the mesh's texture coordinates to the image's.
    """

    values: Array
    sampler: Sampler | None = None
    uv_transform: Floats = dataclasses.field(default_factory=lambda: np.eye(3))

    @property
    def constant(self) -> bool:
        return self.sampler is None

    def channel(self, index: int) -> "Map":
        """One channel."""
        return dataclasses.replace(self, values=self.values[..., index : index + 1])

    def applied(self, function: Callable[[Array], Array]) -> "Map":
        """A function of the values."""
        return dataclasses.replace(self, values=function(self.values))

    def scaled(self, *factor: float) -> "Map":
        """Times a factor for all channels, or for each."""
        if all(entry == 1 for entry in factor):
            return self
        return self.applied(lambda values: (values * np.array(factor)).astype(values.dtype))

    def mean(self) -> tuple[float, ...]:
        """[C] of the constant, or mean of the image."""
        return tuple(self.values.mean(axis=(0, 1), dtype=np.float64).tolist())

    def black(self) -> bool:
        return not self.values.any()

    def same_place(self, other: "Map") -> bool:
        """Whether both are looked up at the same point of their images."""
        return self.sampler == other.sampler and np.allclose(self.uv_transform, other.uv_transform)


def constant(*values: float) -> Map:
    """A map that is the same everywhere."""
    return Map(np.array(values, np.float64)[None, None])


def combined(function: Callable[..., Array], *maps: Map) -> tuple[Map, bool]:
    """A function of several maps, point by point.

    Args:
        function: of the maps' values [H, W, C].
        maps: of any sizes; smaller images are enlarged.

    Returns:
        The result, and whether it is exact: a texture that is placed differently from the first
        one enters with its mean.

    Raises:
        LumitreeError: a wide image and a high one make too many pixels.
    """
    lead = next((entry for entry in maps if not entry.constant), maps[0])
    placed = [
        entry if entry.constant or entry.same_place(lead) else constant(*entry.mean())
        for entry in maps
    ]
    exact = all(new is old for new, old in zip(placed, maps, strict=True))
    height = max(entry.values.shape[0] for entry in placed)
    width = max(entry.values.shape[1] for entry in placed)
    if height * width > MAX_IMAGE_PIXELS:
        raise LumitreeError(
            f"images are combined to {width} x {height} pixels, more than {MAX_IMAGE_PIXELS}; "
            "make them smaller"
        )
    arrays = [
        entry.values if entry.constant else _resized(entry.values, height, width)
        for entry in placed
    ]
    result = function(*arrays)
    if not lead.constant:
        result = np.broadcast_to(result, (height, width, result.shape[2])).astype(np.float32)
    return dataclasses.replace(lead, values=result), exact


class Textures:
    """Reads a file's textures as maps, and turns maps into the model's textures."""

    def __init__(self, images: Images) -> None:
        self._images = images
        # Maps of the same pixels share one array, so that it is written once.
        self._pixels: dict[bytes, NDArray[np.uint8] | NDArray[np.float32]] = {}

    def read(self, info: Item, channels: str, encoded: bool) -> Map:
        """Map [H, W, C] of a texture info.

        Args:
            info: its JSON.
            channels: which of them, such as "RGB" or "A".
            encoded: whether the values are sRGB-encoded.
        """
        pixels, sampler = self._images.texture(info.integer("index"))
        pixels = pixels[..., ["RGBA".index(channel) for channel in channels]]
        table = _DECODED if encoded else _LINEAR
        return Map(table[pixels], sampler, uv_transform(info))

    def colour(self, source: Map) -> RGB | Texture:
        """R, G and B in [0, 1]."""
        if (flat := _flat(source)) is not None:
            red, green, blue = flat
            return (red, green, blue)
        return self._texture(source, _bytes(_encode(source.values)), True)

    def radiance(self, source: Map) -> RGB | Texture:
        """R, G and B, at least 0 and without an upper limit."""
        if (flat := _flat(source)) is not None:
            red, green, blue = flat
            return (red, green, blue)
        return self._texture(source, source.values.astype(np.float32), False)

    def value(self, source: Map) -> float | Texture:
        """One channel of linear data."""
        if (flat := _flat(source)) is not None:
            return flat[0]
        return self._texture(source, _bytes(source.values), False)

    def data(self, source: Map) -> Texture:
        """Three channels of linear data, as a texture even where they are constant."""
        return self._texture(source, _bytes(source.values), False)

    def _texture(
        self, source: Map, pixels: NDArray[np.uint8] | NDArray[np.float32], encoded: bool
    ) -> Texture:
        key = hashlib.sha256(f"{pixels.shape} {pixels.dtype}".encode() + pixels.tobytes()).digest()
        pixels = self._pixels.setdefault(key, pixels)
        sampler = source.sampler or Sampler(("repeat", "repeat"), False)
        return Texture(pixels, encoded, sampler.wrap[0], sampler.nearest, source.uv_transform)


def uv_transform(info: Item) -> Floats:
    """[3, 3] map of KHR_texture_transform: scale, then rotation, then offset.

    The rotation is counter-clockwise as one looks at the image, whose v axis points down: the
    readme's GLSL says the opposite, its first example and every viewer say this.
    """
    extension = info.extension("KHR_texture_transform")
    matrix = np.eye(3)
    if extension is None:
        return matrix
    angle = extension.number("rotation", 0.0)
    cos, sin = np.cos(angle), np.sin(angle)
    matrix[:2, :2] = np.array([[cos, sin], [-sin, cos]]) * extension.numbers("scale", (1.0, 1.0))
    matrix[:2, 2] = extension.numbers("offset", (0.0, 0.0))
    return matrix


def uv_set(info: Item) -> int:
    """Number of the texture coordinates that a texture info uses."""
    own = info.integer("texCoord", 0)
    extension = info.extension("KHR_texture_transform")
    return own if extension is None else extension.integer("texCoord", own)


def _flat(source: Map) -> tuple[float, ...] | None:
    """The value of a map that is the same everywhere."""
    values = source.values
    if values.shape[:2] != (1, 1) and (values != values[:1, :1]).any():
        return None
    return tuple(values[0, 0].astype(np.float64).tolist())


def _resized(values: Array, height: int, width: int) -> Array:
    if values.shape[:2] == (height, width):
        return values
    channels = [
        Image.fromarray(np.ascontiguousarray(values[..., i], np.float32)).resize(
            (width, height), Image.Resampling.BILINEAR
        )
        for i in range(values.shape[2])
    ]
    return np.stack([np.asarray(channel) for channel in channels], axis=-1)


def _bytes(values: Array) -> NDArray[np.uint8]:
    return np.round(np.clip(values, 0, 1) * 255).astype(np.uint8)


def _encode(values: Array) -> Array:
    values = np.clip(values, 0, 1)
    return np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)


def _decoded() -> NDArray[np.float32]:
    code = np.arange(256) / 255
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    return linear.astype(np.float32)


_DECODED = _decoded()
_LINEAR = (np.arange(256) / 255).astype(np.float32)
