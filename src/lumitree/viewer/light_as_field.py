"""A field that shows the light field of an asset, for the page.

Without a field, images show the light field: the radiance along a ray is the sum over its
cells of I(ω) · length / V. The same is the emission of leaves of low density under the linear law,
whose weights are density times length: Φ = I(ω) / (V · density). They emit, and hide almost
nothing.

Symbols
    I   radiant intensity of a cell     V   volume of the part of a cell inside the lamp's box
    B   bins of direction               K   coefficients of the spherical harmonics
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.light_field import LightField, unpack
from lumitree.core.harmonics import MAX_L, Y_00, basis_array
from lumitree.core.octahedral import middle_directions, solid_angles
from lumitree.octree.build import boxes_inside, build_children, grid_boxes_inside

# Density of all leaves, per local unit. The longest ray, of 2 √3, loses 5 % of what is behind it.
DENSITY = 2.0**-6
# L_max is this factor above the largest emission, which the sigmoid then does not limit.
_HEADROOM = 2.0
# Depth of the grid that shows a round opening, and its cells, at most.
_FINEST, _MAX_CELLS = 7, 1 << 15
_OCTANTS = np.indices((2, 2, 2)).reshape(3, -1).T
# Bins a side that the harmonics are fitted to; they are smoother than more bins.
_RESOLUTION = 16
# Rows that are fitted at once, and steps of the fit.
_AT_ONCE, _STEPS = 1024, 8
# Yaw and pitch of a view, rad; and the length of the mean direction of light to one side.
DEFAULT_VIEW, _ONE_SIDED = (0.6, 0.2), 0.1
# Range of the first estimate, relative to the largest emission of a cell; and of the coefficients.
_DARK, _LARGEST = 1e-3, 100.0


def light_as_field(asset: Asset) -> Asset:
    """The asset with a field that is made of its light field, in place of another one.

    The emission is fitted by spherical harmonics up to l = 4, and each cell keeps its flux. Beams
    of less than about 20 degrees become as wide as that.

    Raises:
        LumitreeError: the emission is out of the range of assets.
    """
    light = asset.light_field
    assert light is not None
    cells, depth = light.cells.astype(np.int64), light.depth
    emission, rows_of = _by_bin(light), np.arange(len(cells))
    volume = _volumes(asset, cells, depth)
    if light.outline not in (None, "box"):
        # Cells within the luminous opening, which share all light.
        cells, depth = _opening_cells(asset, light)
        emission, rows_of = emission.sum(axis=0, keepdims=True), np.zeros(len(cells), np.int64)
        volume = _volumes(asset, cells, depth).sum(keepdims=True)
    emission = emission / (volume * DENSITY)[:, None, None]
    max_radiance = _HEADROOM * float(emission.max())
    directions, solid_angle = middle_directions(_RESOLUTION), solid_angles(_RESOLUTION)
    # The squared error of the radiance of all rays: of intensity over projected area.
    areas = asset.frame.half_extents.prod() / asset.frame.half_extents
    fit = _Fit(basis_array(directions, MAX_L), solid_angle / (np.abs(directions) @ areas))
    rows = emission.transpose(0, 2, 1).reshape(-1, _RESOLUTION**2) / max_radiance
    fitted = []
    for first in range(0, len(rows), _AT_ONCE):
        part = rows[first : first + _AT_ONCE]
        fitted.append(fit.with_flux(fit.coefficients(part), part @ solid_angle, solid_angle))
    coefficients = np.concatenate(fitted).reshape(len(emission), 3, -1).astype(np.float16)
    return dataclasses.replace(
        asset,
        children=build_children(cells, np.full(len(cells), depth)),
        density=np.full(len(cells), DENSITY, np.float32),
        coefficients=coefficients[rows_of],
        tree_depth=depth,
        l_max=MAX_L,
        law="linear",
        max_radiance=max_radiance,
    )


def _volumes(asset: Asset, cells: NDArray[np.int64], depth: int) -> NDArray[np.float64]:
    lower, upper = grid_boxes_inside(asset.frame.half_extents, cells, depth)
    return (upper - lower).prod(axis=1)


def _opening_cells(asset: Asset, light: LightField) -> tuple[NDArray[np.int64], int]:
    """Cells [C, 3] of a fine grid whose middles are in a round opening, and the grid's depth."""
    half, axis = asset.frame.half_extents, "xyz".find(str(light.outline)[-1])
    across = [each for each in range(3) if each != axis]
    found, grid, depth = light.cells.astype(np.int64), light.cells.astype(np.int64), light.depth
    while depth < _FINEST:
        grid = (2 * grid[:, None] + _OCTANTS).reshape(-1, 3)
        lower, upper = boxes_inside(half, grid, np.full(len(grid), depth + 1))
        filled = (upper > lower).all(axis=1)
        grid, middle = grid[filled], (lower + upper)[filled] / 2
        finer = grid[np.square(middle / half)[:, across].sum(axis=1) <= 1]
        if len(finer) > _MAX_CELLS:
            break
        found, depth = finer, depth + 1
    return found, depth


