"""A light field as a few point lights, each with an intensity by direction.

The cells are divided into clusters by k-means, weighted by flux. A light stands at the centroid of
its cluster and has the sum of its cells' intensities. This is the illumination of
Velázquez-Armendáriz et al. 2015.

Symbols
    C, R, B     cells, bins of direction a side, bins that emit, as in `asset.light_field`
    S           point lights
    H           rows of a table by direction
"""

import dataclasses
import warnings

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import LightField, unpack
from lumitree.core.device import on_device
from lumitree.core.octahedral import bin_of, octahedral, solid_angles
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.octree.leaves import boxes_inside

# Points that k-means clusters: its time is linear in them.
_CLUSTERED = 1 << 16
_ROUNDS = 20
# Directions in a texel of a table, a side, that its value is the mean of.
_SUPERSAMPLED = 4


@dataclasses.dataclass(frozen=True, eq=False)
class PointLights:
    """Point lights in the local frame.

    Attributes:
        position: [S, 3], inside the luminaire's box.
        intensity: [S, R², 3] radiant intensity by octahedral bin, local units.
    """

    position: NDArray[np.float64]
    intensity: NDArray[np.float64]

    @property
    def resolution(self) -> int:
        """Bins of direction a side, R."""
        return round(self.intensity.shape[1] ** 0.5)

    @property
    def flux(self) -> NDArray[np.float64]:
        """Flux [S, 3] of each light, R, G and B, local units."""
        return np.einsum("sbc,b->sc", self.intensity, solid_angles(self.resolution))


def cluster_points(
    points: NDArray[np.floating], count: int, random: np.random.Generator
) -> NDArray[np.float64]:
    """Centres [S, 3] of at most `count` clusters of points [N, 3], by k-means.

    Clusters that remain empty are left out.
    """
    from scipy.cluster.vq import kmeans2

    with warnings.catch_warnings():
        # "One of the clusters is empty": it is left out below.
        warnings.simplefilter("ignore", UserWarning)
        centres, index = kmeans2(
            points.astype(np.float64), count, _ROUNDS, minit="++", missing="warn", rng=random
        )
    return centres[np.unique(index)]


def cluster_lights(
    field: LightField, half_extents: NDArray[np.float64], count: int, seed: int = 0
) -> PointLights:
    """Point lights with the flux of a field, channel by channel.

    Args:
        half_extents: [3] of the luminaire's box; light starts inside it.
        count: largest number of lights.
        seed: root seed.
    """
    cell, row = np.nonzero(np.unpackbits(field.lit, axis=1))
    bins = field.resolution**2
    intensity = unpack(field.intensity) * field.scale
    power = _sums(cell, intensity.sum(axis=1) * solid_angles(field.resolution)[row])
    levels = np.full(len(field.cells), field.depth)
    lower, upper = boxes_inside(half_extents, field.cells.astype(np.int64), levels)
    # A cell that is outside the box belongs to the nearest of its points.
    points = np.clip((lower + upper) / 2, -half_extents, half_extents)
    index = _clusters(points, power, count, seed)
    lights = int(index.max()) + 1
    weight = _sums(index, power)
    centre = [_sums(index, power * each) / weight for each in points.T]
    place = index[cell] * bins + row
    sums = [_sums(place, each, lights * bins) for each in intensity.T]
    return PointLights(np.stack(centre, axis=-1), np.stack(sums, axis=-1).reshape(lights, bins, 3))


def _sums(
    index: NDArray[np.integer], values: NDArray[np.float64], count: int = 0
) -> NDArray[np.float64]:
    """Sums of values by index, for at least `count` indices."""
    return np.bincount(index, values, count).astype(np.float64)


def _clusters(
    points: NDArray[np.float64], power: NDArray[np.float64], count: int, seed: int
) -> NDArray[np.int64]:
    """Cluster [C] of each point, by power."""
    from scipy.spatial import KDTree

    if count >= len(points):
        return np.arange(len(points))
    # k-means of SciPy has no weights: points are repeated in proportion to their power.
    ends = np.cumsum(power) / power.sum()
    times = np.diff(np.round(ends * _CLUSTERED).astype(np.int64), prepend=0)
    random = np.random.default_rng(SeedStream(Purpose.EXPORT).seed(seed))
    centres = cluster_points(np.repeat(points, times, axis=0), count, random)
    nearest = KDTree(centres).query(points)[1]
    return np.unique(nearest, return_inverse=True)[1]


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


def linear_bins(
    directions: NDArray[np.float64], resolution: int
) -> list[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """The four bins between whose middles a direction is: index [N] and weight [N] of each.

    As a light field has it, whose intensity is linear between the middles of bins.

    Args:
        directions: [N, 3] in the local frame.
        resolution: bins of direction a side.
    """
    local = on_device(mi.Vector3f, directions.astype(np.float32))
    # From the middle of a bin, in bins.
    place = (np.array(octahedral(local), np.float64) + 1) * (resolution / 2) + 0.5
    along = place - np.floor(place)
    bins = []
    for x, y in ((0, 0), (0, 1), (1, 0), (1, 1)):
        index = bin_of(local, resolution, mi.Vector2f(x - 0.5, y - 0.5))
        weight = (along[0] if x else 1 - along[0]) * (along[1] if y else 1 - along[1])
        bins.append((np.array(index).astype(np.int64), weight))
    return bins


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
    bins = linear_bins(fine.reshape(-1, 3) @ local_from_table.T, lights.resolution)
    blocks = (height, _SUPERSAMPLED, 2 * height, _SUPERSAMPLED)
    share = weight.reshape(blocks)
    share = share / share.sum(axis=(1, 3), keepdims=True)
    tables = np.empty((len(lights.position), height, 2 * height, 3))
    for table, intensity in zip(tables, lights.intensity, strict=True):
        for channel in range(3):
            values = sum(intensity[:, channel][index] * part for index, part in bins)
            table[..., channel] = (np.reshape(values, blocks) * share).sum(axis=(1, 3))
    have = np.einsum("shwc,h->sc", tables, table_angles(height))
    want = lights.flux
    factor = np.divide(want, have, out=np.zeros_like(want), where=have > 0)
    return tables * factor[:, None, None, :]
