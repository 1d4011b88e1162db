"""Illuminance with standard errors, until it is known well enough.

Direct light from the light fields of baked luminaires is a sum over their cells (`S` below), which
holds where nothing of the scene shadows a receiver. Shadows are sampled, and so is the straight
light of luminaires with geometry, which their light fields do not give.

Symbols
    t   sample of direct illuminance, by emitter sampling
    w   the same sample if nothing shadowed it, for baked luminaires whose light is summed; else 0
    S   mean of w, by summation
    c   coefficient of the control variate w
    y   t + c (S - w), with the same mean as t. Where nothing is shadowed, c = 1 and all samples are
        S; where everything is, c = 0 and all are 0
    r   sample of the light of surfaces and media

What is rare may not be in the samples yet, and then their variance is 0: the shadow of one lamp
among many, or light that comes through glass. So shadows and light that is not summed are counted,
each by itself, and what is rare has a variance of its own until there is enough of it.
"""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.photometry import luminance
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.measure.illuminance.light import (
    behind_surfaces,
    emitter_light,
    medium_at,
    receivers,
    reflected_light,
    summed_part,
)
from lumitree.rendering.plugins.deferred_emitter import DeferredEmitter
from lumitree.rendering.plugins.path_scene import PathScene

# Samples that are computed at once, and of a receiver in a pass.
_AT_ONCE = 1 << 20
_MIN_SAMPLES, _MAX_SAMPLES = 64, 4096
# Samples of a receiver that the first coefficients are estimated with; they are not used further.
_PILOT = 16
# Sums over the cells of light fields, each with other random points of the cells: so many at first,
# and at once at most. Their standard error is brought below this part of the one that is wanted. Of
# fewer sums at first the variance is small by chance at some points, and stated too small there.
_SUMS, _MAX_SUMS, _SUM_PART = 16, 1 << 10, 0.3
# Part of the rays that end at backs of surfaces where a dark receiver is inside a solid. Not all of
# them: faces of a solid may lie in those of another, as those of a cupboard in the walls.
_ENCLOSED = 0.1
# Passes in which such a receiver is searched for light before it counts as inside.
_SEARCHES = 16
# Events seen fewer than `_FEW` times have no usable variance estimate. A receiver without light
# gets at least `_UNSEEN` samples (so do all together, if none has any light that is not summed),
# and at most `_MAX_UNSEEN` samples in search of unseen events.
_FEW, _UNSEEN, _MAX_UNSEEN = 8, 1 << 12, 1 << 14
# Relative rounding error of the light of an unoccluded sample, whose factors may come in any order.
_ROUNDING = 1e-5
# Errors are relative to the illuminance, but to no less than this part of the mean.
FLOOR = 0.1

_Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Estimate:
    """Illuminance of receivers, lx.

    Attributes:
        direct, total: [N]; NaN inside solids.
        direct_error, total_error: [N] standard errors.
        samples: [N] samples of each.
    """

    direct: _Array
    direct_error: _Array
    total: _Array
    total_error: _Array
    samples: NDArray[np.int64]


class _Moments:
    """Number, sums and sums of squares of samples, by receiver."""

    def __init__(self, count: int) -> None:
        self.number, self.hits = np.zeros(count, np.int64), np.zeros(count, np.int64)
        self.sum, self.squares = np.zeros(count), np.zeros(count)

    def add(self, index: NDArray[np.int64], values: _Array) -> None:
        """Add values [M, K] of the receivers of an index [M]."""
        self.number[index] += values.shape[1]
        self.sum[index] += values.sum(axis=1)
        self.squares[index] += (values**2).sum(axis=1)
        self.hits[index] += np.count_nonzero(values, axis=1)

    @property
    def mean(self) -> _Array:
        return self.sum / self.number

    @property
    def variance(self) -> _Array:
        """Variance of the mean."""
        spread = np.maximum(self.squares - self.sum * self.mean, 0)
        return spread / np.maximum(self.number - 1, 1) / self.number

    @property
    def doubt(self) -> _Array:
        """Added to the variance for receivers with few samples that are not 0.

        Where light comes by rare paths, as through glass, their own variance may be 0 by chance.
        With it they have the variance of all receivers.
        """
        own = self.variance
        of_all = (own * self.number).mean() / self.number
        return np.where(self.hits < _FEW, np.maximum(of_all - own, 0), 0)


class _Shadows:
    """How many samples of lamps whose light is summed were dimmed, and how many got through."""

    def __init__(self, count: int) -> None:
        self._number, self._dimmed, self._lit = (np.zeros(count, np.int64) for _ in range(3))

    def add(self, index: NDArray[np.int64], t: _Array, w: _Array) -> None:
        self._number[index] += np.count_nonzero(w > 0, axis=1)
        self._dimmed[index] += np.count_nonzero((w > 0) & (t < (1 - _ROUNDING) * w), axis=1)
        self._lit[index] += np.count_nonzero((w > 0) & (t > 0), axis=1)

    def doubt(self, summed: _Array) -> _Array:
        """Added to the variance where shadows, or the light between them, are rare.

        Of n samples, which have about equal parts of S, as many and one more are taken to be of the
        rarer kind.
        """
        rare = np.minimum(self._dimmed, self._lit)
        n = np.maximum(self._number, 1)
        return np.where(rare < _FEW, summed**2 * (rare + 1) / ((n + 2) * n), 0)