def brightest_view(asset: Asset) -> tuple[float, float]:
    """Yaw and pitch, rad, of a camera that most of the light of an asset goes to, y up.

    At most one radian above or below the horizontal; a little above it for light to all sides.
    """
    light = asset.light_field
    assert light is not None
    flux = _by_bin(light).sum(axis=(0, 2))
    flux *= solid_angles(_RESOLUTION)
    x, y, z = flux @ middle_directions(_RESOLUTION) / flux.sum()
    yaw, pitch = DEFAULT_VIEW
    if (aside := float(np.hypot(x, z))) > _ONE_SIDED:
        yaw = float(np.arctan2(x, z))
    if np.hypot(aside, y) > _ONE_SIDED:
        pitch = float(np.clip(np.arctan2(y, aside), -1, 1))
    return yaw, pitch


def _by_bin(light: LightField) -> NDArray[np.float64]:
    """Mean intensity [C, B, 3] of bins, `_RESOLUTION` a side."""
    given = light.resolution
    # Larger bins are divided.
    fine = max(given, _RESOLUTION)
    shape = _RESOLUTION, fine // _RESOLUTION, _RESOLUTION, fine // _RESOLUTION
    weight = solid_angles(fine).reshape(shape)
    weight = weight / weight.sum(axis=(1, 3), keepdims=True)
    colours = unpack(light.intensity) * light.scale
    means = []
    for channel in range(3):
        dense = light.dense(colours[:, channel]).reshape(-1, given, given)
        dense = dense.repeat(fine // given, axis=1).repeat(fine // given, axis=2)
        means.append(np.einsum("ciajb,iajb->cij", dense.reshape(-1, *shape), weight))
    return np.stack(means, axis=-1).reshape(len(light.cells), -1, 3)


class _Fit:
    """Least squares of sigmoid(c · Y) - wanted over directions, for many rows at once.

    By the method of Levenberg and Marquardt, with a damping for each row. The basis Y has
    the values [B, K].
    """

    def __init__(self, values: NDArray[np.float64], weight: NDArray[np.float64]) -> None:
        self._values, self._weight = values, weight
        self._upper = np.triu_indices(values.shape[1])
        self._products = values[:, self._upper[0]] * values[:, self._upper[1]]

    def coefficients(self, wanted: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coefficients c [N, K] for rows [N, B] of 0 to 1 / `_HEADROOM`."""
        # Rows that are 0 get an emission of about 1e-20.
        start = np.maximum(wanted, np.maximum(wanted.max(axis=1, keepdims=True) * _DARK, 1e-20))
        logit = np.log(start / (1 - start))
        found = np.linalg.lstsq(self._values, logit.T, rcond=None)[0].T.astype(np.float64)
        damping, error = np.full(len(wanted), 1e-2), self._error(found, wanted)
        for _ in range(_STEPS):
            step = self._step(found, wanted, damping)
            tried = np.clip(found + step, -_LARGEST, _LARGEST)
            tried_error = self._error(tried, wanted)
            better = tried_error < error
            found[better], error[better] = tried[better], tried_error[better]
            damping = np.where(better, damping / 4, damping * 8)
        return found

    def with_flux(
        self,
        found: NDArray[np.float64],
        flux: NDArray[np.float64],
        solid_angle: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """The coefficients with another constant, so that the rows have a flux [N]."""
        for _ in range(3):
            ratio = np.maximum(flux, 1e-20) / (_sigmoid(found @ self._values.T) @ solid_angle)
            found[:, 0] += np.log(ratio) / Y_00
        return np.clip(found, -10 * _LARGEST, 10 * _LARGEST)

    def _step(self, found, wanted, damping):
        shown = _sigmoid(found @ self._values.T)
        slope = shown * (1 - shown)
        count = self._values.shape[1]
        matrix = np.zeros((len(found), count, count))
        rows, columns = self._upper
        matrix[:, rows, columns] = (self._weight * slope**2) @ self._products
        matrix[:, columns, rows] = matrix[:, rows, columns]
        diagonal = np.einsum("nkk->nk", matrix)
        diagonal *= 1 + damping[:, None]
        # Rows that are 0 have a matrix of 0.
        diagonal += 1e-6 * diagonal.mean(axis=1, keepdims=True) + 1e-300
        gradient = (self._weight * slope * (wanted - shown)) @ self._values
        return np.linalg.solve(matrix, gradient[..., None])[..., 0]

    def _error(self, found, wanted):
        return (_sigmoid(found @ self._values.T) - wanted) ** 2 @ self._weight


def _sigmoid(logit: NDArray[np.float64]) -> NDArray[np.float64]:
    return 1 / (1 + np.exp(-np.clip(logit, -80, 80)))
