"""Intensities and flux of a light field or a photometric file, without rays and without noise."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.asset.asset import Asset
from lumitree.core.frames import LocalFrame
from lumitree.core.octahedral import interpolated
from lumitree.core.photometry import luminance
from lumitree.formats.symmetry import EDGE
from lumitree.formats.type_c import (
    MIN_STEP,
    Grid,
    IntensityDistribution,
    direction_of,
    node_solid_angles,
)
from lumitree.rendering.asset_flux import asset_watts, intensity_by_bin

# Steps that are tried for the angles of a file, coarsest first; and for other light, degrees.
_FILE_STEPS, _STEP = (10.0, 5.0, 2.5, 1.0, MIN_STEP), 1.0
# Error of the flux at which the angles of a file that are on a grid are all that it has.
_FLUX_ERROR = 1e-3
# Error of intensities between nodes of a grid, over the largest, at which it is fine enough; and
# the part of the light that may have a larger one, at the edges of beams.
_MAX_ERROR, _EDGE_LIGHT = 0.0025, 0.002


@dataclasses.dataclass(frozen=True)
class ExactLight:
    """Light of an asset as far as it is known without rays; local units.

    Attributes:
        intensity: function of local unit directions [N, 3]: luminous intensity [N].
        watts: [3] radiant flux of R, G and B.
        bin_width: of the bins of direction in which light paths were counted, degrees, on average;
            None of other light.
        angles: C and γ of the intensities of a photometric file, degrees; None if it is none.
    """

    intensity: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    watts: NDArray[np.float64]
    bin_width: float | None
    angles: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None


def light_field_light(asset: Asset) -> ExactLight | None:
    """The light of an asset's light field; None if it has none."""
    if asset.light_field is None:
        return None
    by_bin, watts = intensity_by_bin(asset), asset_watts(asset) / asset.frame.scale**2
    traced = asset.light_field.traced is not None
    width = math.degrees(math.sqrt(4 * math.pi / len(by_bin))) if traced else None
    return ExactLight(lambda direction: interpolated(by_bin, direction), watts, width)


def file_light(
    distribution: IntensityDistribution, frame: LocalFrame, colour: ArrayLike = (1.0, 1.0, 1.0)
) -> ExactLight:
    """The light of a photometric file, of which there is an asset in this frame.

    The bins of the asset change intensities, so a file is converted without them.

    Args:
        colour: linear RGB of its light, of any luminance.
    """
    scale = frame.scale**2
    rgb = np.asarray(colour, np.float64)
    return ExactLight(
        lambda direction: distribution.at(direction @ frame.rotation.T) / scale,
        rgb * (distribution.lumens / float(luminance(rgb)) / scale),
        None,
        (distribution.c, distribution.gamma),
    )


def exact_grid(
    light: ExactLight, frame: LocalFrame, step: float | None
) -> tuple[Grid, NDArray[np.float64]]:
    """A grid, and intensities [C, G] of light without noise, cd.

    Where the angles of a file are on the grid, they are those of the file. Else they are means over
    the hats of nodes, as of rays: of the intensities at the nodes of a finer grid, of 0.5 degrees
    or less, and linear between them.

    Args:
        step: of the grid, degrees. None to choose it: of a file the coarsest of 10, 5, 2.5, 1 and
            0.5 that has all of its angles; of light in bins the coarsest of these that is at most
            half a bin, below which there are only the kinks between bins; else 1, or 0.5 if that
            does not resolve the light.
    """
    if step is None and light.bin_width is not None:
        step = next((each for each in _FILE_STEPS if each <= light.bin_width / 2), MIN_STEP)
    parts = 1 if step is None else math.ceil(step / MIN_STEP)
    fine = (MIN_STEP if step is None else step) / parts
    c = fine * np.arange(round(360 / fine), dtype=np.float64)
    gamma = fine * np.arange(round(180 / fine) + 1, dtype=np.float64)

    def candela(c: NDArray[np.float64], gamma: NDArray[np.float64]) -> NDArray[np.float64]:
        directions = direction_of(c[:, None], gamma).reshape(-1, 3)
        values = light.intensity(directions @ frame.rotation) * frame.scale**2
        return values.reshape(len(c), -1)

    directions, values = direction_of(c[:, None], gamma).reshape(-1, 3), candela(c, gamma).ravel()
    flux = values * node_solid_angles(c, gamma).ravel()

    def resolves(found: IntensityDistribution) -> bool:
        wrong = np.abs(found.at(directions) - values) > _MAX_ERROR * values.max()
        return flux[wrong].sum() <= _EDGE_LIGHT * flux.sum()

    lumens = float(luminance(light.watts)) * frame.scale**2
    for each in () if light.angles is None else _FILE_STEPS if step is None else (step,):
        grid = Grid(each)
        if all(_on_grid(angles, each) for angles in light.angles or ()):
            found = IntensityDistribution("", grid.c, grid.gamma, candela(grid.c, grid.gamma))
            if resolves(found) and abs(found.lumens - lumens) <= _FLUX_ERROR * lumens:
                return grid, found.intensity
    grid = Grid(_STEP if step is None else step)
    found = IntensityDistribution("", grid.c, grid.gamma, grid.intensity(directions, flux))
    if step is None and not resolves(found):
        grid = Grid(MIN_STEP)
        return grid, grid.intensity(directions, flux)
    return grid, found.intensity


def _on_grid(angles: NDArray[np.float64], step: float) -> bool:
    """Whether angles are multiples of a step, but those just beyond or before one with light."""
    on = np.abs(angles / step - np.round(angles / step)) * step < 1e-6
    if not on.any():
        return False
    return bool((np.abs(angles[:, None] - angles[on]).min(axis=1) <= 2 * EDGE).all())


def upward_share(light: ExactLight, frame: LocalFrame) -> float:
    """Part of the flux of light that goes up, +y of the file, 0 to 1."""
    step = MIN_STEP / 2
    # Between the angles of files, at which intensities may have steps.
    c = np.arange(MIN_STEP, 360, 2 * MIN_STEP)
    gamma = np.arange(step / 2, 180, step)
    direction = direction_of(c[:, None], gamma).reshape(-1, 3)
    intensity = light.intensity(direction @ frame.rotation).reshape(len(c), -1).mean(axis=0)
    flux = intensity * np.sin(np.deg2rad(gamma))
    up, down = float(flux[gamma > 90].sum()), float(flux[gamma < 90].sum())
    return up / (up + down) if up > 0 else 0.0
