"""A histogram of light paths by the cell where their rays start and by direction.

Light that ends on the luminaire is counted too, by its reach (`inside`), and of both the straight
light on its own.
"""

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import LightField, TracedPaths, make_light_field
from lumitree.core.octahedral import intensity_of_histogram, own_solid_angles, solid_angles
from lumitree.core.photometry import luminance
from lumitree.core.progress import progress
from lumitree.fit.light_field.batches import num_batches, path_batches
from lumitree.fit.light_field.grid import grid_depth
from lumitree.fit.light_field.inside import DISTANCES, light_inside
from lumitree.fit.light_field.saved_field import SavedLightField
from lumitree.lamp.luminaire import Luminaire
from lumitree.lamp.sent import LampWorkers
from lumitree.trace.histograms import BinnedRays, EndingHistogram, Histogram
from lumitree.trace.light_field_config import LightFieldConfig
from lumitree.trace.lost_light import check_output


def bake_light_field(
    luminaire: Luminaire,
    config: LightFieldConfig,
    folder: Path,
    workers: LampWorkers | None = None,
    seed: int = 0,
) -> LightField:
    """Estimate the light field of a luminaire, and its noise from the batches' spread.

    With it the light that ends on the luminaire, for receivers inside its box.

    Args:
        luminaire: what is baked.
        config: how. Equal settings and seeds give equal fields.
        folder: where the field is kept; it is returned if an equal call left it there.
        workers: what traces the light paths; the field is the same. Default: this process.
        seed: root seed of all random numbers.

    Raises:
        LumitreeError: no light leaves the luminaire, a path's flux is NaN or infinite, or a worker
            is lost.
    """
    saved = SavedLightField(folder, luminaire, config, seed)
    if (field := saved.load()) is not None:
        return field
    depth = grid_depth(luminaire) if config.depth is None else config.depth
    leaving, straight = (Histogram(depth, config.resolution) for _ in range(2))
    ending, straight_ending = (
        EndingHistogram(depth, config.resolution // 2, len(DISTANCES)) for _ in range(2)
    )
    batches = num_batches(config)
    by_direction = []
    with (
        progress(f"light of {luminaire.name}", batches) as advance,
        path_batches(luminaire, config, depth, seed, workers) as traced_batches,
    ):
        for batch in traced_batches:
            rays, ends = _divided(batch.leaving, batches), batch.ending
            ends = dataclasses.replace(ends, rays=_divided(ends.rays, batches))
            leaving.add_binned(rays)
            straight.add_binned(rays.of_straight_light())
            ending.add_binned(ends)
            straight_ending.add_binned(ends.of_straight_light())
            flux = luminance(batch.leaving.flux.astype(np.float64).T)
            by_direction.append(np.bincount(rays.bins, flux, config.resolution**2))
            advance(1)
    check_output(luminaire, np.sum(by_direction, axis=1), seed)
    traced = TracedPaths(
        count=batches * config.batch,
        seeds=(seed,),
        luminaire=luminaire.fingerprint,
        noise=relative_noise(np.array(by_direction) / own_solid_angles(config.resolution)),
    )
    flux, bent = leaving.flux, leaving.flux_without(straight)
    intensity = intensity_of_histogram(flux)
    bent = intensity * np.divide(bent, flux, out=bent, where=flux > 0)
    field = make_light_field(leaving.cells, intensity, depth, traced, bent=bent)
    inside = light_inside(field, ending, straight_ending, seed)
    field = dataclasses.replace(field, inside=inside)
    saved.save(field)
    return field


def relative_noise(estimates: NDArray[np.float64]) -> float | None:
    """Relative standard error of the mean of K independent estimates [K, R²], from their spread.

    The variance of the mean Ī in a bin is Σ (I_k - Ī)² / (K (K - 1)). The result is the root mean
    square of the standard error over the root mean square of Ī, both over the sphere; None for
    K = 1 and for estimates without light.
    """
    solid_angle, count = solid_angles(round(estimates.shape[1] ** 0.5)), len(estimates)
    mean = (1 / count * estimates).sum(axis=0)
    light = (solid_angle * mean**2).sum()
    if count < 2 or not light > 0:
        return None
    variance = (1 / count * (estimates - mean) ** 2).sum(axis=0) / (count - 1)
    return float(np.sqrt((solid_angle * variance).sum() / light))


def _divided(rays: BinnedRays, count: int) -> BinnedRays:
    """Rays with a part of their flux, in float64."""
    return dataclasses.replace(rays, flux=rays.flux.astype(np.float64) / count)
