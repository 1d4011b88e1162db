"""Batches of light paths for a light field, traced in this process or by workers."""

import contextlib
import dataclasses
import functools
from collections.abc import Iterator

import numpy as np

from lumitree.core.executor import run_tasks
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.light_field.inside import DISTANCES
from lumitree.lamp.luminaire import Luminaire
from lumitree.lamp.sent import LampWorkers, received_luminaire
from lumitree.trace.emitted_rays import as_rows
from lumitree.trace.ending_segments import EndingConfig
from lumitree.trace.histograms import BinnedRays, BinnedSegments, bin_rays, bin_segments
from lumitree.trace.lamp_rays import LampRays
from lumitree.trace.light_field_config import LightFieldConfig

# A bin has about ten paths, so that one with a larger gain would stand out; above it is 0.1 to
# 0.2 % of a lamp's flux.
LARGEST_GAIN = 8.0


@dataclasses.dataclass(frozen=True)
class PathBatch:
    """Light paths that leave the luminaire, and segments that end on it; the flux is float32."""

    leaving: BinnedRays
    ending: BinnedSegments


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


def num_batches(config: LightFieldConfig) -> int:
    """Number of batches of a light field."""
    return -(-config.paths // config.batch)


def _traced(
    rays: LampRays, config: LightFieldConfig, depth: int, root: int, step: int
) -> PathBatch:
    segments = EndingConfig(depth, SeedStream(Purpose.ENDING, step).seed(root))
    seed = SeedStream(Purpose.LIGHT_FIELD, step).seed(root)
    paths = rays.draw(config.batch, seed, ending=segments, largest_gain=LARGEST_GAIN)
    assert paths.ending is not None
    flux, ends = (as_rows(each.flux).T.astype(np.float32) for each in (paths, paths.ending))
    places = SeedStream(Purpose.ENDING, step, 2).seed(root)
    return PathBatch(
        bin_rays(paths.origin, paths.direction, paths.straight, flux, depth, config.resolution),
        bin_segments(paths.ending, ends, depth, config.resolution // 2, DISTANCES, places),
    )


def _traced_by_worker(
    luminaire: bytes, config: LightFieldConfig, depth: int, seed: int, step: int
) -> PathBatch:
    """The task of a worker: one batch."""
    return _traced(_rays(luminaire), config, depth, seed, step)


@functools.lru_cache(maxsize=1)
def _rays(luminaire: bytes) -> LampRays:
    return LampRays(received_luminaire(luminaire))
