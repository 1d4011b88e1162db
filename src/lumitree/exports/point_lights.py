"""A light field as a few point lights, each with an intensity by direction.

The cells are divided into clusters by k-means, weighted by flux. A light stands at the centroid of
its cluster and has the sum of its cells' intensities. This is the illumination of
Velázquez-Armendáriz et al. 2015.

Symbols
    C, R, B     cells, bins of direction a side, bins that emit, as in `asset.light_field`
    S           point lights
"""

import dataclasses
import warnings
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.light_field import LightField, unpack
from lumitree.core.octahedral import solid_angles
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError
from lumitree.octree.build import boxes_inside

# The axis that points up.
Up = Literal["y", "z"]
_Z_FROM_Y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
# Points that k-means clusters: its time is linear in them.
_CLUSTERED = 1 << 16
_ROUNDS = 20


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


@dataclasses.dataclass(frozen=True, eq=False)
class PlacedLights:
    """Point lights of an asset in the frame of another program, with lengths in metres.

    Attributes:
        position: [S, 3], m.
        local: the lights in the local frame, with the asset's factors.
        rotation: [3, 3], from the local frame to the program's.
        scale: metres in a local unit of length.
    """

    position: NDArray[np.float64]
    local: PointLights
    rotation: NDArray[np.float64]
    scale: float

    @property
    def watts(self) -> NDArray[np.float64]:
        """Flux [S, 3] of each light in W, R, G and B."""
        return self.local.flux * self.scale**2


def turn_up(given: Up, wanted: Up) -> NDArray[np.float64]:
    """Rotation [3, 3] from a frame with one axis up to a frame with another; x stays."""
    if given == wanted:
        return np.eye(3)
    return _Z_FROM_Y if wanted == "z" else _Z_FROM_Y.T


def place_lights(
    asset: Asset, turn: NDArray[np.float64], count: int, seed: int = 0
) -> PlacedLights:
    """At most `count` point lights of an asset.

    `turn` [3, 3] is the rotation from the frame of the luminaire's file to the program's.

    Raises:
        LumitreeError: the asset has no light field, or its light factors make it black.
    """
    if asset.light_field is None:
        raise LumitreeError(
            f"the asset of {asset.luminaire} has no light field, from which the lights are "
            "made; bake its luminaire with the part light, which a dataset does not give"
        )
    frame = asset.frame
    lights = cluster_lights(asset.light_field, frame.half_extents, count, seed)
    intensity = lights.intensity * asset.light_factors
    # A factor of 0 for a channel may make lights black.
    lit = intensity.any(axis=(1, 2))
    if not lit.any():
        raise LumitreeError(
            f"the asset of {asset.luminaire} sends no light, because its light factors "
            f"are {asset.light_factors}; save it with factors above 0"
        )
    lights = PointLights(lights.position[lit], intensity[lit])
    rotation = turn @ frame.rotation
    position = lights.position @ rotation.T * frame.scale + frame.centre @ turn.T
    return PlacedLights(position, lights, rotation, float(frame.scale))


def cluster_points(
    points: NDArray[np.floating], count: int, random: np.random.Generator
) -> NDArray[np.float64]:
    """Centres [S, 3] of at most `count` clusters of points [N, 3], by k-means.

    Clusters that remain empty are dropped.
    """
    from scipy.cluster.vq import kmeans2

    points = points.astype(np.float64)
    seeds = _seeds(points, count, random)
    with warnings.catch_warnings():
        # "One of the clusters is empty": it is dropped below.
        warnings.simplefilter("ignore", UserWarning)
        centres, index = kmeans2(points, seeds, _ROUNDS, minit="matrix", missing="warn")
    return centres[np.unique(index)]


def _seeds(
    points: NDArray[np.float64], count: int, random: np.random.Generator
) -> NDArray[np.float64]:
    """Points [S, 3] at which k-means begins, by k-means++ (Arthur and Vassilvitskii 2007).

    `kmeans2` of SciPy chooses the same, in time that grows with the square of `count`. There are
    fewer than `count` if there are fewer different points.
    """
    from scipy.spatial.distance import cdist

    chosen = [int(random.integers(len(points)))]
    nearest = np.full(len(points), np.inf)
    while len(chosen) < count:
        nearest = np.minimum(nearest, cdist(points[chosen[-1:]], points, "sqeuclidean")[0])
        total = nearest.sum()
        if not total:
            break
        cdf = np.cumsum(nearest / total)
        # Rounding may leave the last value below 1.
        chosen.append(min(int(np.searchsorted(cdf, random.uniform())), len(points) - 1))
    return points[chosen]


def cluster_lights(
    field: LightField, half_extents: NDArray[np.float64], count: int, seed: int = 0
) -> PointLights:
    """At most `count` point lights with the flux of a field, channel by channel.

    They are inside the luminaire's box of half extents [3].
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
    cdf = np.cumsum(power) / power.sum()
    times = np.diff(np.round(cdf * _CLUSTERED).astype(np.int64), prepend=0)
    random = np.random.default_rng(SeedStream(Purpose.EXPORT).seed(seed))
    centres = cluster_points(np.repeat(points, times, axis=0), count, random)
    nearest = KDTree(centres).query(points)[1]
    return np.unique(nearest, return_inverse=True)[1]
