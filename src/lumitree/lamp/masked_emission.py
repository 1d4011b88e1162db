"""Emission of surfaces with an opacity mask.

Mitsuba's emitters also emit where a mask lets light through. So the radiance that is written is
that of the material times its opacity.
"""

import dataclasses
import math
import warnings
from collections.abc import Hashable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.images import linear_from_srgb, resized
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.lamp.meshes import Floats, Mesh
from lumitree.lamp.parts import RGB, Colour, Material, Texture, Value, VertexColour

# For all products of one model.
_MAX_BYTES = 5 * 2**28
# Points at which the opacity of a mesh is looked up, about.
_POINTS = 1 << 18


class MaskedEmission:
    """Radiance times opacity of the materials of a model; equal products are made once."""

    def __init__(self) -> None:
        self._made: dict[Hashable, NDArray[np.float32]] = {}

    def of(self, material: Material) -> Colour | None:
        """Emission of a material; None for nothing.

        The mean of an opacity whose texture coordinates differ from the radiance's, after a
        warning.
        """
        radiance, opacity = material.radiance, material.opacity
        if radiance is None or (not isinstance(opacity, Texture) and opacity == 0):
            return None
        if isinstance(radiance, VertexColour) or opacity == 1:
            return radiance
        if not isinstance(radiance, Texture):
            if not isinstance(opacity, Texture):
                red, green, blue = (float(opacity * value) for value in radiance)
                return (red, green, blue)
            return self._product(radiance, opacity, opacity, material.title)
        if isinstance(opacity, Texture) and not _placed_alike(radiance, opacity):
            warnings.warn(
                f"material {shown(material.title)!r}: its opacity has other texture coordinates "
                "than what it emits, which is multiplied by the mean of the opacity",
                LumitreeWarning,
                stacklevel=2,
            )
            opacity = float(opacity.pixels.mean() / 255)
        return self._product(radiance, opacity, radiance, material.title)

    def _product(
        self, radiance: RGB | Texture, opacity: Value, placed: Texture, title: str
    ) -> Texture:
        """A texture that is placed like one of both."""
        key = _key(radiance), _key(opacity)
        if key not in self._made:
            light, share = _linear(radiance), _linear(opacity)
            height, width = np.maximum(light.shape[:2], share.shape[:2]).tolist()
            size = sum(each.nbytes for each in self._made.values()) + 12 * height * width
            if size > _MAX_BYTES:
                raise LumitreeError(
                    f"material {shown(title)!r}: what it emits, times its opacity, brings such "
                    f"images to {size >> 20} MiB; at most {_MAX_BYTES >> 20} MiB: make them smaller"
                )
            product = _enlarged(light, height, width) * _enlarged(share, height, width)
            self._made[key] = product.astype(np.float32)
        return dataclasses.replace(placed, pixels=self._made[key], encoded=False)


def opacity_of_faces(opacity: Value, mesh: Mesh) -> Floats:
    """Mean opacity [F] of the faces of a mesh."""
    count = len(mesh.faces)
    if not isinstance(opacity, Texture):
        return np.full(count, float(opacity))
    if mesh.uv is None:
        return np.full(count, float(_looked_up(opacity, np.zeros((1, 2)))[0]))
    total, points = np.zeros(count), _points_of_triangle(math.isqrt(_POINTS // max(count, 1)))
    corners = mesh.uv[mesh.faces]
    for point in points:
        total += _looked_up(opacity, np.einsum("c,fcx->fx", point, corners))
    return total / len(points)


def _points_of_triangle(parts: int) -> Floats:
    """Barycentric coordinates [N, 3] of the middles of the equal parts of a triangle."""
    side = min(max(parts, 1), 128)
    i, j = (each.ravel() for each in np.meshgrid(np.arange(side), np.arange(side)))
    upright = np.stack([i, j], axis=1)[i + j < side] + 1 / 3
    turned = np.stack([i, j], axis=1)[i + j < side - 1] + 2 / 3
    two = np.concatenate([upright, turned]) / side
    return np.column_stack([two, 1 - two.sum(axis=1)])


def _looked_up(texture: Texture, uv: Floats) -> Floats:
    """Values [N] of the nearest pixels of a texture with one channel, in [0, 1]."""
    place = uv @ texture.uv_transform[:2, :2].T + texture.uv_transform[:2, 2]
    match texture.wrap:
        case "repeat":
            place = place % 1.0
        case "mirror":
            place = 1 - np.abs(place % 2.0 - 1)
        case "clamp":
            pass
    height, width = texture.pixels.shape[:2]
    column, row = (
        np.clip(np.floor(place[:, axis] * size), 0, size - 1).astype(np.int64)
        for axis, size in ((0, width), (1, height))
    )
    return texture.pixels[row, column, 0] / 255.0


def _placed_alike(first: Texture, second: Texture) -> bool:
    same = np.array_equal(first.uv_transform, second.uv_transform)
    return same and first.wrap == second.wrap


def _key(value: RGB | Value) -> Hashable:
    return id(value.pixels) if isinstance(value, Texture) else value


def _linear(value: RGB | Value) -> Any:
    """Linear values [H, W, C]; [1, 1, C] of what is constant."""
    if not isinstance(value, Texture):
        return np.reshape(value, (1, 1, -1))
    if value.pixels.dtype != np.uint8:
        return value.pixels
    pixels = value.pixels / np.float32(255)
    return linear_from_srgb(pixels) if value.encoded else pixels


def _enlarged(values: Any, height: int, width: int) -> Any:
    """Values [H, W, C] in another size; a single pixel stays one."""
    if values.shape[:2] in ((1, 1), (height, width)):
        return values
    return resized(values, height, width)
