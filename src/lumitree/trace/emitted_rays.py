"""Rays that leave a luminaire or an asset: what flux, irradiance, photometry and bakes sum over.

A luminaire emits light paths (`lumitree.trace.lamp_rays`), an asset rays sampled from its emission
(`lumitree.rendering.asset_rays`).
"""

import dataclasses
from typing import Any, Protocol

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray


@dataclasses.dataclass
class RayBatch:
    """Rays that leave a luminaire or an asset; local frame.

    Attributes:
        origin: mi.Point3f, inside the bounding box, local units.
        direction: mi.Vector3f, unit direction of travel.
        flux: mi.Color3f, in the luminaire's unit of radiance times sr times local units². The sum
            over the rays of a draw is an estimate of the emitted flux.
    """

    origin: Any
    direction: Any
    flux: Any

    def arrays(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Origin, direction and flux, each [N, 3]."""
        return as_rows(self.origin), as_rows(self.direction), as_rows(self.flux)


class EmittedRays(Protocol):
    """The rays of a luminaire, of an asset, or of another representation of its light."""

    def draw(self, count: int, seed: int) -> RayBatch:
        """Rays that leave, of `count` samples; samples that are absorbed have none.

        Args:
            count: number of samples, which the flux of the rays is divided by.
            seed: 32-bit seed of the draw, see `lumitree.core.seeds`. Equal seeds give equal rays.
        """
        ...


def seeded_sampler(seed: int, count: int) -> Any:
    """Independent mi.Sampler for `count` samples."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    return sampler


def as_rows(vectors: Any) -> NDArray[np.float64]:
    """Dr.Jit vectors of three components as an array [N, 3]."""
    # Each by itself: the number of vectors would be a part of a kernel's code.
    components = (np.array(each, np.float64) for each in vectors)
    return np.array(np.broadcast_arrays(*components)).T
