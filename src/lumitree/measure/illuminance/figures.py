"""Figures of the illuminance of an area."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray


@dataclasses.dataclass(frozen=True)
class AreaFigures:
    """Figures of the illuminance of an area, by EN 12464-1.

    Attributes:
        name: of the area.
        first, count: which of the receivers are on it.
        enclosed: how many of them are inside solids, and do not count.
        mean, smallest, largest: of the illuminance, lx; NaN if all are inside solids.
        mean_error: standard error of the mean, lx, as if those of the receivers were independent.
        uniformity: U₀, smallest over mean; NaN where all is dark.
        diversity: U_d, smallest over largest; NaN where all is dark.
    """

    name: str
    first: int
    count: int
    enclosed: int
    mean: float
    mean_error: float
    smallest: float
    largest: float
    uniformity: float
    diversity: float

    @classmethod
    def of(
        cls, name: str, first: int, lux: NDArray[np.float64], error: NDArray[np.float64]
    ) -> AreaFigures:
        """Figures of an area from the illuminance [N] of its receivers and the standard errors."""
        open_ = np.isfinite(lux)
        count, enclosed = len(lux), int((~open_).sum())
        if enclosed == count:
            return cls(name, first, count, enclosed, *[np.nan] * 6)
        lux, error = lux[open_], error[open_]
        mean, low, high = float(lux.mean()), float(lux.min()), float(lux.max())
        mean_error = float(np.sqrt((error**2).sum())) / len(lux)
        ratios = (low / mean, low / high) if mean > 0 else (np.nan, np.nan)
        return cls(name, first, count, enclosed, mean, mean_error, low, high, *ratios)

    @property
    def part(self) -> slice:
        """Which of the receivers are on the area."""
        return slice(self.first, self.first + self.count)
