"""Textures of an asset's materials: images over texture coordinates, and colours of vertices."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.mitsuba_meshes import VERTEX_COLOUR
from lumitree.core.reading import Record
from lumitree.errors import LumitreeError, shown

Json = dict[str, Any]
Range = tuple[float, float]

VERTEX_RANGE = (0.0, 1.0)
_MAX_TRANSFORM = 1e4
# Largest texture coordinate in pixels. Mitsuba rounds it to an integer of 32 bits, and weights
# pixels by the rest: with a larger one the weights are wrong.
_MAX_PIXEL_COORDINATE = 2**30
# Values of images may exceed their range by rounding to 16 bits.
_ROUNDING = 1e-3


@dataclasses.dataclass(frozen=True)
class ImageFacts:
    """Properties of an image that textures depend on.

    Attributes:
        sides: height and width.
        channels: 1, 3 or 4.
        values: least and largest value, without the fourth channel; 8 bits are 0 to 1.
    """

    sides: tuple[int, int]
    channels: int
    values: Range

    @classmethod
    def of(cls, image: NDArray[Any]) -> "ImageFacts":
        """Facts of an image [H, W, C] that is not empty."""
        colours, unit = image[..., :3], 255 if image.dtype == np.uint8 else 1
        values = (float(colours.min()) / unit, float(colours.max()) / unit)
        return cls((image.shape[0], image.shape[1]), image.shape[2], values)


@dataclasses.dataclass(frozen=True)
class TextureKind:
    """Which textures a parameter may be.

    Attributes:
        values: range of the values of an image.
        channels: that an image may have.
        vertex_colours: whether colours of vertices may be used in place of an image.
    """

    values: Range
    channels: tuple[int, ...] = (1, 3, 4)
    vertex_colours: bool = False

    def __str__(self) -> str:
        low, high = self.values
        channels = "" if 1 in self.channels else " of three or four channels"
        colours = " or the colours of the vertices" if self.vertex_colours else ""
        return f"an image{channels} of values from {low:g} to {high:g}{colours}"

    def check(self, texture: Any, images: Sequence[ImageFacts]) -> None:
        """Refuse what is not such a texture."""
        check_texture(texture, len(images))
        if "attribute" in texture:
            if not self.vertex_colours:
                raise LumitreeError(f"the colours of the vertices; expected {self}")
            return
        image = images[texture["image"]]
        if image.channels not in self.channels:
            raise LumitreeError(f"an image of {image.channels} channels; expected {self}")
        if not within(image.values, self.values):
            least, largest = image.values
            raise LumitreeError(
                f"an image of values from {least:.4g} to {largest:.4g}; expected {self}"
            )


def within(values: Range, expected: Range) -> bool:
    """Whether least and largest value of an image, or of colours, are in a range."""
    low, high = expected
    return low <= values[0] and values[1] <= high * (1 + _ROUNDING)


def check_texture(texture: Any, num_images: int) -> None:
    """Refuse what is not a texture, or refers to an image that does not exist."""
    record = Record(texture, "a texture")
    if record.has("attribute"):
        record.expect_keys("attribute")
        record.choice("attribute", (VERTEX_COLOUR,))
        return
    record.expect_keys("image", "raw", "filter_type", "wrap_mode", "to_uv")
    if not 0 <= record.integer("image") < num_images:
        raise LumitreeError(f"a texture has no image {record.integer('image')}")
    record.choice("filter_type", ("bilinear", "nearest"))
    record.choice("wrap_mode", ("repeat", "mirror", "clamp"))
    if not isinstance(texture["raw"], bool):
        raise LumitreeError(f"raw of a texture is {shown(texture['raw'], 60)}; expected a boolean")
    if np.abs(record.array("to_uv", 4, 4)).max() > _MAX_TRANSFORM:
        raise LumitreeError(f"to_uv of a texture exceeds {_MAX_TRANSFORM:g}")


def check_coordinates(
    texture: Json, images: Sequence[ImageFacts], coordinates: NDArray[np.floating]
) -> None:
    """Refuse texture coordinates at which Mitsuba cannot look up an image.

    `coordinates` are the largest absolute values of u and of v; `texture` is valid.
    """
    matrix = np.abs(np.array(texture["to_uv"], np.float64))
    height, width = images[texture["image"]].sides
    pixels = (matrix[:2, :2] @ coordinates + matrix[:2, 3]) * [width, height]
    if not (pixels <= _MAX_PIXEL_COORDINATE).all():
        raise LumitreeError(
            f"texture coordinates reach {pixels.max():.3g} pixels of an image; expected at most "
            f"{_MAX_PIXEL_COORDINATE} (2^30)"
        )


def texture_map(matrix: list[list[float]], texcoords: NDArray[np.floating]) -> NDArray[np.float64]:
    """Places [N, 2] on an image, of texture coordinates [N, 2], by `to_uv` of its texture."""
    to_uv = np.array(matrix, np.float64)
    return texcoords @ to_uv[:2, :2].T + to_uv[:2, 3]


def textures_of(value: Any) -> Iterator[Json]:
    """Textures of a material, with those that it holds, or of a parameter."""
    if isinstance(value, dict):
        if "image" in value or "attribute" in value:
            yield value
        else:
            yield from textures_of(list(value.values()))
    elif isinstance(value, list):
        for each in value:
            yield from textures_of(each)


def uses_vertex_colours(value: Any) -> bool:
    """Whether a material, or a parameter of one, refers to colours of a mesh's vertices."""
    return any("attribute" in texture for texture in textures_of(value))
