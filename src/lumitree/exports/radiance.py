"""Radiance: point lights as small spheres with tables of intensity by direction.

Each light is a sphere of the type `illum`, which illuminates and is not seen. Its pattern is one of
the type `colordata`: three tables, of R, G and B, over the light, and over the row and the column
of the octahedral map, with a border (`core.octahedral.bordered`). Radiance interpolates linearly
between their values, as the light field is defined, so that no direction is resampled.

The folder `lamp_files` beside `lamp.rad` has `light.cal`, the map, and `r.dat`, `g.dat`, `b.dat`.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from lumitree.core.octahedral import bordered
from lumitree.core.photometry import luminance
from lumitree.errors import shown
from lumitree.exports.point_lights import PlacedLights
from lumitree.exports.target import ExportRequest, Target, Written

# Radiance's luminous efficacy, lm/W, and the luminance of its primaries.
EFFICACY = 179.0
LUMA = (0.265074126, 0.670114631, 0.064811243)
_LOST = [
    "the lamp itself is not shown: in Radiance its surfaces would block the light of the lights",
    "the lamp casts no shadow in the light of others",
    "colours keep their R, G and B; Radiance's green primary is another, and its white is x = y",
]
# Radius of the spheres over half the longest side of the lamp's box.
_RADIUS = 1e-3
# As `core.octahedral` has it: R bins a side, in octahedral coordinates p and q.
_MAP = """\
{{ Direction from a light to the point that it illuminates, in the octahedral map of the tables,
  whose edges are bevelled. A1 is the number of the light. }}
x = {0};
y = {1};
z = {2};
bins = {3};
strip = (max(abs(x), abs(y)) + abs(z)) / (1 - 1 / bins);
length = max(max(abs(x) + abs(y) + abs(z), strip), abs(z) / (1 - 2 / bins));
flat_p = abs(x) / length;
flat_q = abs(y) / length;
i = floor((flat_p * bins - 1) / 2);
j = floor((flat_q * bins - 1) / 2);
s = (flat_p * bins - 1) / 2 - i;
t = (flat_q * bins - 1) / 2 - j;
a = 1 - 2 * flat_p;
b = 1 - 2 * flat_q;
half = 1 - s * b - t * a;
root = sqrt(max(half * half - 4 * a * b * s * t, 0));
crossed = min(min(i, j) + 0.5, 0.5 - abs(i + j + 2 - bins / 2));
moved = if(crossed, 4 * s * t / (bins * (half + root)), 0);
p = flat_p + moved * a;
q = flat_q + moved * b;
column = if(x, 1, -1) * if(z, p, 1 - q);
row = if(y, 1, -1) * if(z, q, 1 - p);
light_number = A1;
"""


def radiance_intensity(intensity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Intensity [..., 3] of R, G and B for Radiance, of lumitree's in W/sr.

    The ratios of R, G and B stay, and the luminous intensity is the same in both.
    """
    lumens = EFFICACY * (intensity @ np.array(LUMA))
    factor = np.divide(luminance(intensity), lumens, out=np.zeros_like(lumens), where=lumens > 0)
    return intensity * factor[..., None]


def _write(request: ExportRequest, folder: Path) -> Written:
    lights = request.place("z")
    side = folder / request.side_folder
    side.mkdir()
    (side / "light.cal").write_text(_map(lights), encoding="ascii", newline="\n")
    for channel, name in enumerate("rgb"):
        with open(side / f"{name}.dat", "w", encoding="ascii", newline="\n") as file:
            _write_table(file, lights, channel)
    scene = "".join(f"{line}\n" for line in _scene(request, lights))
    (folder / request.name).write_text(scene, encoding="utf-8", newline="\n")
    return Written(not_carried_over=_LOST, lights=len(lights.position))


def _map(lights: PlacedLights) -> str:
    # Radiance's rays go to the light, so the direction of its light is -D.
    rows = [
        " ".join(f"{-value:+.9f}*D{axis}" for value, axis in zip(row, "xyz", strict=True))
        for row in lights.rotation.T
    ]
    return _MAP.format(*rows, lights.local.resolution)


def _write_table(file: TextIO, lights: PlacedLights, channel: int) -> None:
    """Intensities of all lights for one channel; the last index changes fastest."""
    resolution = lights.local.resolution
    # A table has at least two values along each side.
    count = max(len(lights.position), 2)
    edge = 1 + 1 / resolution
    side = f"{-edge:.9f} {edge:.9f} {resolution + 2}"
    file.write(f"3\n0 {count - 1} {count}\n{side}\n{side}\n")
    for index in range(count):
        intensity = lights.local.intensity[min(index, len(lights.position) - 1)] * lights.scale**2
        values = radiance_intensity(intensity)[:, channel].reshape(resolution, resolution)
        np.savetxt(file, bordered(values, 1), fmt="%.6g")


def _scene(request: ExportRequest, lights: PlacedLights) -> Iterator[str]:
    # Radiance separates words by spaces, and looks for files from the folder of its program on.
    stem, side = request.stem, request.side_folder
    radius = _RADIUS * lights.scale
    radiance = f"{1 / (np.pi * radius**2):.9g}"
    name = shown(request.asset.luminaire)
    yield f"# {name}: {len(lights.position)} point lights, written by lumitree."
    yield "# Lengths in metres, z up. Keep it beside the folder of its tables, and run Radiance's"
    yield "# programs there, or name the place in RAYPATH. To move the lamp: !xform."
    for index, (x, y, z) in enumerate(lights.position.tolist()):
        yield ""
        yield f"void colordata {stem}_table_{index}"
        yield f"10 red green blue {side}/r.dat {side}/g.dat {side}/b.dat"
        yield f"   {side}/light.cal light_number row column"
        yield f"0\n1 {index}"
        yield f"{stem}_table_{index} illum {stem}_light_{index}"
        yield f"0\n0\n3 {radiance} {radiance} {radiance}"
        yield f"{stem}_light_{index} sphere {stem}_sphere_{index}"
        yield f"0\n0\n4 {x:.9g} {y:.9g} {z:.9g} {radius:.9g}"


TARGET = Target(
    name="Radiance",
    write=_write,
    up="z",
    units="metres; W/(m² sr) of Radiance: its 179 lm/W give the luminance that lumitree's 683 lm/W "
    "give",
)
