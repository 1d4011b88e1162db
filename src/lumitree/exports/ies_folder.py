"""A folder for all other programs: an IES file for each point light, and a table of their places.

The files are LM-63-2019 of Type C, all in the frame of the lamp with z up, so that no light is
rotated. `placement.csv` begins with a comment that describes its columns.
"""

import csv
from pathlib import Path

import numpy as np

from lumitree.core.photometry import luminance
from lumitree.core.progress import progress
from lumitree.exports.light_profiles import light_distribution
from lumitree.exports.target import ExportRequest, Target, Written
from lumitree.formats.ies import write_ies
from lumitree.formats.type_c import z_up

PLACEMENT = "placement.csv"
COLUMNS = (
    "file", "x_m", "y_m", "z_m", "rotate_x_deg", "rotate_y_deg", "rotate_z_deg", "flux_lm",
    "red", "green", "blue",
)  # fmt: skip
_README = (
    "# Point lights of one lamp, written by lumitree: put each IES file at its place, in metres, "
    "z up, C = 0 towards +x. No file needs a rotation or a factor: its intensities are in candela. "
    "red, green and blue: linear sRGB colour of luminance 1."
)
_LOST = [
    "an IES file has no colour: each light has one (red, green and blue of placement.csv)",
    "the lamp itself is not shown; its surfaces would block the light of the lights",
    "the lamp casts no shadow in the light of others",
]
# Steps of the angles in the mean side of a bin; see docs/decisions/other-programs.md.
_STEPS_A_BIN = 6


def _write(request: ExportRequest, folder: Path) -> Written:
    lights = request.place("y")
    count = len(lights.position)
    lumens = luminance(lights.watts)
    colours = lights.watts / np.maximum(lumens / luminance([1, 1, 1]), 1e-300)[:, None]
    luminaire = request.asset.luminaire
    rows = []
    with progress(f"IES files of {luminaire}", count) as advance:
        for index, place in enumerate(z_up(lights.position).tolist()):
            file = f"light-{index + 1:0{len(str(count))}}.ies"
            intensity = lights.local.intensity[index] * lights.scale**2
            flux, name = float(lumens[index]), f"{luminaire} {index + 1}"
            profile = light_distribution(name, intensity, flux, lights.rotation, _STEPS_A_BIN)
            write_ies(folder / file, profile)
            numbers = [*place, 0, 0, 0, flux, *colours[index].tolist()]
            rows.append([file, *(f"{each:.9g}" for each in numbers)])
            advance(1)
    with open(folder / PLACEMENT, "w", encoding="utf-8", newline="") as table:
        table.write(_README + "\n")
        csv.writer(table, lineterminator="\n").writerows([COLUMNS, *rows])
    return Written(not_carried_over=_LOST, lights=count)


TARGET = Target(
    name="IES files", write=_write, up="z", units="metres; candela and lumens", is_folder=True
)
