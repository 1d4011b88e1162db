"""pbrt-v4: goniometric lights, each with an image of intensity by direction.

pbrt takes the nearest texel of a square image in the equal-area octahedral map of Clarberg 2008,
whose y and z it exchanges. A texel has the mean intensity of its directions, and each image the
flux of its light. An image has one channel, so a light whose colour depends on the direction
becomes three lights at one point: of R, of G and of B.

Symbols
    N   texels a side
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.core.images import write_exr
from lumitree.core.octahedral import bilinear_bins
from lumitree.core.photometry import LUMA, LUMENS_PER_WATT
from lumitree.core.progress import progress
from lumitree.errors import shown
from lumitree.exports.point_lights import PlacedLights
from lumitree.exports.target import ExportRequest, Target, Written

_LOST = [
    "the lamp itself is not shown: in pbrt its surfaces would block the light of the lights",
    "the lamp casts no shadow in the light of others",
]
# Texels in a bin of the light field, a side, and directions in a texel that its value is the mean
# of.
_TEXELS, _SUPERSAMPLED = 4, 2
# A light has one colour if its intensities differ from that by less than this, on average.
_ONE_COLOUR = 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class _Image:
    """Intensity of a light of one colour: linear sRGB [3] times W/sr [N, N] by row and column."""

    colour: NDArray[np.float64]
    watts: NDArray[np.float64]


def equal_area_directions(side: int) -> NDArray[np.float64]:
    """Unit directions [N, N, 3] in the middle of texels by row and column, z in the middle.

    The equal-area map of the square to the sphere (Clarberg 2008).
    """
    middles = (np.arange(side) + 0.5) * (2 / side) - 1
    u, v = np.meshgrid(middles, middles)
    inside = 1 - np.abs(u) - np.abs(v)
    radius = 1 - np.abs(inside)
    turn = (np.abs(v) - np.abs(u)) / np.where(radius > 0, radius, 1)
    azimuth = (turn + 1) * (np.pi / 4)
    flat = radius * np.sqrt(2 - radius**2)
    x, y = np.copysign(flat * np.cos(azimuth), u), np.copysign(flat * np.sin(azimuth), v)
    return np.stack([x, y, np.copysign(1 - radius**2, inside)], axis=-1)


class _Images:
    """Makes the images of lights, which are in the frame of the scene."""

    def __init__(self, lights: PlacedLights) -> None:
        self._lights = lights
        self.side = _TEXELS * lights.local.resolution
        fine = equal_area_directions(self.side * _SUPERSAMPLED).reshape(-1, 3)
        # pbrt exchanges y and z of the directions of a light.
        self._bins, self._weights = bilinear_bins(
            fine[:, [0, 2, 1]] @ lights.rotation, lights.local.resolution
        )

    def of(self, index: int) -> list[_Image]:
        """One image if the light has one colour, else one of each of R, G and B; none is black."""
        scale = self._lights.scale**2
        intensity = self._lights.local.intensity[index] * scale
        flux = self._lights.watts[index]
        colour = flux / (flux @ np.array(LUMA))
        grey = intensity @ np.array(LUMA)
        if np.abs(intensity - grey[:, None] * colour).sum() < _ONE_COLOUR * intensity.sum():
            return [_Image(colour, self._image(grey, flux @ np.array(LUMA)))]
        return [
            _Image(np.eye(3)[channel], self._image(intensity[:, channel], flux[channel]))
            for channel in range(3)
            if flux[channel] > 0
        ]

    def _image(self, intensity: NDArray[np.float64], flux: float) -> NDArray[np.float64]:
        """Means [N, N] of intensities [R²], with a flux."""
        fine = (intensity[self._bins] * self._weights).sum(axis=1)
        blocks = fine.reshape(self.side, _SUPERSAMPLED, self.side, _SUPERSAMPLED)
        texels = blocks.mean(axis=(1, 3))
        return texels * (flux / (4 * np.pi * texels.mean()))


def _write(request: ExportRequest, folder: Path) -> Written:
    lights = request.place("y")
    images, luminaire, count = _Images(lights), request.asset.luminaire, len(lights.position)
    lines = [
        f"# {shown(luminaire)}: {count} point lights for pbrt-v4, written by lumitree.",
        '# Write Include "this file" after WorldBegin of a scene in the same folder. To move the',
        "# lamp, put AttributeBegin and transforms before it. Metres, y up, right-handed.",
        f"# Images are in W/sr of R, G and B; the scale of {LUMENS_PER_WATT:g} lm/W makes them",
        "# candela, so that R, G and B of an image of pbrt have a luminance in cd/m².",
    ]
    (folder / request.side_folder).mkdir()
    with progress(f"images of {luminaire}", count) as advance:
        for index, position in enumerate(lights.position.tolist()):
            for number, image in enumerate(images.of(index)):
                name = f"{request.side_folder}/{index}.{number}.exr"
                write_exr(folder / name, {"Y": image.watts.astype(np.float32)})
                lines += _light(position, image.colour.tolist(), name)
            advance(1)
    (folder / request.name).write_bytes(("\n".join(lines) + "\n").encode())
    return Written(not_carried_over=_LOST, lights=count)


def _light(position: list[float], colour: list[float], name: str) -> Iterator[str]:
    numbers = " ".join(f"{each:.9g}" for each in position)
    yield "AttributeBegin"
    yield f"  Translate {numbers}"
    yield f'  LightSource "goniometric" "string filename" "{name}"'
    yield f'    "rgb I" [ {" ".join(f"{each:.6g}" for each in colour)} ]'
    yield f'    "float scale" {LUMENS_PER_WATT:g}'
    yield "AttributeEnd"


TARGET = Target(
    name="pbrt-v4",
    write=_write,
    up="y",
    units="metres; pbrt's photometric units: an image of pbrt has R, G and B whose luminance is in "
    "cd/m², 683 times lumitree's radiance in W/(m² sr)",
    note="; coordinates are right-handed, and pbrt's cameras are left-handed: write Scale -1 1 1 "
    "before LookAt",
)
