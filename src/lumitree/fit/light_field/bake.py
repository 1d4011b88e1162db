"""A histogram of light paths by the cell where their rays start and by direction.

Light that ends on the luminaire is counted too, by its reach (`inside`). Both histograms have the
bent part of the light beside the whole.

Cells follow the light, and not the box of the lamp. A chain or a cable makes the box longer and
adds next to no light. So the side of a cell is a part of the spread of the light. It is a power of
two of the side of the box: cells of a coarser grid are sums of 2 × 2 × 2 cells.
"""

import contextlib
import dataclasses
import functools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import MAX_DEPTH, LightField, TracedPaths, make_light_field
from lumitree.asset.light_field_file import LightDescription, build_light_field, stored_light_field
from lumitree.core.checkpoint import Checkpoint
from lumitree.core.device import as_rows
from lumitree.core.executor import run_tasks
from lumitree.core.files import json_text
from lumitree.core.octahedral import bin_solid_angles, intensity_of_histogram, solid_angles
from lumitree.core.photometry import luminance
from lumitree.core.progress import progress
from lumitree.core.reading import parse_json
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.core.tables import converted
from lumitree.errors import LumitreeError
from lumitree.fit.light_field.inside import DISTANCES, EndingDraw, light_inside
from lumitree.lamp.luminaire import LampWorkers, Luminaire, received_luminaire
from lumitree.trace.flux import check_output
from lumitree.trace.histograms import (
    BinnedRays,
    BinnedSegments,
    EndingHistogram,
    LightHistogram,
    bin_rays,
    cell_codes,
)
from lumitree.trace.light_field_config import LEAST_DEPTH, LightFieldConfig
from lumitree.trace.light_paths import LampRays, LightPaths
from lumitree.trace.segments import EndingConfig, EndingSegments, bin_segments

