"""Which emitter of a scene next-event estimation samples."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.alias_table import AliasTable
from lumitree.core.device import on_device
from lumitree.rendering.plugins.deferred_emitter import DeferredEmitter
from lumitree.rendering.sampling.lamp_choice import NO_LAMP, LampChoices, Lamps
from lumitree.rendering.sampling.samples import divide_sample

# Part of the samples for emitters that are no baked luminaires, where a scene has both. Whichever
# light the scene, this at most doubles the second moment of an estimate.
_OTHERS = 0.5


@dataclass
class Selected:
    """An emitter that was selected (a PyTree of Dr.Jit)."""

    # fmt: off
    index: mi.UInt32         # Of the emitter in the scene
    weight: mi.Float         # Factor by which its light counts for that of all; 0: there is none
    emitter_pmf: mi.Float    # Its probability for multiple importance sampling
    sample: mi.Point2f       # For the direction, in the unit square
    # fmt: on


class EmitterSelection:
    """Selection of emitters.

    With two baked luminaires or more, these are selected by what they send to the receiver
    (`LampChoice`), and half of the samples are for all other emitters, by their sampling weights.
    Else all are selected by their sampling weights, as `mi.Scene.sample_emitter` does.

    Attributes:
        by_receiver: whether probabilities depend on the receiver.
    """

    def __init__(self, scene: mi.Scene, choices: LampChoices) -> None:
        self._scene, emitters = scene, scene.emitters()
        weights = np.array([emitter.sampling_weight() for emitter in emitters])
        self._total_weight = float(weights.sum())
        # Of those whose weight is 0 the rays of BSDFs find all light.
        lamps = {
            i: each
            for i, each in enumerate(emitters)
            if isinstance(each, DeferredEmitter) and weights[i] > 0
        }
        self.by_receiver = len(lamps) > 1
        if not self.by_receiver:
            return
        indices = np.array(list(lamps))
        centres, radii = zip(*(lamp.placed.sphere for lamp in lamps.values()), strict=True)
        intensities = np.array([lamp.axis_intensities() for lamp in lamps.values()])
        intensities *= weights[indices, None]
        low, high = (np.array(each, np.float64).ravel() for each in _corners(scene))
        self._lamps = choices.of(
            Lamps(indices, np.array(centres), np.array(radii), intensities, low, high)
        )
        weights[indices] = 0
        others = np.flatnonzero(weights)
        self._has_others = bool(len(others))
        # By the index of an emitter: its probability if it is no lamp.
        pmf = np.zeros(len(emitters))
        if self._has_others:
            self._others = AliasTable([weights[None, others]], (1, len(others)))
            self._other_indices = on_device(mi.UInt32, others)
            pmf[others] = _OTHERS * weights[others] / weights.sum()
        numbers = np.array(dr.reinterpret_array(mi.UInt32, scene.emitters_dr()))
        # By the number of an emitter among all emitters of the process.
        index_of = np.full(numbers.max() + 1, NO_LAMP, np.uint32)
        pmf_of = np.zeros(numbers.max() + 1)
        index_of[numbers], pmf_of[numbers] = np.arange(len(emitters)), pmf
        self._index_of, self._pmf_of = on_device(mi.UInt32, index_of), on_device(mi.Float, pmf_of)
        self._part = 1 - _OTHERS if self._has_others else 1.0

    def sample(
        self,
        si: mi.SurfaceInteraction3f,
        normal: mi.Vector3f,
        owner: mi.UInt32,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Selected:
        """Select an emitter.

        Args:
            normal: towards the side that light comes from, unit length; 0 where it may come from
                both.
            owner: index of a lamp whose light the receiver gets otherwise.
        """
        sample = sampler.next_2d()
        if not self.by_receiver:
            index, weight, sample.x = self._scene.sample_emitter(sample.x, active)
            return Selected(index, weight, dr.rcp(weight), sample)
        choice, other = sampler.next_2d(), mi.Bool(False)
        if self._has_others:
            other, choice.x = divide_sample(choice.x, _OTHERS)
        lit = active & ~other
        index, weight, pmf = self._lamps.sample(si.p, normal, owner, choice, lit)
        weight, pmf = weight / self._part, pmf * self._part
        if self._has_others:
            entry, chance = self._others.sample(mi.UInt32(0), choice.x, active & other)
            found = dr.gather(mi.UInt32, self._other_indices, entry, active & other)
            index = dr.select(other, found, index)
            pmf = dr.select(other, _OTHERS * chance, pmf)
            weight = dr.select(other, dr.rcp(pmf), weight)
        return Selected(index, weight, pmf, sample)

    def pmf_by_weight(self, emitter: mi.EmitterPtr) -> mi.Float:
        """Probability of `mi.Scene.sample_emitter`."""
        return emitter.sampling_weight() * dr.rcp(self._total_weight)

    def pmf(
        self, emitter: mi.EmitterPtr, it: mi.Interaction3f, active: mi.Bool | bool = True
    ) -> mi.Float:
        """`Selected.emitter_pmf` that an emitter of the scene has for a receiver."""
        if not self.by_receiver:
            return self.pmf_by_weight(emitter)
        number = dr.reinterpret_array(mi.UInt32, emitter)
        index = dr.gather(mi.UInt32, self._index_of, number, active)
        pmf = self._lamps.pmf(index, it.p, mi.Bool(active))
        return dr.gather(mi.Float, self._pmf_of, number, active) + self._part * pmf


def _corners(scene: mi.Scene) -> tuple[mi.Point3f, mi.Point3f]:
    box = scene.bbox()
    return box.min, box.max
