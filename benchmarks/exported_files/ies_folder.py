"""Reads the lights of a lamp that was exported as a folder of IES files."""

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.exported_files.lights import ReadLight
from lumitree.formats.ies import read_ies
from lumitree.formats.type_c import IntensityDistribution, y_up

PLACEMENT = "placement.csv"


def placed_profiles(folder: Path) -> list[tuple[dict[str, str], IntensityDistribution]]:
    """Rows of the table by column, with the distribution of each file."""
    with open(folder / PLACEMENT, encoding="utf-8", newline="") as file:
        # The first line describes the columns.
        file.readline()
        return [(row, read_ies(folder / row["file"])) for row in csv.DictReader(file)]


def place(row: dict[str, str]) -> NDArray[np.float64]:
    """[3] of the light of a row, m, y up."""
    return y_up(np.array([float(row[name]) for name in ("x_m", "y_m", "z_m")]))


def read_lights(folder: Path) -> list[ReadLight]:
    """The lights of a folder."""
    return [ReadLight(place(row), found.at) for row, found in placed_profiles(folder)]
