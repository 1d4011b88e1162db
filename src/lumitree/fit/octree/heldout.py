"""Held-out rays, and the score of a field on them: an unbiased PSNR with its uncertainty."""

import dataclasses
from typing import Any

import drjit as dr
import numpy as np

from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.octree.config import TILE_RAYS, HeldOutConfig
from lumitree.fit.octree.leaf_field import LeafField
from lumitree.fit.octree.ray_source import RaySource


@dataclasses.dataclass(frozen=True)
class Score:
    """Accuracy of a field on rays that it does not learn from, dB.

    `psnr` is of radiance / L_max (the asset's), `uncertainty` half the width of its 68 % interval,
    and `opacity_psnr` of the transmittance.
    """

    psnr: float
    uncertainty: float
    opacity_psnr: float

    @property
    def rank(self) -> float:
        """A bake keeps the field with the largest sum of both PSNR."""
        return self.psnr + self.opacity_psnr

    def __str__(self) -> str:
        return f"held-out PSNR {self.psnr:.2f} ± {self.uncertainty:.2f} dB"


@dataclasses.dataclass(frozen=True)
class HeldOut:
    """Rays with their transmittance and two independent noisy estimates a, b of radiance / L_max.

    The mean of (L - a)(L - b) is the mean squared error of L. Noise that is independent in a and b
    causes no bias, so that few paths suffice.

    Attributes:
        origin, direction: mi.Point3f and mi.Vector3f, local frame.
        first, second: mi.Color3f, a and b.
        transmittance: mi.Float.
    """

    origin: Any
    direction: Any
    first: Any
    second: Any
    transmittance: Any

    @staticmethod
    def trace(source: RaySource, max_radiance: float, config: HeldOutConfig) -> "HeldOut":
        """Rays that no step of a bake draws."""
        pairs = source.draw_pairs(config.rays, SeedStream(Purpose.HELD_OUT), config.paths)
        scale = 1 / max_radiance
        a, b = (dr.minimum(value * scale, 1) for value in (pairs.first, pairs.second))
        return HeldOut(pairs.origin, pairs.direction, a, b, pairs.transmittance)

    def rescaled(self, factor: float) -> "HeldOut":
        """The same for an L_max `factor` times as large; clipped values stay clipped."""
        a, b = (dr.minimum(value * (1 / factor), 1) for value in (self.first, self.second))
        return dataclasses.replace(self, first=a, second=b)

    def score(self, field: LeafField) -> Score:
        """Score of a field on these rays."""
        radiance, through, _ = field.integrate(self.origin, self.direction)
        products = [
            (radiance[c] - self.first[c]) * (radiance[c] - self.second[c]) for c in range(3)
        ]
        values = np.array(sum(products) / 3)
        error = max(float(values.mean()), 1e-12)
        tiles = values.reshape(-1, TILE_RAYS).mean(axis=1)
        deviation = float(tiles.std() / np.sqrt(len(tiles)))
        opacity_error = max(float(np.square(np.array(through - self.transmittance)).mean()), 1e-12)
        return Score(
            psnr=-10 * np.log10(error),
            uncertainty=10 / np.log(10) * deviation / error,
            opacity_psnr=-10 * np.log10(opacity_error),
        )
