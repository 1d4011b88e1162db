"""Assets with a light field only, from photometric files and ray files.

A photometric file states the far field, and the luminous opening that the light comes from. Its
asset emits the intensity of a direction ω evenly over the opening's projection along ω, to which a
surface element of area dA and normal n adds max(n·ω, 0) dA. A file without an opening gets a cube
of 1 cm.
"""

import itertools
import math
import os
from pathlib import Path

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset, light_field_asset
from lumitree.asset.light_field import MAX_RESOLUTION, make_light_field
from lumitree.asset.spectrum import EmittedSpectrum
from lumitree.core.device import on_device
from lumitree.core.frames import LocalFrame
from lumitree.core.octahedral import direction_in_bin, middle_directions, solid_angles
from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.errors import LumitreeError
from lumitree.formats.ies import read_ies
from lumitree.formats.ldt import read_ldt
from lumitree.formats.opening import Opening
from lumitree.formats.rays import Rays
from lumitree.formats.tm25 import read_tm25
from lumitree.formats.type_c import IntensityDistribution
from lumitree.trace.histograms import Histogram
from lumitree.trace.light_field_config import LightFieldConfig

# Side of the box of a source without extent, m; and the shortest side, as a part of the longest.
POINT_SIZE = 0.01
_MIN_EXTENT = 1e-6
# Points per bin and side of the quadrature.
_FINE = 8
# Bins of an asset of a photometric file, cells times bins of direction; 4 bytes each.
_MAX_BINS = 1 << 21
_MAX_DEPTH, _DISK_DEPTH = 3, 3
# Bins of direction a side in which the light starts in the same cells, and how many at once.
_COARSE, _BINS_AT_ONCE = 32, 32
# Relative RMS error of intensities that are constant in coarser bins.
_COARSE_ERROR = 0.02


def bake_file(path: str | os.PathLike[str], config: LightFieldConfig) -> Asset:
    """Asset of a photometric file or ray file.

    Args:
        path: file with one of `lamp.source.PHOTOMETRIC_SUFFIXES`.
        config: grid of a ray file's light field. That of a photometric file has 64² or 128² bins of
            direction, by how steep its intensities are, and as many cells as its opening needs.

    Raises:
        LumitreeError: the file cannot be read, or emits nothing.
    """
    if Path(path).suffix.lower() in (".ies", ".ldt"):
        read = read_ies if Path(path).suffix.lower() == ".ies" else read_ldt
        return bake_distribution(read(path))
    return bake_rays(*read_tm25(path), config)


def bake_distribution(distribution: IntensityDistribution) -> Asset:
    """Asset that emits an intensity distribution from its luminous opening, with R = G = B."""
    opening = distribution.opening
    if max(opening.sides) < _MIN_EXTENT:
        opening = Opening((POINT_SIZE, POINT_SIZE, POINT_SIZE))
    sides = np.array(opening.sides)
    frame = LocalFrame.of_box(-sides / 2, sides / 2)
    candela = _bin_means(distribution)
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
    intensity = np.broadcast_to((shares * watts)[..., None], (len(cells), len(watts), 3))
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
        self._side, self._half = 1 << depth, frame.half_extents
        points, self._areas = opening.surface()
        self._points = points / frame.scale / self._half
        edges = np.linspace(-1, 1, self._side + 1)
        # Of each axis the cells that are in the box, and the middle of what is inside.
        inside = [np.clip(edges, -half, half) for half in self._half]
        self._cells = [np.flatnonzero(np.diff(each) > 0) for each in inside]
        self._middles = [(each[1:] + each[:-1])[np.diff(each) > 0] / 2 for each in inside]

    def flux(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative flux [side³, B] of each cell in directions [B, 3].

        Each start is divided between the eight cells around it, so that their mean place is its
        own.
        """
        along = directions / self._half
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        # In the cube [-1, 1]³: the point of the ray next to the centre, if that is inside.
        safe = np.where(along == 0, 1e-9, along)[:, None]
        to_face = ((self._points + np.copysign(1, safe)) / safe).min(axis=2)
        back = np.clip(along @ self._points.T, 0, to_face)
        start = (self._points - back[..., None] * along[:, None]) * self._half
        projected = np.maximum(directions @ self._areas.T, 0)
        size = self._side**3
        total = np.zeros(size * len(along))
        ends = [self._neighbours(start[..., axis], axis) for axis in range(3)]
        for x, y, z in itertools.product(*ends):
            code = (x[0] * self._side + y[0]) * self._side + z[0]
            code += size * np.arange(len(along))[:, None]
            weight = projected * x[1] * y[1] * z[1]
            total += np.bincount(code.ravel(), weight.ravel(), len(total))
        return total.reshape(len(along), size).T

    def _neighbours(
        self, place: NDArray[np.float64], axis: int
    ) -> list[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """The two cells whose middles are next to a coordinate, and their weights."""
        cells, middles = self._cells[axis], self._middles[axis]
        at = np.interp(place, middles, np.arange(len(cells)))
        lower = np.minimum(at.astype(np.int64), max(len(cells) - 2, 0))
        upper = np.minimum(lower + 1, len(cells) - 1)
        return [(cells[lower], 1 - (at - lower)), (cells[upper], at - lower)]


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


def _bin_means(distribution: IntensityDistribution) -> NDArray[np.float64]:
    """Mean intensity [R²], cd, of each octahedral bin; R is 64, or 128 for steep intensities."""
    fine = _means(distribution, MAX_RESOLUTION)
    half = MAX_RESOLUTION // 2
    coarse = _means(distribution, half)
    repeated = np.kron(coarse.reshape(half, half), np.ones((2, 2))).ravel()
    error = np.sqrt(np.mean((fine - repeated) ** 2) / max(np.mean(fine**2), 1e-300))
    return coarse if error < _COARSE_ERROR else fine


def _means(distribution: IntensityDistribution, resolution: int) -> NDArray[np.float64]:
    points = (np.indices((_FINE, _FINE)).reshape(2, -1).T + 0.5) / _FINE
    bins = on_device(mi.UInt32, np.repeat(np.arange(resolution**2), len(points)))
    sample = on_device(mi.Point2f, np.tile(points, (resolution**2, 1)))
    direction, density = direction_in_bin(bins, sample, resolution)
    weight = 1 / np.array(density, np.float64)
    value = distribution.at(np.array(direction, np.float64).reshape(3, -1).T)
    parts = (each.reshape(-1, len(points)).sum(axis=1) for each in (weight * value, weight))
    return np.divide(*parts)
