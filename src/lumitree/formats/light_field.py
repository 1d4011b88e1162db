"""Assets with a light field only, of intensities with a luminous opening, and of rays.

A photometric file states the far field, and the luminous opening that the light comes from. Its
asset emits the intensity of a direction ω evenly over the opening's projection along ω, to which a
surface element of area dA and normal n adds max(n·ω, 0) dA. A file without an opening gets a cube
of 1 cm.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Protocol

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset, EmittedSpectrum, light_field_asset
from lumitree.asset.light_field import make_light_field
from lumitree.core.device import on_device
from lumitree.core.frames import LocalFrame
from lumitree.core.octahedral import (
    bordered,
    intensity_of_histogram,
    middle_directions,
    parts_of_bins,
    solid_angles,
)
from lumitree.core.photometry import LUMENS_PER_WATT, RGB
from lumitree.errors import LumitreeError
from lumitree.formats.opening import Opening
from lumitree.formats.tm25 import Rays
from lumitree.formats.type_c import IntensityDistribution
from lumitree.lamp.materials import WHITE
from lumitree.trace.histograms import Histogram
from lumitree.trace.light_field_config import LEAST_DEPTH, LightFieldConfig

Array = NDArray[np.float64]
Codes = NDArray[np.int64]
Widths = tuple[float | None, float | None, float | None]
# Side of the box of a source without extent, m; and the shortest side, as a part of the longest.
POINT_SIZE = 0.01
_MIN_EXTENT = 1e-6
# Bins of direction a side of an asset of a photometric file: for any opening, and for flat ones.
RESOLUTIONS, _FLAT_RESOLUTIONS = (64, 128), (64, 128, 256, 512)
# Number of its bins, cells times bins of direction; 4 bytes each.
MAX_BINS = 1 << 22
_MAX_DEPTH, _DISK_DEPTH = 3, 3
# Bins of direction a side in which the light starts in the same cells, and how many at once.
_COARSE, _BINS_AT_ONCE = 32, 32
# Error between the middles of bins, over the largest intensity, at which there are enough.
_BIN_ERROR = 0.0025
# Weights of the quarters of bins around a bin, along each side; and steps of the fit to them.
_QUARTERS, _FIT_STEPS = (0.25, 0.75, 0.75, 0.25), 2


class StartCells:
    """The cells of a grid of 2**depth cells a side that are in a lamp's box.

    The box cuts its outer cells: `middles` has for each axis the middles of the parts inside,
    ascending, in local units.
    """

    def __init__(self, frame: LocalFrame, depth: int) -> None:
        self.side = 1 << depth
        edges = np.linspace(-1, 1, self.side + 1)
        inside = [np.clip(edges, -half, half) for half in frame.half_extents]
        self._edges = inside
        self._cells = [np.flatnonzero(np.diff(each) > 0) for each in inside]
        self.middles = [(each[1:] + each[:-1])[np.diff(each) > 0] / 2 for each in inside]

    def around(
        self, start: Array, widths: Widths = (None, None, None)
    ) -> Iterator[tuple[Codes, Array]]:
        """Index [...] (x slowest) of each of the eight cells around a start, and its share of it.

        Starts [..., 3] and widths are in local units. Along each axis a start extends over a width,
        at most the width of a cell, and each cell gets the part inside it. With None, the cells are
        weighted so that their mean position is the start.
        """
        axes = [
            self._neighbours(start[..., axis], axis)
            if width is None
            else self._overlapped(start[..., axis], axis, width)
            for axis, width in enumerate(widths)
        ]
        for x, y, z in itertools.product(*axes):
            yield (x[0] * self.side + y[0]) * self.side + z[0], x[1] * y[1] * z[1]

    def coordinates(self, codes: Codes) -> Codes:
        """Coordinates [C, 3] of cells by their indices [C]."""
        return np.stack(np.unravel_index(codes, (self.side,) * 3), axis=1)

    def _overlapped(self, position: Array, axis: int, width: float) -> list[tuple[Codes, Array]]:
        """The two cells that an interval around a coordinate may be in, and its parts there."""
        cells, edges = self._cells[axis], self._edges[axis]
        first = np.clip(position - width / 2, edges[0], edges[-1])
        lower = np.clip(np.searchsorted(edges, first, "right") - 1, cells[0], cells[-1])
        upper = np.minimum(lower + 1, cells[-1])
        part = np.clip((position + width / 2 - edges[lower + 1]) / width, 0, 1)
        return [(lower, 1 - part), (upper, part)]

    def _neighbours(self, position: Array, axis: int) -> list[tuple[Codes, Array]]:
        """The two cells whose middles are next to a coordinate, and their weights."""
        cells, middles = self._cells[axis], self.middles[axis]
        at = np.interp(position, middles, np.arange(len(cells)))
        lower = np.minimum(at.astype(np.int64), max(len(cells) - 2, 0))
        upper = np.minimum(lower + 1, len(cells) - 1)
        return [(cells[lower], 1 - (at - lower)), (cells[upper], at - lower)]


def bake_distribution(distribution: IntensityDistribution, colour: RGB = WHITE) -> Asset:
    """Asset that emits a distribution from its opening, in linear RGB `colour` of luminance 1."""
    outline, frame = distribution.opening.outline, opening_frame(distribution.opening)
    opening = _with_extent(distribution.opening)
    if opening.is_flat or opening.sides != distribution.opening.sides:
        depth, cells, area = _flat_shares(opening, frame)
        resolutions = [each for each in _FLAT_RESOLUTIONS if len(cells) * each**2 <= MAX_BINS]
        candela, shares = intensity_by_bin(distribution, resolutions), area[:, None]
    else:
        candela = intensity_by_bin(distribution)
        depth, cells, shares = _projected_shares(opening, frame, math.isqrt(len(candela)))
    watts = candela / LUMENS_PER_WATT / frame.scale**2
    intensity = (shares * watts)[..., None] * np.array(colour)
    field = make_light_field(cells, intensity, depth, absolute=True, outline=outline)
    return light_field_asset(field, frame, distribution.name)


def opening_frame(opening: Opening) -> LocalFrame:
    """Frame of the asset of a photometric file with a luminous opening."""
    half = np.array(_with_extent(opening).sides) / 2
    return LocalFrame.of_box(-half, half)


def _with_extent(opening: Opening) -> Opening:
    """An opening, or a small cube where it has no extent."""
    if max(opening.sides) < _MIN_EXTENT:
        return Opening((POINT_SIZE, POINT_SIZE, POINT_SIZE))
    return opening


def _flat_shares(opening: Opening, frame: LocalFrame) -> tuple[int, Codes, Array]:
    """Depth of a grid, cells [C, 3], and their parts [C] of the opening, for all directions."""
    if opening.shape == "box":
        # Light that is even over the box is exact with cells of any size.
        return 1, np.indices((2, 2, 2)).reshape(3, -1).T, np.full(8, 1 / 8)
    points, areas = opening.surface()
    side = 1 << _DISK_DEPTH
    index = np.floor((points / frame.scale + 1) * (side / 2)).astype(np.int64)
    cells, cell = np.unique(np.clip(index, 0, side - 1), axis=0, return_inverse=True)
    area = np.bincount(cell.ravel(), np.linalg.norm(areas, axis=1))
    return _DISK_DEPTH, cells, area / area.sum()


def _projected_shares(
    opening: Opening, frame: LocalFrame, resolution: int
) -> tuple[int, Codes, Array]:
    """Depth of a grid, cells [C, 3], and the part [C, R²] of the light of each bin that they emit.

    Light that leaves a surface in a direction may start anywhere on the ray behind it. It starts
    at the point of the ray nearest to the centre of the opening: cells then blur it evenly to all
    sides. If it started on the surface, cells would move it inwards. The parts are constant in
    coarser bins than intensities.
    """
    directions = middle_directions(_COARSE)
    depth, flux = _MAX_DEPTH, np.zeros((0, 0))
    while depth > 0:
        starts = _Starts(opening, frame, depth)
        parts = range(0, len(directions), _BINS_AT_ONCE)
        flux = np.concatenate(
            [starts.flux(directions[at : at + _BINS_AT_ONCE]) for at in parts], axis=1
        )
        if np.count_nonzero(flux.any(axis=1)) * resolution**2 <= MAX_BINS:
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

    def flux(self, directions: Array) -> Array:
        """Relative flux [side³, B] of each cell in directions [B, 3]."""
        along = directions / self._half
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        # In the cube [-1, 1]³: the point of the ray nearest to the centre, if it is inside.
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
    """Asset with the histogram of rays by the cell of their start and by direction."""
    lower, upper = rays.origin.min(axis=0), rays.origin.max(axis=0)
    if (upper - lower).max() < _MIN_EXTENT:
        lower, upper = lower - POINT_SIZE / 2, upper + POINT_SIZE / 2
    frame = LocalFrame.of_box(lower, upper)
    origin = (rays.origin - frame.centre) / frame.scale
    depth = LEAST_DEPTH if config.depth is None else config.depth
    histogram = Histogram(depth, config.resolution)
    histogram.add(
        on_device(mi.Point3f, origin), on_device(mi.Vector3f, rays.direction), rays.flux.T
    )
    intensity = intensity_of_histogram(histogram.flux) / frame.scale**2
    field = make_light_field(histogram.cells, intensity, depth, absolute=True)
    spectrum = None if rays.spectrum is None else EmittedSpectrum.of(rays.spectrum)
    return light_field_asset(field, frame, name, spectrum)


class Intensities(Protocol):
    """Luminous intensity by direction."""

    @property
    def name(self) -> str: ...

    @property
    def lumens(self) -> float: ...

    def at(self, direction: Array) -> Array: ...


def intensity_by_bin(source: Intensities, resolutions: Sequence[int] = RESOLUTIONS) -> Array:
    """Intensity [R²], cd, in the middle of each octahedral bin, with the flux of the source.

    Light in other directions is linear between the middles. R is the first of `resolutions` that
    resolves the intensities, or the last.

    Raises:
        LumitreeError: it emits nothing.
    """
    candela = np.zeros((1, 1))
    for resolution in resolutions:
        directions, weight = parts_of_bins(resolution, 2)
        exact = source.at(directions)
        middles = parts_of_bins(resolution, 1)[0]
        candela = _fitted(exact, weight, source.at(middles))
        # Directions, as intensities, are linear between the middles of bins.
        points = middles / np.abs(middles).sum(axis=-1, keepdims=True)
        at_corners = np.abs(_corners(candela) - source.at(_corners(points))).max()
        at_quarters = np.abs(_between(candela) - exact).max()
        if max(at_corners, at_quarters) <= _BIN_ERROR * exact.max():
            break
    total = float(candela.ravel() @ solid_angles(len(candela)))
    if not total > 0:
        raise LumitreeError(f"{source.name} emits nothing; expected intensities above 0")
    return candela.ravel() * (source.lumens / total)


def _fitted(exact: Array, weight: Array, candela: Array) -> Array:
    """Values [R, R] in the middles of bins, between which the error is smaller.

    Where intensities are curved, values in the middles are too far on the outer side of the curve.
    Steps towards least squares lower this. Values stay within those around them, so no edge of a
    beam gets a bright or dark seam. `exact` and `weight` [2R, 2R] are the intensities in the
    middles of the quarters of bins, and their solid angles.
    """
    around = _around(exact)
    low, high = np.min(around, axis=(0, 1)), np.max(around, axis=(0, 1))
    shares = np.multiply.outer(_QUARTERS, _QUARTERS)
    total = np.tensordot(shares, _around(weight))
    for _ in range(_FIT_STEPS):
        error = np.tensordot(shares, _around(weight * (exact - _between(candela))))
        candela = np.clip(candela + error / total, low, high)
    return candela


def _between(candela: Array) -> Array:
    """Values [2R, 2R] in the middles of the quarters of bins, linear between values [R, R]."""
    padded = bordered(candela, 1)
    for _ in range(2):
        below, here, above = padded[:-2], padded[1:-1], padded[2:]
        both = np.stack([0.75 * here + 0.25 * below, 0.75 * here + 0.25 * above], axis=1)
        padded = both.reshape(-1, padded.shape[1]).T
    return padded


def _around(values: Array) -> Array:
    """Values [4, 4, R, R] of the 16 quarters of bins in and next to each bin, of [2R, 2R]."""
    windows = np.lib.stride_tricks.sliding_window_view(bordered(values, 1), (4, 4))
    return windows[::2, ::2].transpose(2, 3, 0, 1)


def _corners(values: Array) -> Array:
    """Values [R + 1, R + 1, ...] in the corners of bins, linear between their middles."""
    rows = bordered(values, 1)
    rows = (rows[:-1] + rows[1:]) / 2
    return (rows[:, :-1] + rows[:, 1:]) / 2
