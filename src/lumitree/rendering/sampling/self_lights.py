"""Next-event estimation of self emission: from a lamp's surfaces towards its own emitters."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device
from lumitree.rendering.sampling.samples import sample_row


class SelfLights:
    """The shapes of one lamp that emit.

    Their emitters exist before their shapes do, so `set_shapes` completes it.
    """

    def __init__(self) -> None:
        self._count = 0

    def set_shapes(self, shapes: list[mi.Shape], power: NDArray[np.float64]) -> None:
        """Sample these shapes in proportion to `power` [N], positive."""
        self._count = len(shapes)
        pmf = power / power.sum()
        # Pointers do not own what they refer to: the shapes own their emitters, which own this.
        self._shapes = mi.ShapePtr(shapes)
        self._cumulated = on_device(mi.Float, np.cumsum(pmf))
        self._pmf = on_device(mi.Float, pmf)

    def pmf(self, index: int) -> mi.Float:
        """Probability with which a shape is sampled."""
        return dr.gather(mi.Float, self._pmf, mi.UInt32(index))

    def sample(self, sample: mi.Float, active: mi.Bool) -> tuple[mi.ShapePtr, mi.Float, mi.Float]:
        """A shape, null where nothing emits; its probability; and a new sample in [0, 1)."""
        if not self._count:
            return dr.zeros(mi.ShapePtr), mi.Float(0), mi.Float(0)
        index = sample_row(self._cumulated, mi.UInt32(0), self._count, sample, active)
        upper = dr.gather(mi.Float, self._cumulated, index, active)
        pmf = dr.gather(mi.Float, self._pmf, index, active)
        rest = dr.clip((sample - upper + pmf) / pmf, 0, dr.one_minus_epsilon(mi.Float))
        return dr.gather(mi.ShapePtr, self._shapes, index, active), pmf, rest