# A bin has about ten paths, so that one with more than this multiple of its first flux would stand
# out; 0.1 to 0.2 % of a lamp's flux is above it.
FLUX_LIMIT = 8.0
# Light paths that choose the grid.
_GRID_PATHS = 1 << 16
# Quantiles of the flux between which the light is.
_SPREAD = (0.05, 0.95)
# Parts of the flux, and the cells in which they may start: finer cells would get too few paths. In
# the coarsest grid 90 % of the flux of lamps is in up to 1,200 cells. The second limit bounds the
# memory.
_LIMITS = ((0.9, 800), (1.0, 6000))


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
    inputs = {
        "luminaire": luminaire.fingerprint,
        "config": dataclasses.asdict(config),
        "seed": seed,
    }
    checkpoint = Checkpoint(folder / "light.npz", inputs, "bake")
    if (field := _saved(checkpoint)) is not None:
        return field
    depth = grid_depth(luminaire) if config.depth is None else config.depth
    leaving = LightHistogram(depth, config.resolution)
    ending = EndingHistogram(depth, config.resolution // 2, len(DISTANCES))
    batches = num_batches(config)
    by_direction = []
    with (
        progress(f"light of {luminaire.name}", batches) as advance,
        path_batches(luminaire, config, depth, seed, workers) as traced_batches,
    ):
        for batch in traced_batches:
            rays, segments = _divided(batch.leaving, batches), batch.ending
            leaving.add_binned(rays)
            ending.add_segments(
                dataclasses.replace(segments, rays=_divided(segments.rays, batches))
            )
            flux = luminance(batch.leaving.flux.astype(np.float64).T)
            by_direction.append(np.bincount(rays.bins, flux, config.resolution**2))
            advance(1)
    check_output(luminaire, np.sum(by_direction, axis=1), seed)
    traced = TracedPaths(
        count=batches * config.batch,
        seeds=(seed,),
        luminaire=luminaire.fingerprint,
        noise=relative_noise(np.array(by_direction) / bin_solid_angles(config.resolution)),
    )
    flux, bent = leaving.flux, leaving.bent
    intensity = intensity_of_histogram(flux)
    bent = intensity * np.divide(bent, flux, out=bent, where=flux > 0)
    field = make_light_field(leaving.cells, intensity, depth, traced, bent=bent)
    field = dataclasses.replace(field, inside=light_inside(field, ending, seed))
    tensors, description = stored_light_field(field)
    checkpoint.try_save({"description": np.array(json_text(description)), **tensors})
    return field


def _saved(checkpoint: Checkpoint) -> LightField | None:
    """The field of a checkpoint; None where it is another luminaire's or damaged."""
    try:
        if (arrays := checkpoint.load()) is None:
            return None
        description = parse_json(str(arrays.pop("description")))
        return build_light_field(converted(description, LightDescription), arrays)
    except (LumitreeError, KeyError):
        return None


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


@dataclasses.dataclass(frozen=True)
class PathBatch:
    """Light paths that leave the luminaire, and segments that end on it; the flux is float32."""

    leaving: BinnedRays
    ending: BinnedSegments


def num_batches(config: LightFieldConfig) -> int:
    """Number of batches of a light field."""
    return -(-config.paths // config.batch)


@contextlib.contextmanager
def path_batches(
    luminaire: Luminaire,
    config: LightFieldConfig,
    depth: int,
    seed: int,
    workers: LampWorkers | None,
) -> Iterator[Iterator[PathBatch]]:
    """Context with all batches of a light field, in order; equal with and without workers."""
    if workers is None:
        rays = LampRays(luminaire)
        yield (_traced(rays, config, depth, seed, step) for step in range(num_batches(config)))
        return
    steps = range(num_batches(config))
    tasks = [(workers.luminaire, config, depth, seed, step) for step in steps]
    with run_tasks(
        workers.executor,
        _traced_by_worker,
        tasks,
        what="batches of light paths",
        total=len(tasks),
        in_order=True,
        remedy="run it again",
    ) as results:
        yield (batch for _, batch in results)


def _traced(
    rays: LampRays, config: LightFieldConfig, depth: int, seed: int, step: int
) -> PathBatch:
    paths_seed, reservoir_seed, places_seed = (
        stream.seed(seed)
        for stream in (
            SeedStream(Purpose.LIGHT_FIELD, step),
            SeedStream(Purpose.ENDING, step, EndingDraw.SEGMENTS),
            SeedStream(Purpose.ENDING, step, EndingDraw.PLACES),
        )
    )
    segments = EndingConfig(depth, reservoir_seed)
    paths = rays.draw(config.batch, paths_seed, ending=segments, flux_limit=FLUX_LIMIT)
    assert paths.ending is not None
    flux, ending_flux = (as_rows(each.flux).T.astype(np.float32) for each in (paths, paths.ending))
    resolution = config.resolution
    return PathBatch(
        bin_rays(paths.origin, paths.direction, paths.straight, flux, depth, resolution),
        bin_segments(paths.ending, ending_flux, depth, resolution // 2, DISTANCES, places_seed),
    )


def _traced_by_worker(
    luminaire: bytes, config: LightFieldConfig, depth: int, seed: int, step: int
) -> PathBatch:
    """The task of a worker: one batch."""
    return _traced(_rays(luminaire), config, depth, seed, step)


@functools.lru_cache(maxsize=1)
def _rays(luminaire: bytes) -> LampRays:
    return LampRays(received_luminaire(luminaire))


def grid_depth(luminaire: Luminaire) -> int:
    """Depth of the grid for a luminaire: at least `LEAST_DEPTH`, and larger where light is dense.

    It does not depend on the seed of a bake: fields of all seeds have the same cells.

    Raises:
        LumitreeError: a path's flux is NaN or infinite.
    """
    paths_seed, reservoir_seed = (SeedStream(Purpose.CELLS, draw=draw).seed(0) for draw in (0, 1))
    segments = EndingConfig(MAX_DEPTH, reservoir_seed)
    rays = LampRays(luminaire)
    paths = rays.draw(_GRID_PATHS, paths_seed, ending=segments, flux_limit=FLUX_LIMIT)
    if not as_rows(paths.flux).any():
        return LEAST_DEPTH
    assert paths.ending is not None
    finer = round(math.log2(1 / max(_spread(paths), 2.0**-MAX_DEPTH)))
    for depth in range(min(LEAST_DEPTH + finer, MAX_DEPTH), LEAST_DEPTH, -1):
        parts = _flux_by_cell(paths, depth), _flux_by_cell(paths.ending, depth)
        if all(_num_cells(flux, part) <= most for flux in parts for part, most in _LIMITS):
            return depth
    return LEAST_DEPTH


def _spread(rays: LightPaths) -> float:
    """Side of the light over the side of the lamp's box, 0 to 1.

    It is the side of a square with the area of the largest face of the light's box: light along a
    line is not spread, since receivers beside it are near.
    """
    low, high = np.quantile(
        as_rows(rays.origin),
        _SPREAD,
        axis=0,
        weights=luminance(as_rows(rays.flux)),
        method="inverted_cdf",
    )
    sides = np.sort(high - low) / 2
    return math.sqrt(sides[1] * sides[2])


def _flux_by_cell(rays: LightPaths | EndingSegments, depth: int) -> NDArray[Any]:
    """Luminous flux of the cells in which rays start, the largest first."""
    cells = np.floor((as_rows(rays.origin) + 1) * 2.0 ** (depth - 1)).astype(np.int64)
    codes = cell_codes(np.clip(cells, 0, (1 << depth) - 1), depth)
    _, cell = np.unique(codes, return_inverse=True)
    return np.sort(np.bincount(cell, luminance(as_rows(rays.flux))))[::-1]


def _num_cells(flux: NDArray[Any], part: float) -> int:
    """Number of the first cells that have a part of the flux."""
    total = flux.cumsum()
    return int(np.searchsorted(total, part * total[-1])) + 1
