"""Assets with a light field only, from photometric files and ray files.

A photometric file states the far field, and the luminous opening that the light comes from. Its
asset emits the intensity of a direction ω evenly over the opening's projection along ω, to which a
surface element of area dA and normal n adds max(n·ω, 0) dA. A file without an opening gets a cube
of 1 cm.
"""

import math
from collections.abc import Callable, Sequence

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset, light_field_asset
from lumitree.asset.light_field import make_light_field
from lumitree.asset.spectrum import EmittedSpectrum
from lumitree.core.device import on_device
from lumitree.core.frames import LocalFrame
from lumitree.core.octahedral import direction_in_bin, middle_directions, solid_angles
from lumitree.core.photometry import LUMENS_PER_WATT, RGB
from lumitree.errors import LumitreeError
from lumitree.formats.opening import Opening
from lumitree.formats.rays import Rays
from lumitree.formats.start_cells import StartCells
from lumitree.formats.type_c import IntensityDistribution
from lumitree.lamp.parts import WHITE
from lumitree.trace.histograms import Histogram
from lumitree.trace.light_field_config import LightFieldConfig

Array = NDArray[np.float64]
# Side of the box of a source without extent, m; and the shortest side, as a part of the longest.
POINT_SIZE = 0.01
_MIN_EXTENT = 1e-6
# Bins of direction a side of an asset of a photometric file.
RESOLUTIONS = (64, 128)
# Points per bin and side of the quadrature.
_FINE = 8
# Bins of an asset of a photometric file, cells times bins of direction; 4 bytes each.
_MAX_BINS = 1 << 21
_MAX_DEPTH, _DISK_DEPTH = 3, 3
# Bins of direction a side in which the light starts in the same cells, and how many at once.
_COARSE, _BINS_AT_ONCE = 32, 32
# Relative RMS error of intensities that are constant in coarser bins.
_COARSE_ERROR = 0.02


def bake_distribution(distribution: IntensityDistribution, colour: RGB = WHITE) -> Asset:
    """Asset that emits an intensity distribution from its luminous opening.

    Args:
        distribution: with its opening.
        colour: linear RGB of luminance 1.
    """
    opening = distribution.opening
    if max(opening.sides) < _MIN_EXTENT:
        opening = Opening((POINT_SIZE, POINT_SIZE, POINT_SIZE))
    sides = np.array(opening.sides)
    frame = LocalFrame.of_box(-sides / 2, sides / 2)
    candela = bin_means(distribution.at)
    resolution = math.isqrt(len(candela))
    total = float(candela @ solid_angles(resolution))
    if not total > 0:
        raise LumitreeError(f"{distribution.name} emits nothing; expected intensities above 0")
    # The quadrature is exact to about 0.1 %.
    candela *= distribution.lumens / total
    if opening.is_flat or opening.sides != distribution.opening.sides:
        depth, cells, area = _flat_shares(opening, frame)
        shares = area[:, None]
    else:
        depth, cells, shares = _projected_shares(opening, frame, resolution)
    watts = candela / LUMENS_PER_WATT / frame.scale**2
    intensity = (shares * watts)[..., None] * np.array(colour)
    return light_field_asset(make_light_field(cells, intensity, depth), frame, distribution.name)


def _flat_shares(
    opening: Opening, frame: LocalFrame
) -> tuple[int, NDArray[np.int64], NDArray[np.float64]]:
    """Depth of a grid, cells [C, 3], and their parts [C] of the opening, for all directions."""
    if opening.shape == "box":
        # What is even over the box is exact with cells of any size.
        return 1, np.indices((2, 2, 2)).reshape(3, -1).T, np.full(8, 1 / 8)
    points, areas = opening.surface()
    side = 1 << _DISK_DEPTH
    index = np.floor((points / frame.scale + 1) * (side / 2)).astype(np.int64)
    cells, cell = np.unique(np.clip(index, 0, side - 1), axis=0, return_inverse=True)
    area = np.bincount(cell.ravel(), np.linalg.norm(areas, axis=1))
    return _DISK_DEPTH, cells, area / area.sum()


