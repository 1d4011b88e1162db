"""Figures of the flux that leaves a luminaire, and of what short paths miss of it."""

import dataclasses
import math


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flux:
    """Estimate of the flux that leaves a luminaire, for lengths in metres.

    Attributes:
        watts: radiant flux of R, G and B, W, for radiance in W/(m² sr).
        watts_error: standard errors of `watts`, W.
        lumens: luminous flux, lm.
        lumens_error: standard error of `lumens`, lm.
        paths: number of paths of the estimate.
        hits: number of paths that carry light.
    """

    watts: tuple[float, ...]
    watts_error: tuple[float, ...]
    lumens: float
    lumens_error: float
    paths: int
    hits: int

    def __str__(self) -> str:
        return flux_text(self.lumens, self.lumens_error)


def flux_text(lumens: float, error: float) -> str:
    """Luminous flux ± standard error, rounded to two significant digits of the error."""
    digits = max(0, 1 - math.floor(math.log10(error))) if error else 0
    return f"{lumens:,.{digits}f} ± {error:,.{digits}f} lm"


@dataclasses.dataclass(frozen=True, kw_only=True)
class MissedFlux:
    """Share of the luminous flux that paths of limited length miss.

    Attributes:
        path_depth: largest number of bounces.
        reference_depth: largest number of bounces of the paths that are compared with, without
            Russian roulette.
        share: share of the flux, 0 to 1.
        error: standard error of `share`.
    """

    path_depth: int
    reference_depth: int
    share: float
    error: float
