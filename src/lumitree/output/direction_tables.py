"""Intensities of point lights as equirectangular tables of directions, as Cycles reads them.

Symbols
    R, S        bins of direction a side, point lights, as in `output.point_lights`
    H           rows of a table
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lumitree.core.octahedral import bilinear_bins
from lumitree.output.point_lights import PointLights

# Directions in a texel of a table, a side, that its value is the mean of.
_SUPERSAMPLED = 4
# Directions whose bins are found at once, which bounds memory.
_DIRECTIONS = 1 << 19


def table_directions(height: int) -> NDArray[np.float64]:
    """Unit directions [H, 2H, 3] of the texels of an equirectangular table, as Cycles has it.

    Column 0 is at azimuth π and they turn towards 0 at the middle; row 0 is at -z, the last at +z.
    """
    azimuth = (0.5 - (np.arange(2 * height) + 0.5) / (2 * height)) * 2 * np.pi
    latitude = ((np.arange(height) + 0.5) / height - 0.5) * np.pi
    flat = np.cos(latitude)[:, None]
    upward = np.broadcast_to(np.sin(latitude)[:, None], (height, 2 * height))
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), upward], axis=-1)


def table_angles(height: int) -> NDArray[np.float64]:
    """Weight [H] of the texels of a row in the integral over the sphere, sr.

    Values between the centres of texels are interpolated linearly; beyond those of the first and
    the last row they are constant.
    """
    fine = 64
    rows = (np.arange(height * fine) + 0.5) / fine - 0.5
    area = np.cos(((rows + 0.5) / height - 0.5) * np.pi) * (np.pi / (height * fine))
    rows = rows.clip(0, height - 1)
    first = np.minimum(rows.astype(np.int64), height - 2) if height > 1 else rows.astype(np.int64)
    weight = np.bincount(first, area * (1 - (rows - first)), height)
    weight += np.bincount(np.minimum(first + 1, height - 1), area * (rows - first), height)
    weight *= 2 / weight.sum()
    return weight * (np.pi / height)


def direction_tables(
    lights: PointLights, local_from_table: NDArray[np.float64], height: int
) -> NDArray[np.float64]:
    """Intensities [S, H, 2H, 3] of lights by direction, between which Cycles is linear.

    Each table has the flux of its light, channel by channel. `local_from_table` [3, 3] is the
    rotation from the frame of the table.
    """
    fine = table_directions(height * _SUPERSAMPLED)
    rows = max(1, _DIRECTIONS // (fine.shape[1] * _SUPERSAMPLED))
    intensity = lights.intensity.transpose(1, 0, 2).reshape(lights.resolution**2, -1)
    texels = [
        _texel_weights(part @ local_from_table.T, lights.resolution) @ intensity
        for part in np.split(fine, np.arange(rows, height, rows) * _SUPERSAMPLED)
    ]
    tables = np.concatenate(texels).reshape(height, 2 * height, len(lights.position), 3)
    tables = np.moveaxis(tables, 2, 0)
    have = np.einsum("shwc,h->sc", tables, table_angles(height))
    want = lights.flux
    factor = np.divide(want, have, out=np.zeros_like(want), where=have > 0)
    return tables * factor[:, None, None, :]


def _texel_weights(fine: NDArray[np.float64], resolution: int) -> csr_array:
    """Matrix [texels, R²] of mean intensities, from the directions [h, w, 3] in them."""
    height, width = (length // _SUPERSAMPLED for length in fine.shape[:2])
    share = np.hypot(fine[..., 0], fine[..., 1])
    blocks = share.reshape(height, _SUPERSAMPLED, width, _SUPERSAMPLED)
    share = (blocks / blocks.sum(axis=(1, 3), keepdims=True)).reshape(-1, 1)
    bins, parts = bilinear_bins(fine.reshape(-1, 3), resolution)
    row, column = np.divmod(np.arange(len(bins)), fine.shape[1])
    texel = row // _SUPERSAMPLED * width + column // _SUPERSAMPLED
    entries = (share * parts).ravel(), (np.repeat(texel, bins.shape[1]), bins.ravel())
    return csr_array(entries, shape=(height * width, resolution**2))