def _projected_shares(
    opening: Opening, frame: LocalFrame, resolution: int
) -> tuple[int, NDArray[np.int64], NDArray[np.float64]]:
    """Depth of a grid, cells [C, 3], and the part [C, R²] of the light of each bin that they emit.

    Light that leaves a surface in a direction may start anywhere on the ray behind it. It starts
    beside the centre of the opening: cells then blur it evenly to all sides. If it started on the
    surface, cells would move it inwards. The parts are constant in coarser bins than intensities.
    """
    directions = middle_directions(_COARSE)
    depth, flux = _MAX_DEPTH, np.zeros((0, 0))
    while depth > 0:
        starts = _Starts(opening, frame, depth)
        parts = range(0, len(directions), _BINS_AT_ONCE)
        flux = np.concatenate(
            [starts.flux(directions[at : at + _BINS_AT_ONCE]) for at in parts], axis=1
        )
        if np.count_nonzero(flux.any(axis=1)) * resolution**2 <= _MAX_BINS:
            break
        depth -= 1
    cells = np.flatnonzero(flux.any(axis=1))
    shares = (flux[cells] / flux[cells].sum(axis=0)).reshape(-1, _COARSE, _COARSE)
    shares = np.kron(shares, np.ones((1, resolution // _COARSE, resolution // _COARSE)))
    places = np.stack(np.unravel_index(cells, (1 << depth,) * 3), axis=1)
    return depth, places, shares.reshape(len(cells), -1)


class _Starts:
    """Where light starts in a grid of 2**depth cells a side, by its direction."""

    def __init__(self, opening: Opening, frame: LocalFrame, depth: int) -> None:
        self._cells, self._half = StartCells(frame, depth), frame.half_extents
        points, self._areas = opening.surface()
        self._points = points / frame.scale / self._half

    def flux(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative flux [side³, B] of each cell in directions [B, 3]."""
        along = directions / self._half
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        # In the cube [-1, 1]³: the point of the ray next to the centre, if that is inside.
        safe = np.where(along == 0, 1e-9, along)[:, None]
        to_face = ((self._points + np.copysign(1, safe)) / safe).min(axis=2)
        back = np.clip(along @ self._points.T, 0, to_face)
        start = (self._points - back[..., None] * along[:, None]) * self._half
        projected = np.maximum(directions @ self._areas.T, 0)
        size = self._cells.side**3
        total = np.zeros(size * len(along))
        offset = size * np.arange(len(along))[:, None]
        for code, weight in self._cells.around(start):
            total += np.bincount((code + offset).ravel(), (projected * weight).ravel(), len(total))
        return total.reshape(len(along), size).T


def bake_rays(rays: Rays, name: str, config: LightFieldConfig) -> Asset:
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
    field = make_light_field(histogram.cells, intensity, config.depth)
    spectrum = None if rays.spectrum is None else EmittedSpectrum.of(rays.spectrum)
    return light_field_asset(field, frame, name, spectrum)


def bin_means(at: Callable[[Array], Array], resolutions: Sequence[int] = RESOLUTIONS) -> Array:
    """Mean intensity [R²], cd, of each octahedral bin.

    Args:
        at: intensity [...], cd, of directions [..., 3].
        resolutions: R is the first that resolves the intensities, or the last.
    """
    last = resolutions[-1]
    fine = _means(at, last)
    for resolution in resolutions[:-1]:
        coarse = _means(at, resolution)
        parts = np.ones((last // resolution,) * 2)
        repeated = np.kron(coarse.reshape(resolution, resolution), parts).ravel()
        error = np.sqrt(np.mean((fine - repeated) ** 2) / max(np.mean(fine**2), 1e-300))
        if error < _COARSE_ERROR:
            return coarse
    return fine


def _means(at: Callable[[Array], Array], resolution: int) -> Array:
    points = (np.indices((_FINE, _FINE)).reshape(2, -1).T + 0.5) / _FINE
    bins = on_device(mi.UInt32, np.repeat(np.arange(resolution**2), len(points)))
    sample = on_device(mi.Point2f, np.tile(points, (resolution**2, 1)))
    direction, density = direction_in_bin(bins, sample, resolution)
    weight = 1 / np.array(density, np.float64)
    value = at(np.array(direction, np.float64).reshape(3, -1).T)
    parts = (each.reshape(-1, len(points)).sum(axis=1) for each in (weight * value, weight))
    return np.divide(*parts)
