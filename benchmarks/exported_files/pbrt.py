"""Reads the lights of a lamp that was exported for pbrt-v4, as pbrt does."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.exported_files.lights import ReadLight
from lumitree.core.images import read_exr
from lumitree.core.photometry import LUMA
from lumitree.errors import LumitreeError

Array = NDArray[np.float64]
_LIGHT = re.compile(
    r"AttributeBegin\s+Translate (?P<place>[^\n]+)\s+"
    r'LightSource "goniometric" "string filename" "(?P<name>[^"]+)"\s+'
    r'"rgb I" \[(?P<colour>[^]]+)\]\s+"float scale" (?P<scale>\S+)\s+AttributeEnd'
)


def square_of(direction: Array) -> Array:
    """Place in the unit square of directions [N, 3]; pbrt's EqualAreaSphereToSquare, exactly."""
    x, y, z = np.abs(direction).T
    radius = np.sqrt(1 - z)
    part = np.arctan2(y, x) * 2 / np.pi
    u, v = radius * (1 - part), radius * part
    below = direction[:, 2] < 0
    u, v = np.where(below, 1 - v, u), np.where(below, 1 - u, v)
    signed = np.copysign(u, direction[:, 0]), np.copysign(v, direction[:, 1])
    return (np.stack(signed, axis=-1) + 1) / 2


class PbrtLight:
    """A light as pbrt reads it.

    Attributes:
        place: [3], m.
        colour: [3] R, G and B.
        scale: of the image.
        image: [N, N] by row and column.

    Args:
        folder: of the scene.
        found: the parameters in the file, by name.

    Raises:
        LumitreeError: the image has other channels than Y.
    """

    def __init__(self, folder: Path, found: dict[str, str]) -> None:
        self.place = np.array(found["place"].split(), float)
        self.colour = np.array(found["colour"].split(), float)
        self.scale = float(found["scale"])
        channels = read_exr(folder / found["name"])
        if list(channels) != ["Y"]:
            raise LumitreeError(f"{found['name']} has the channels {list(channels)}; expected Y")
        self.image = channels["Y"].astype(np.float64)

    def intensity(self, direction: Array) -> Array:
        """Candela per R, G and B for directions [N, 3]; pbrt exchanges y and z of the image."""
        side = len(self.image)
        column, row = np.minimum(
            (square_of(direction[:, [0, 2, 1]]) * side).astype(int), side - 1
        ).T
        return self.scale * self.image[row, column, None] * self.colour

    @property
    def power(self) -> Array:
        """Flux [3], lm per R, G and B; texels have equal areas."""
        return 4 * np.pi * self.image.mean() * self.scale * self.colour


def pbrt_lights(path: Path) -> list[PbrtLight]:
    """The lights of a file, with their images."""
    found = _LIGHT.finditer(path.read_text(encoding="utf-8"))
    return [PbrtLight(path.parent, each.groupdict()) for each in found]


def read_lights(path: Path) -> list[ReadLight]:
    """The lights of a file."""
    return [
        ReadLight(light.place, lambda direction, light=light: light.intensity(direction) @ LUMA)
        for light in pbrt_lights(path)
    ]