class _Control:
    """The coefficients of the control variate, from all samples so far."""

    def __init__(self, count: int) -> None:
        self._number = np.zeros(count)
        self._w, self._t, self._ww, self._tw = (np.zeros(count) for _ in range(4))

    def add(self, index: NDArray[np.int64], t: _Array, w: _Array) -> None:
        self._number[index] += t.shape[1]
        products = (w, t, w * w, t * w)
        sums = (self._w, self._t, self._ww, self._tw)
        for total, product in zip(sums, products, strict=True):
            total[index] += product.sum(axis=1)

    def coefficient(self, index: NDArray[np.int64]) -> _Array:
        """c [M]: the covariance of t and w over the variance of w.

        Where w is constant, it is what is not shadowed of it.
        """
        n, w, t = self._number[index], self._w[index], self._t[index]
        variance = self._ww[index] - w * w / n
        covariance = self._tw[index] - t * w / n
        some = variance > 1e-9 * self._ww[index]
        squares = self._ww[index]
        ratio = np.divide(self._tw[index], squares, out=np.ones(len(index)), where=squares > 0)
        np.divide(covariance, variance, out=ratio, where=some)
        return np.clip(ratio, 0, 1)


def estimate(
    scene: PathScene,
    points: _Array,
    normals: _Array,
    *,
    error: float,
    seconds: float | None,
    reflected: bool,
    seed: int,
) -> Estimate:
    """Illuminance of receivers.

    Args:
        scene: with an emitter.
        points, normals: [N, 3].
        error: largest standard error of a receiver that is wanted, relative to its illuminance, and
            to no less than `FLOOR` times the mean of all.
        seconds: after which nothing more is sampled; None for no limit.
        reflected: whether light of surfaces and media is estimated. Without, the total is direct.
        seed: root seed.
    """
    start, count = time.perf_counter(), len(points)
    everyone = np.arange(count)
    summed, summed_variance = _summed(scene, points, normals, _SUM_PART * error, seed)
    control, direct, total = _Control(count), _Moments(count), _Moments(count)
    # Of light that is not summed: the direct part of it, and all.
    others, rest, shadows = _Moments(count), _Moments(count), _Shadows(count)
    sampler = _Sampler(scene, points, normals, seed)
    for index in _chunks(everyone, _PILOT):
        t, w, *_ = sampler.draw(index, _PILOT, reflected=False)
        control.add(index, t, w)
        shadows.add(index, t, w)
    left, samples, share = everyone, _MIN_SAMPLES, 0.0
    largest, by_samples, unsure = np.zeros(count), np.zeros(count, bool), np.zeros(count)
    with progress("illuminance", 1.0) as advance:
        while len(left):
            for index in _chunks(left, samples):
                t, w, r, sampled = sampler.draw(index, samples, reflected=reflected)
                c = control.coefficient(index)
                y = t + c[:, None] * (summed[index, None] - w)
                other = np.where(w > 0, 0, t)
                direct.add(index, y)
                total.add(index, y + r)
                others.add(index, other)
                rest.add(index, other + r)
                control.add(index, t, w)
                shadows.add(index, t, w)
                largest[index] = np.maximum(largest[index], c)
                by_samples[index] |= sampled
            mean, own = total.mean, total.variance
            unsure = rest.doubt if reflected else by_samples * others.doubt
            variance = own + unsure + shadows.doubt(summed)
            # Samples beyond all numbers do not become fewer.
            lost = ~np.isfinite(variance)
            level = mean[~lost].mean() if not lost.all() else 0.0
            goal = (error * np.maximum(mean, FLOOR * level)) ** 2
            unseen, number = total.hits == 0, total.number
            enough = (variance <= goal) & (~unseen | (number >= _UNSEEN))
            if not rest.hits.any():
                enough &= number.sum() >= _UNSEEN
            # What is only doubtful ends some time.
            enough |= (own <= goal) & (number >= _MAX_UNSEEN)
            left = np.flatnonzero(~enough & ~lost)
            part = np.where(lost, 1, _ratio(goal, np.maximum(goal, variance)))
            done = float(part.mean())
            spent = time.perf_counter() - start
            if seconds is not None:
                done = max(done, min(1.0, spent / seconds))
                if spent >= seconds:
                    left = left[:0]
            advance(max(0.0, done - share), f"{len(left):,} points left")
            share = max(share, done)
            samples = int(np.clip(_AT_ONCE // max(len(left), 1), _MIN_SAMPLES, _MAX_SAMPLES))
    # Samples share the error of S.
    shared = largest**2 * summed_variance + shadows.doubt(summed)
    dark = np.flatnonzero(total.mean == 0)
    # Unknown inside solids: NaN.
    known = np.ones(count)
    known[dark[sampler.enclosed(dark)]] = np.nan
    return Estimate(
        known * direct.mean,
        known * np.sqrt(direct.variance + by_samples * others.doubt + shared),
        known * total.mean,
        known * np.sqrt(total.variance + unsure + shared),
        total.number,
    )


class _Sampler:
    """Samples of the illuminance of receivers, pass by pass."""

    def __init__(self, scene: PathScene, points: _Array, normals: _Array, seed: int) -> None:
        self._scene, self._points, self._normals, self._seed = scene, points, normals, seed
        self._step = 0

    def draw(
        self, index: NDArray[np.int64], count: int, *, reflected: bool
    ) -> tuple[_Array, _Array, _Array, NDArray[np.bool_]]:
        """Samples of the receivers of an index [M].

        Returns:
            t, w and reflected light [M, count], lx; and whether [M] emitters may light a receiver
            whose light is not summed.
        """
        sampler = mi.load_dict({"type": "independent"})
        stream = SeedStream(Purpose.ILLUMINANCE, self._step)
        sampler.seed(stream.seed(self._seed), count * len(index))
        self._step += 1
        si = receivers(self._points[index], self._normals[index], count)
        medium = medium_at(self._scene, si)
        light = emitter_light(self._scene, si, medium, sampler)
        summed = summed_part(self._scene, si, light)
        reached = light.unshadowed * light.through
        unshadowed = dr.select(summed, light.unshadowed, 0)
        found = [reached, unshadowed]
        if reflected:
            found.append(reflected_light(self._scene, si, medium, sampler))
        sampled = mi.UInt32(light.found & ~summed)
        dr.eval(*found, sampled)
        lux = [luminance(np.array(each).T).reshape(len(index), count) for each in found]
        some = np.array(sampled).reshape(len(index), count).max(axis=1) > 0
        return lux[0], lux[1], lux[2] if reflected else np.zeros((len(index), 1)), some

    def enclosed(self, index: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether receivers of an index [M], to which no light comes, are inside solids.

        The walls of a room may have their backs inside too. There paths find what the lamps light.
        """
        found = np.zeros(len(index), bool)
        for part in _chunks(np.arange(len(index)), _MIN_SAMPLES):
            found[part] = self._behind(index[part]) > _ENCLOSED
        for _ in range(_SEARCHES):
            for part in _chunks(np.flatnonzero(found), _MIN_SAMPLES):
                reached, _, reflected, _ = self.draw(index[part], _MIN_SAMPLES, reflected=True)
                found[part] = ~((reached > 0) | (reflected > 0)).any(axis=1)
        return found

    def _behind(self, index: NDArray[np.int64]) -> _Array:
        """Part [M] of the rays from receivers of an index [M] that end at backs of surfaces."""
        sampler = mi.load_dict({"type": "independent"})
        stream = SeedStream(Purpose.ILLUMINANCE, self._step, draw=3)
        sampler.seed(stream.seed(self._seed), _MIN_SAMPLES * len(index))
        self._step += 1
        si = receivers(self._points[index], self._normals[index], _MIN_SAMPLES)
        behind = behind_surfaces(self._scene, si, sampler)
        return np.array(behind).reshape(len(index), -1).mean(axis=1)


def _summed(
    scene: PathScene, points: _Array, normals: _Array, error: float, seed: int
) -> tuple[_Array, _Array]:
    """S [N], lx, and the variance of it; `error` as for `estimate`."""
    lamps = [each for each in scene.whole.emitters() if isinstance(each, DeferredEmitter)]
    if not lamps:
        return np.zeros(len(points)), np.zeros(len(points))
    sums, left, count = _Moments(len(points)), np.arange(len(points)), _SUMS
    step = 0
    while len(left) and count <= _MAX_SUMS:
        for index in _chunks(left, count):
            stream = SeedStream(Purpose.ILLUMINANCE, step, 1)
            si = receivers(points[index], normals[index], count)
            found = np.zeros((len(index), count))
            for number, lamp in enumerate(lamps):
                random = mi.PCG32(dr.width(si.p), stream.seed(seed, number))
                summed = lamp.is_summed(si.p, dr.full(mi.Bool, True, dr.width(si.p)))
                light = lamp.irradiance(si.p, mi.Vector3f(si.n), random, summed) & summed
                found += luminance(np.array(light).T).reshape(found.shape)
            sums.add(index, found)
            step += 1
        mean = np.maximum(sums.mean, FLOOR * sums.mean.mean())
        left = np.flatnonzero(sums.variance > (error * mean) ** 2)
        count *= 2
    return sums.mean, sums.variance


def _chunks(index: NDArray[np.int64], samples: int) -> list[NDArray[np.int64]]:
    """Parts of an index whose samples are few enough to be computed at once, none of them empty."""
    parts = np.array_split(index, max(1, -(-len(index) * samples // _AT_ONCE)))
    return [part for part in parts if len(part)]


def _ratio(a: Any, b: Any) -> Any:
    return np.divide(a, b, out=np.ones_like(a), where=b > 0)
