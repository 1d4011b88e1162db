"""The rays that representations are fitted to: light that leaves a luminaire."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.core.seeds import Purpose, SeedStream
from lumitree.lamp.luminaire import Luminaire

BATCH = 1 << 20
# `Purpose.LIGHT_FIELD` has steps 0 to some hundreds for its own bake.
FIRST_STEP = 1 << 16


@dataclasses.dataclass(frozen=True)
class TracedRays:
    """Rays of light, local frame.

    Attributes:
        origin: float32 [N, 3], last vertex, inside the box.
        direction: float32 [N, 3], unit direction of travel.
        flux: float32 [N, 3]; the sum is the luminaire's flux, local units.
        half_extents: [3], of the bounding box.
    """

    origin: NDArray[np.float32]
    direction: NDArray[np.float32]
    flux: NDArray[np.float32]
    half_extents: NDArray[np.float64]


def trace_rays(luminaire: Luminaire, count: int, seed: int) -> TracedRays:
    """Light paths of a luminaire, `count` rounded up to a multiple of `BATCH`."""
    from lumitree.trace.lamp_rays import LampRays

    rays, batches = LampRays(luminaire), -(-count // BATCH)
    parts: list[tuple[NDArray[np.float32], ...]] = []
    for step in range(batches):
        stream = SeedStream(Purpose.LIGHT_FIELD, FIRST_STEP + step)
        vectors = rays.draw(BATCH, stream.seed(seed)).arrays()
        parts.append(tuple(each.astype(np.float32) for each in vectors))
    origin, direction, flux = (np.concatenate(each) for each in zip(*parts, strict=True))
    flux /= np.float32(batches)
    return TracedRays(origin, direction, flux, luminaire.frame.half_extents)
