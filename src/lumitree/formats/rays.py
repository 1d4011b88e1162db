"""Rays that leave a light source."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


@dataclasses.dataclass(frozen=True, eq=False)
class Rays:
    """Rays in the frame of a luminaire's file, y up.

    Attributes:
        origin: [N, 3] where each starts, m.
        direction: [N, 3] unit direction of travel.
        flux: [N, 3] radiant flux of R, G and B, W; the sum is the flux of the source.
        spectrum: [471] power per nm of all rays together at `core.photometry.WAVELENGTHS`, in any
            unit; None if it is not known.
    """

    origin: NDArray[np.float64]
    direction: NDArray[np.float64]
    flux: NDArray[np.float64]
    spectrum: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.origin)

    @staticmethod
    def joined(parts: "Sequence[Rays]") -> "Rays":
        """Rays of independent estimates of one source, whose mean is taken."""
        if not parts:
            return Rays(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
        return Rays(
            np.concatenate([part.origin for part in parts]),
            np.concatenate([part.direction for part in parts]),
            np.concatenate([part.flux for part in parts]) / len(parts),
        )
