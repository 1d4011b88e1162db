"""The first field: density and emission of each leaf from statistics of random rays.

A leaf's density gives it the measured opacity: of the rays that enter it before they terminate, the
share that terminates there. Its emission is the least-squares fit of spherical harmonics to the
radiance of the rays that terminate in it, most of which is brought by light paths.
"""

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device
from lumitree.core.directions import halton_direction
from lumitree.core.harmonics import basis_array, num_coefficients
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.core.transmittance import Law
from lumitree.fit.octree.config import EstimateConfig
from lumitree.fit.octree.growth import octree_of
from lumitree.fit.octree.leaf_statistics import LeafStatistics
from lumitree.fit.octree.traced import TracedRays


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Leaves of one level: cells [M, 3], density [M] per local unit, coefficients [M, 3, K]."""

    cells: NDArray[np.int64]
    density: NDArray[np.float32]
    coefficients: NDArray[np.float32]


def estimate(
    rays: TracedRays,
    cells: NDArray[np.int64],
    level: int,
    l_max: int,
    law: Law,
    max_radiance: float,
    config: EstimateConfig,
) -> Estimate:
    """Density and coefficients of the cells in which rays terminate, or which none enters.

    Args:
        rays: where rays come from.
        cells: [M, 3] of one level.
        level: that level.
        l_max: highest band of the coefficients.
        law: transmittance law that the density is for.
        max_radiance: L_max, radiance units of the luminaire's scene.
        config: how many rays, and the priors.
    """
    octree = octree_of(cells, level, rays.luminaire.frame.half_extents)
    statistics = LeafStatistics(len(cells), l_max, config)
    size = config.batch_rays
    for batch in range(-(-config.rays // size)):
        stream = SeedStream(Purpose.ESTIMATE, batch)
        statistics.add_rays(octree, rays.draw_terminated(size, stream))
        # Flux in units of the radiance of one ray.
        paths = rays.light_paths(max(1, round(config.light_paths_per_ray * size)), stream)
        statistics.add_light_paths(octree, paths, size / rays.measure)
    # A cell that no ray enters is inside of something: it is kept, and made opaque.
    kept = dr.compress((statistics.terminated > 0) | (statistics.entered == 0))
    cells = cells[np.array(kept)]
    statistics = statistics.take(kept)
    fit = statistics.fit_radiance(_parent_fits(statistics, cells, level, config.start_level))
    coefficients = np.array(_coefficients_of_logits(fit, l_max, max_radiance, config))
    return Estimate(
        cells,
        np.array(statistics.density(2 / (1 << level), law)),
        coefficients.reshape(-1, 3, num_coefficients(l_max)),
    )


def _parent_fits(
    statistics: LeafStatistics, cells: NDArray[np.int64], level: int, start_level: int
) -> list[list[Any]] | None:
    """Fits [3][K] of the cells' parents, gathered for every cell; None up to the start level."""
    if level <= start_level:
        return None
    parents, index = np.unique(cells >> 1, axis=0, return_inverse=True)
    index = on_device(mi.UInt32, index)
    above = statistics.sum_into(index, len(parents))
    fit = above.fit_radiance(_parent_fits(above, parents, level - 1, start_level))
    return [[dr.gather(mi.Float, value, index) for value in channel] for channel in fit]


def _coefficients_of_logits(
    fit: list[list[Any]], l_max: int, max_radiance: float, config: EstimateConfig
) -> Any:
    """Coefficients [M · 3 · K] whose sigmoid follows a fit of radiance [3][K]."""
    count = config.logit_directions
    directions = np.array([halton_direction(i + 1) for i in range(count)])
    values = basis_array(directions, l_max)
    inverse = np.linalg.pinv(values)
    harmonics, leaves = values.shape[1], dr.width(fit[0][0])
    result = dr.zeros(mi.Float, leaves * 3 * harmonics)
    row = dr.arange(mi.UInt32, leaves) * (3 * harmonics)
    for channel, linear in enumerate(fit):
        coefficients = [mi.Float(0)] * harmonics
        for direction in range(count):
            radiance = sum(linear[k] * float(values[direction, k]) for k in range(harmonics))
            emission = dr.clip(radiance / max_radiance, config.min_emission, config.max_emission)
            logit = dr.log(emission / (1 - emission))
            coefficients = [
                coefficients[k] + float(inverse[k, direction]) * logit for k in range(harmonics)
            ]
        for k in range(harmonics):
            dr.scatter(result, coefficients[k], row + (channel * harmonics + k))
    dr.eval(result)
    return result
