"""Lamps, bins, and means with their standard errors, for tests of traced rays."""

import numpy as np

from lumitree.core.seeds import Purpose, SeedStream
from support.lamps import AREA, GLASS, cube, sphere

TILE = 16
DIFFUSE = '<bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>'
MIRROR = '<bsdf type="conductor"><string name="material" value="none"/></bsdf>'
CLUTTER = (
    sphere("lamp", 0.5, (0, 0, 0), AREA),
    sphere("shade", 0.4, (1, 0.3, 0), DIFFUSE),
    sphere("metal", 0.3, (-0.9, 0, 0.2), MIRROR),
    sphere("glass", 0.35, (0, 0.9, 0.1), GLASS),
)


def fog(sigma, albedo=0.0):
    return (
        '<bsdf type="null"/><medium type="homogeneous" name="interior">'
        f'<float name="sigma_t" value="{sigma}"/><float name="albedo" value="{albedo}"/></medium>'
    )


def arrays(*values):
    """Vectors of N elements as float64 arrays [N, ...]."""
    return [np.array(value, np.float64).T for value in values]


def source(luminaire, spacing=1 / 64, seed=0):
    """Random rays of a luminaire."""
    from lumitree.fit.octree.rays import TracedRays

    return TracedRays(luminaire, spacing, seed=seed)


def stream(step):
    """Random numbers of a step."""
    return SeedStream(Purpose.REFINEMENT, step)


def tile_mean(values):
    """Mean of the values [N, ...] of rays and its standard error, as if tiles were independent.

    They are spread more evenly than that, so that the true error is smaller.
    """
    tiles = values.reshape(-1, TILE, *values.shape[1:]).mean(axis=1)
    return tiles.mean(axis=0), tiles.std(axis=0, ddof=1) / np.sqrt(len(tiles))


def binned_sum(values, bins, num_bins, group=1):
    """Sums [B, 3] of values [N, 3] by bin [N], and their standard errors.

    Args:
        values: N / `group` independent groups of neighbours.
        bins: integers below `num_bins`; negative ones are left out.
    """
    groups = -(-len(values) // group)
    counted = bins >= 0
    index = (np.arange(len(values)) // group)[counted] * num_bins + bins[counted]
    sums, squares = np.zeros((num_bins, 3)), np.zeros((num_bins, 3))
    for channel in range(3):
        cells, inverse = np.unique(index, return_inverse=True)
        each = np.bincount(inverse, values[counted, channel], minlength=len(cells))
        sums[:, channel] = np.bincount(cells % num_bins, each, minlength=num_bins)
        squares[:, channel] = np.bincount(cells % num_bins, each**2, minlength=num_bins)
    variance = (squares - sums**2 / groups) * groups / (groups - 1)
    return sums, np.sqrt(np.maximum(variance, 0))


def octant(directions):
    """Which of the eight octants directions [N, 3] point into."""
    return (directions > 0) @ [1, 2, 4]


def cell_of(points, level=2):
    """Index of the cell of 2^level a side that holds points [N, 3] of [-1, 1]³."""
    side = 1 << level
    cells = np.clip(np.floor((points + 1) * (side / 2)), 0, side - 1).astype(int)
    return cells @ [side * side, side, 1]


def everywhere(origin, direction):
    """All rays are wanted."""
    return direction.z < 2


def distance_to(origins, directions, centre):
    """Distances [N] of a point from rays, extended backwards."""
    offset = origins - centre
    along = (offset * directions).sum(axis=1, keepdims=True)
    return np.linalg.norm(offset - along * directions, axis=1)


def fresnel(cosine, ior):
    """Reflectance of unpolarised light at a smooth dielectric."""
    inner = np.sqrt(1 - (1 - cosine**2) / ior**2)
    s = (cosine - ior * inner) / (cosine + ior * inner)
    p = (ior * cosine - inner) / (ior * cosine + inner)
    return (s**2 + p**2) / 2


def pane(kind, z):
    """A pane of glass across the box at height z: infinitely thin, or a slab."""
    if kind == "thin":
        return (
            '<shape type="rectangle" id="pane"><transform name="to_world">'
            f'<translate z="{z}"/></transform><bsdf type="thindielectric">'
            '<float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/></bsdf></shape>'
        )
    glass = (
        '<bsdf type="dielectric"><float name="int_ior" value="1.5"/>'
        '<float name="ext_ior" value="1"/></bsdf>'
    )
    return cube("pane", (1, 1, 0.02), (0, 0, z), glass)
