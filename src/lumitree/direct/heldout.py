"""Rays kept apart, and what they say about a field: an unbiased PSNR with its uncertainty."""

import dataclasses
from typing import Any

import drjit as dr
import numpy as np

from lumitree.direct.field import LeafField
from lumitree.direct.rays import HELD_OUT_BATCH, TILE_LINES, RaySource

_NUM_LINES = 1 << 17
_PATHS = 8


@dataclasses.dataclass(frozen=True)
class Score:
    """PSNR of radiance / L_max (the asset's) in dB, and half the width of its 68 % interval."""

    psnr: float
    uncertainty: float

    def __str__(self) -> str:
        return f"held-out PSNR {self.psnr:.2f} ± {self.uncertainty:.2f} dB"


@dataclasses.dataclass(frozen=True)
class HeldOut:
    """Lines with two independent noisy estimates a and b of their radiance / L_max.

    The mean of (L - a)(L - b) is the mean squared error of L: noise that is independent in the
    two leaves no bias, so that few paths suffice.
    """

    origin: Any
    direction: Any
    first: Any
    second: Any

    @staticmethod
    def trace(source: RaySource, max_radiance: float) -> "HeldOut":
        """Lines that no step of a bake draws."""
        pairs = source.pairs(_NUM_LINES, HELD_OUT_BATCH, _PATHS)
        scale = 1 / max_radiance
        return HeldOut(pairs.origin, pairs.direction, pairs.first * scale, pairs.second * scale)

    def rescaled(self, factor: float) -> "HeldOut":
        """The same for an L_max that is `factor` times as large."""
        scale = 1 / factor
        return HeldOut(self.origin, self.direction, self.first * scale, self.second * scale)

    def score(self, field: LeafField) -> Score:
        """PSNR of a field on these lines."""
        radiance, _, _ = field.integrate(self.origin, self.direction)
        a, b = dr.minimum(self.first, 1), dr.minimum(self.second, 1)
        products = [(radiance[c] - a[c]) * (radiance[c] - b[c]) for c in range(3)]
        values = np.array(sum(products) / 3)
        error = max(float(values.mean()), 1e-12)
        tiles = values.reshape(-1, TILE_LINES).mean(axis=1)
        deviation = float(tiles.std() / np.sqrt(len(tiles)))
        return Score(-10 * np.log10(error), 10 / np.log(10) * deviation / error)
