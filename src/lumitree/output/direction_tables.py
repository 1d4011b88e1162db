"""Intensities of point lights as equirectangular tables of directions, as Cycles reads them.

Symbols
    R, S        bins of direction a side, point lights, as in `output.point_lights`
    H           rows of a table
"""

import numpy as np
from numpy.typing import NDArray

from lumitree.core.octahedral import bilinear_bins
from lumitree.output.point_lights import PointLights

# Directions in a texel of a table, a side, that its value is the mean of.
_SUPERSAMPLED = 4


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

    Each table has the flux of its light, channel by channel.

    Args:
        local_from_table: [3, 3] rotation from the frame of the table.
        height: rows, H.
    """
    fine = table_directions(height * _SUPERSAMPLED)
    weight = np.hypot(fine[..., 0], fine[..., 1])
    bins, parts = bilinear_bins(fine.reshape(-1, 3) @ local_from_table.T, lights.resolution)
    blocks = (height, _SUPERSAMPLED, 2 * height, _SUPERSAMPLED)
    share = weight.reshape(blocks)
    share = share / share.sum(axis=(1, 3), keepdims=True)
    tables = np.empty((len(lights.position), height, 2 * height, 3))
    for table, intensity in zip(tables, lights.intensity, strict=True):
        for channel in range(3):
            values = (intensity[:, channel][bins] * parts).sum(axis=1)
            table[..., channel] = (values.reshape(blocks) * share).sum(axis=(1, 3))
    have = np.einsum("shwc,h->sc", tables, table_angles(height))
    want = lights.flux
    factor = np.divide(want, have, out=np.zeros_like(want), where=have > 0)
    return tables * factor[:, None, None, :]
