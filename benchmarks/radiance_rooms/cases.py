"""Lamps in rooms, from a point in a black room to a baked lamp above furniture."""

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.radiance_rooms.lamps import FileLamp, ShadedLamp
from benchmarks.radiance_rooms.rooms import Box, furniture, walls
from lumitree.formats.opening import Opening
from lumitree.formats.type_c import Grid, IntensityDistribution

# A function of the angles C and gamma, radians.
Intensity = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
# Step of the files, degrees.
_STEP = 5.0


@dataclasses.dataclass(frozen=True)
class Case:
    """A lamp in a room.

    Attributes:
        name: of the case.
        lamp: what is compared.
        at: [3] centre of the luminous opening of a file, or of a lamp's box, m.
        boxes: of the room.
        black: whether nothing reflects.
    """

    name: str
    lamp: FileLamp | ShadedLamp
    at: tuple[float, float, float]
    boxes: list[Box]
    black: bool = False


def cases() -> list[Case]:
    """All cases."""
    black, grey = walls(0, 0, 0), walls(0.3, 0.5, 0.7)
    spot = _lamp("spot", _spot, Opening())
    panel = _lamp("panel", _batwing, Opening((1.2, 0.0, 0.3)))
    pendant = _lamp("pendant", _up_and_down, Opening((1.2, 0.05, 0.1)))
    furnished = grey + furniture()
    # Radiance's panel is a surface that hides the ceiling behind it, lumitree's is none.
    housing = Box((-0.4, 2.752, -0.25), (0.8, 2.799, 0.05), 0.0)
    return [
        Case("spot, black room", spot, (-0.4, 2.5, 0.3), black, black=True),
        Case("panel, empty room", panel, (0.2, 2.75, -0.1), [*grey, housing]),
        Case("panel, furnished room", panel, (0.2, 2.75, -0.1), [*furnished, housing]),
        Case("pendant, furnished room", pendant, (-0.2, 2.0, 0.0), furnished),
        Case("baked lamp, black room", ShadedLamp(), (-0.2, 2.0, 0.0), black, black=True),
    ]


def _lamp(name: str, intensity: Intensity, opening: Opening) -> FileLamp:
    grid = Grid(_STEP)
    c, gamma = np.meshgrid(np.deg2rad(grid.c), np.deg2rad(grid.gamma), indexing="ij")
    values = intensity(c, gamma)
    return FileLamp(IntensityDistribution(name, grid.c, grid.gamma, values, opening))


def _spot(c: NDArray[np.float64], gamma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Wide, and brighter towards C = 40 degrees."""
    cosine = np.maximum(np.cos(gamma), 0)
    return 900 * cosine**3 * (1 + 0.5 * np.sin(gamma) * np.cos(c - np.deg2rad(40)))


def _batwing(c: NDArray[np.float64], gamma: NDArray[np.float64]) -> NDArray[np.float64]:
    """More to the sides than down, and more across than along."""
    sine = np.sin(gamma) ** 2
    return 600 * np.maximum(np.cos(gamma), 0) * (1 + 1.5 * sine * (1 - 0.4 * np.cos(2 * c)))


def _up_and_down(c: NDArray[np.float64], gamma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Down, up and a little to the sides."""
    cosine = np.cos(gamma)
    share = np.where(cosine > 0, 400 * cosine**2, 250 * cosine**2)
    return (share + 60 * np.sin(gamma) ** 2) * (1 + 0.2 * np.sin(gamma) * np.sin(c))
