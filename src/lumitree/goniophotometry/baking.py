"""Assets with an exitant light field only, from photometric files and ray files.

A photometric file states the far field. Its asset emits it from every point of the luminous
opening, with equal probability; a file without an opening gets a cube of 1 cm.
"""

import os
from pathlib import Path

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset, exitant_asset
from lumitree.asset.exitant import MAX_RESOLUTION, make_exitant_field
from lumitree.core.device import on_device
from lumitree.core.frames import LocalFrame
from lumitree.core.octahedral import direction_in_bin, solid_angles
from lumitree.errors import LumitreeError
from lumitree.exitant.bake import Histogram
from lumitree.exitant.config import ExitantConfig
from lumitree.goniophotometry.files import read_ies, read_ldt
from lumitree.goniophotometry.rays import Rays
from lumitree.goniophotometry.tm25 import read_tm25
from lumitree.goniophotometry.type_c import IntensityDistribution
from lumitree.model.photometry import LUMENS_PER_WATT

# Side of the box of a source without extent, m; and the shortest side, as a part of the longest.
POINT_SIZE = 0.01
_MIN_EXTENT = 1e-6
# Points per bin and side of the quadrature.
_FINE = 8


def bake_file(path: str | os.PathLike[str], config: ExitantConfig) -> Asset:
    """Asset of a photometric file or ray file.

    Args:
        path: file with one of `luminaire.source.PHOTOMETRIC_SUFFIXES`.
        config: grid of a ray file's light field. That of a photometric file has 2³ cells, which
            have equal intensities, and 128² bins.

    Raises:
        LumitreeError: the file cannot be read, or emits nothing.
    """
    if Path(path).suffix.lower() in (".ies", ".ldt"):
        read = read_ies if Path(path).suffix.lower() == ".ies" else read_ldt
        return bake_distribution(read(path))
    return bake_rays(*read_tm25(path), config)


def bake_distribution(distribution: IntensityDistribution) -> Asset:
    """Asset that emits an intensity distribution, with R = G = B."""
    sides = np.array(distribution.opening)
    if sides.max() < _MIN_EXTENT:
        sides = np.full(3, POINT_SIZE)
    frame = LocalFrame.of_box(-sides / 2, sides / 2)
    candela = _bin_means(distribution, MAX_RESOLUTION)
    total = float(candela @ solid_angles(MAX_RESOLUTION))
    if not total > 0:
        raise LumitreeError(f"{distribution.name} emits nothing; expected intensities above 0")
    # The quadrature is exact to about 0.1 %.
    candela *= distribution.lumens / total
    watts = candela[:, None] / LUMENS_PER_WATT * np.ones(3)
    corners = np.indices((2, 2, 2)).reshape(3, -1).T
    intensity = np.broadcast_to(watts / len(corners), (len(corners), *watts.shape))
    field = make_exitant_field(corners, intensity / frame.scale**2, 1)
    return exitant_asset(field, frame, distribution.name)


def bake_rays(rays: Rays, name: str, config: ExitantConfig) -> Asset:
    """Asset with the histogram of rays by the cell of their start and by direction.

    Args:
        rays: of the source.
        name: of the source.
        config: depth and resolution of the grid.
    """
    lower, upper = rays.origin.min(axis=0), rays.origin.max(axis=0)
    if (upper - lower).max() < _MIN_EXTENT:
        lower, upper = lower - POINT_SIZE / 2, upper + POINT_SIZE / 2
    frame = LocalFrame.of_box(lower, upper)
    origin = (rays.origin - frame.centre) / frame.scale
    histogram = Histogram(config.depth, config.resolution)
    histogram.add(
        on_device(mi.Point3f, origin), on_device(mi.Vector3f, rays.direction), rays.flux.T
    )
    intensity = histogram.flux / solid_angles(config.resolution)[:, None] / frame.scale**2
    return exitant_asset(make_exitant_field(histogram.cells, intensity, config.depth), frame, name)


def _bin_means(distribution: IntensityDistribution, resolution: int) -> NDArray[np.float64]:
    """Mean intensity [R²], cd, of each octahedral bin."""
    points = (np.indices((_FINE, _FINE)).reshape(2, -1).T + 0.5) / _FINE
    bins = on_device(mi.UInt32, np.repeat(np.arange(resolution**2), len(points)))
    sample = on_device(mi.Point2f, np.tile(points, (resolution**2, 1)))
    direction, density = direction_in_bin(bins, sample, resolution)
    weight = 1 / np.array(density, np.float64)
    value = distribution.at(np.array(direction, np.float64).reshape(3, -1).T)
    parts = (each.reshape(-1, len(points)).sum(axis=1) for each in (weight * value, weight))
    return np.divide(*parts)
