"""The rays that representations are fitted to: light that leaves a luminaire."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.core.seeds import Purpose, SeedStream
from lumitree.lamp.luminaire import Luminaire

BATCH = 1 << 20
# `Purpose.EXITANT` has steps 0 to some hundreds for its own bake.
FIRST_STEP = 1 << 16


@dataclasses.dataclass(frozen=True)
class TracedRays:
    """Rays of light, local frame.

    Attributes:
        origin: float32 [N, 3], last vertex, inside the box.
        direction: float32 [N, 3], unit direction of flight.
        flux: float32 [N, 3]; the sum is the luminaire's flux, local units.
        half_extents: [3], of the bounding box.
    """

    origin: NDArray[np.float32]
    direction: NDArray[np.float32]
    flux: NDArray[np.float32]
    half_extents: NDArray[np.float64]


def trace_rays(luminaire: Luminaire, count: int, seed: int) -> TracedRays:
    """Light paths of a luminaire, `count` rounded up to a multiple of `BATCH`."""
    import mitsuba as mi

    from lumitree.trace.light_paths import trace_light
    from lumitree.trace.tracing import PATH_DEPTH

    batches = -(-count // BATCH)
    parts: list[tuple[NDArray[np.float32], ...]] = []
    for step in range(batches):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(SeedStream(Purpose.EXITANT, FIRST_STEP + step).seed(seed), BATCH)
        paths = trace_light(luminaire, sampler, BATCH, PATH_DEPTH, all_light=True)
        vectors = paths.origin, -paths.direction, paths.flux / batches
        parts.append(tuple(np.array(v, np.float32).reshape(3, -1).T for v in vectors))
    origin, direction, flux = (np.concatenate(each) for each in zip(*parts, strict=True))
    return TracedRays(origin, direction, flux, luminaire.frame.half_extents)
