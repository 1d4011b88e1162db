"""Estimates of illuminance with standard errors, sampled until the errors are small enough.

A receiver is a point with a normal, in free space or on a surface. Its light comes straight from
emitters, by emitter sampling, or from surfaces and media, by paths as `lumitree_path` traces them.

Direct light from the light fields of baked luminaires is a sum over their cells (`S` below), which
holds where nothing of the scene shadows a receiver. Shadows are sampled, and so is the straight
light of luminaires with geometry, which their light fields do not give.

Symbols
    t   sample of direct illuminance, by emitter sampling
    w   the same sample without shadows, for baked luminaires whose light is summed; else 0
    S   mean of w, by summation, for each group of emitters
    c   coefficient of the control variate w, for each group of emitters
    y   t - c w + the sum of c S over all groups, with the same mean as t; c of t's group. Where
        nothing is shadowed, c = 1 and all samples are S; where everything is, c = 0 and all are 0
    r   sample of the light of surfaces and media

All emitters are one group, or, with `PathSums`, each placed lamp is one. Then the same samples also
give the light of each group. Samples are y = t - c w + c S for the group of t, and y = c S for all
others. The light of a path is summed by group before it is squared. So the spread of samples is the
error of each part, as of the total, and sums over groups are the total.

A rare event may not be in the samples yet, and then their variance is 0: the shadow of one lamp
among many, or light that comes through glass. So shadows and light that is not summed are counted
separately, and a rare event has a variance of its own until there are enough samples of it.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import as_rows, on_device, random_numbers
from lumitree.core.photometry import LUMENS_PER_WATT, luminance
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.rendering.emitter import lamps_of
from lumitree.rendering.integrator import (
    DEFAULT_RR_DEPTH,
    PathScene,
    PathState,
    trace_paths,
    visible,
)
from lumitree.rendering.layers import PathSums
from lumitree.rendering.proxies import NONE
from lumitree.rendering.sampling import OUTSIDE
from lumitree.trace import medium_paths
from lumitree.trace.spawning import spawn

# Samples that are computed at once, their values by group of emitters, and samples of a receiver in
# a pass: at most this number, or half as many as it has, so that few receivers need few passes.
_AT_ONCE, _MAX_BY_GROUP = 1 << 20, 1 << 24
_MIN_SAMPLES, _MAX_SAMPLES = 64, 4096
# Samples of a receiver that the first coefficients are estimated with; they are not used further.
_PILOT = 16
# Sums over the cells of light fields, each with other random points of the cells: the number at
# first, and at most at once. Their standard error is reduced to this part of the wanted error. With
# fewer sums at first, the variance would be underestimated at some points.
_SUMS, _MAX_SUMS, _SUM_PART = 16, 1 << 10, 0.3
# A dark receiver is inside a solid if this part of its rays ends at backs of surfaces. Some may
# not: a face of a solid may lie in a face of another, as the back of a cupboard in a wall.
_ENCLOSED = 0.1
# Samples in which light is searched for at such a receiver before it counts as inside.
_SEARCH = 1 << 12
# Events seen fewer than `_FEW` times have no usable variance estimate. A dark receiver gets
# `_UNSEEN` samples or more, and so do all receivers together while there is no light that is not
# summed; no receiver gets more than `_MAX_UNSEEN` samples for an event that was not seen.
_FEW, _UNSEEN, _MAX_UNSEEN = 8, 1 << 12, 1 << 14
# Relative difference of t and w without shadows, by the order of factors.
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
        by_lamp: direct, its error, reflected and its error [4, G, N] of each group of emitters, if
            the scene has `PathSums`.
    """

    direct: _Array
    direct_error: _Array
    total: _Array
    total_error: _Array
    samples: NDArray[np.int64]
    by_lamp: _Array | None


@dataclasses.dataclass(eq=False)
class _Samples:
    """K samples of each of M receivers.

    Attributes:
        t, w, r: [M, K], lx.
        sampled: [M, K], whether the emitter of t may light the receiver by light that is not
            summed.
        groups: number G of groups of emitters.
        group: [M, K] of the emitters of t; None if there is one.
        reflected: [G, M, K] parts of r by the groups of emitters; None unless they are estimated.
    """

    t: _Array
    w: _Array
    r: _Array
    sampled: NDArray[np.bool_]
    groups: int = 1
    group: NDArray[np.uint32] | None = None
    reflected: NDArray[np.float32] | None = None

    @functools.cached_property
    def _cells(self) -> NDArray[np.int64]:
        """Number of the group and the receiver of each sample."""
        assert self.group is not None
        count = len(self.group)
        return (self.group * np.int64(count) + np.arange(count)[:, None]).ravel()

    def sums(self, values: NDArray[Any]) -> NDArray[Any]:
        """Sums [G, M] of values [M, K] that belong to the emitters of t."""
        if self.group is None:
            return values.sum(axis=1)[None]
        cells = self.groups * len(values)
        return np.bincount(self._cells, values.ravel(), cells).reshape(self.groups, -1)

    def of_emitters(self, values: _Array) -> _Array:
        """Values [G, M] of groups for the emitter of each t: [M, K], or [M, 1] if G is 1."""
        if self.group is None:
            return values[0, :, None]
        return values.ravel()[self._cells].reshape(self.t.shape)


class _Moments:
    """Number, sums and sums of squares of samples, by receiver, or by group and receiver."""

    def __init__(self, *shape: int) -> None:
        self.number, self.hits, self.sum, self.squares = (np.zeros(shape) for _ in range(4))

    def add(self, at: Any, values: NDArray[np.floating]) -> None:
        """Add values [..., K] at an index."""
        squares, hits = (values**2).sum(axis=-1), np.count_nonzero(values, axis=-1)
        self.add_sums(at, values.shape[-1], values.sum(axis=-1), squares, hits)

    def add_sums(
        self, at: Any, number: int, values: _Array, squares: _Array, hits: NDArray[Any] | int = 0
    ) -> None:
        """Add sums over a number of values, of their squares, and the number that is not 0."""
        self.number[at] += number
        self.sum[at] += values
        self.squares[at] += squares
        self.hits[at] += hits

    @property
    def mean(self) -> _Array:
        return self.sum / np.maximum(self.number, 1)

    @property
    def variance(self) -> _Array:
        """Variance of the mean."""
        spread = np.maximum(self.squares - self.sum * self.mean, 0)
        return spread / np.maximum(self.number - 1, 1) / np.maximum(self.number, 1)

    @property
    def doubt(self) -> _Array:
        """Added to the variance for receivers with few samples that are not 0.

        Where light comes by rare paths, as through glass, the sample variance may be 0. With the
        doubt these receivers have the mean variance of all receivers.
        """
        variance = self.variance
        of_all = (variance * self.number).mean(axis=-1, keepdims=True) / np.maximum(self.number, 1)
        return np.where(self.hits < _FEW, np.maximum(of_all - variance, 0), 0)


class _Shadows:
    """Numbers of samples of summed lamps, of shadowed ones, and of those that arrived."""

    def __init__(self, groups: int, count: int) -> None:
        self._counts = np.zeros((3, groups, count))

    def add(self, index: NDArray[np.int64], samples: _Samples) -> None:
        t, w = samples.t, samples.w
        kinds = w > 0, (w > 0) & (t < (1 - _ROUNDING) * w), (w > 0) & (t > 0)
        for counts, kind in zip(self._counts, kinds, strict=True):
            counts[:, index] += samples.sums(kind)

    def doubt(self, summed: _Array) -> _Array:
        """Added to the variance where shadows, or the light between them, are rare.

        The n samples have about equal parts of S. The rarer kind counts as one sample more than was
        seen.

        Args:
            summed: S by group and receiver [G, N], or of all groups [N].
        """
        number, shadowed, lit = self._counts if summed.ndim > 1 else self._counts.sum(axis=1)
        rare, n = np.minimum(shadowed, lit), np.maximum(number, 1)
        return np.where(rare < _FEW, summed**2 * (rare + 1) / ((n + 2) * n), 0)


class _Control:
    """The coefficients of the control variate, from all samples so far, by group of emitters."""

    def __init__(self, groups: int, count: int) -> None:
        self._number = np.zeros(count)
        self._w, self._t, self._ww, self._tw = (np.zeros((groups, count)) for _ in range(4))

    def add(self, index: NDArray[np.int64], samples: _Samples) -> None:
        t, w = samples.t, samples.w
        self._number[index] += t.shape[1]
        products = (w, t, w * w, t * w)
        sums = (self._w, self._t, self._ww, self._tw)
        for total, product in zip(sums, products, strict=True):
            total[:, index] += samples.sums(product)

    def coefficient(self, index: NDArray[np.int64]) -> _Array:
        """c [G, M]: the covariance of t and w over the variance of w; t over w if w is constant.

        Groups without samples have the ratio of all.
        """
        n = self._number[index]
        w, t, squares, products = (
            sums[:, index] for sums in (self._w, self._t, self._ww, self._tw)
        )
        variance, covariance = squares - w * w / n, products - t * w / n
        ratio = np.empty_like(w)
        ratio[:] = _ratio(products.sum(axis=0), squares.sum(axis=0))
        np.divide(products, squares, out=ratio, where=squares > 0)
        np.divide(covariance, variance, out=ratio, where=variance > 1e-9 * squares)
        return np.clip(ratio, 0, 1)


class _LampLight:
    """Direct and reflected light by group of emitters and receiver [G, N].

    The direct light of a sample comes from one group; t and w of all others are 0. So moments of y
    follow from sums over the samples of each group, without an array for all groups and samples.
    """

    def __init__(self, groups: int, count: int) -> None:
        self._direct, self._others, self._reflected = (_Moments(groups, count) for _ in range(3))

    def add(
        self,
        index: NDArray[np.int64],
        samples: _Samples,
        known: _Array,
        found: _Array,
        other: _Array,
    ) -> None:
        """Add samples of the receivers of an index [M].

        Args:
            known: c S [G, M].
            found: t - c w [M, K].
            other: t [M, K] that is not summed.
        """
        at, number = (slice(None), index), samples.t.shape[1]
        sums, squares = samples.sums(found), samples.sums(found**2)
        squares += known * (2 * sums + number * known)
        self._direct.add_sums(at, number, sums + number * known, squares)
        self._others.add_sums(
            at, number, samples.sums(other), samples.sums(other**2), samples.sums(other != 0)
        )
        if samples.reflected is not None:
            self._reflected.add(at, samples.reflected)

    def variances(self, by_samples: NDArray[np.bool_], shared: _Array) -> tuple[_Array, _Array]:
        """Variances of direct and reflected light.

        Args:
            by_samples: whether light may come that is not summed.
            shared: variance of the direct light beside the variance of the samples.
        """
        direct = self._direct.variance + by_samples * self._others.doubt + shared
        return direct, self._reflected.variance + self._reflected.doubt

    def estimate(self, by_samples: NDArray[np.bool_], shared: _Array) -> _Array:
        """Direct, its error, reflected and its error [4, G, N]; arguments as of `variances`."""
        errors = map(np.sqrt, self.variances(by_samples, shared))
        direct, reflected = zip((self._direct.mean, self._reflected.mean), errors, strict=True)
        return np.stack([*direct, *reflected])


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
        scene: with an emitter; with `PathSums`, the light of their groups is estimated too.
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
    groups = len(summed)
    control, direct, total = _Control(groups, count), _Moments(count), _Moments(count)
    # Light that is not summed: its direct part, and all of it.
    others, rest, shadows = _Moments(count), _Moments(count), _Shadows(groups, count)
    lamps = _LampLight(groups, count) if isinstance(scene.layers, PathSums) else None
    sampler = _Sampler(scene, points, normals, seed)
    for index in _chunks(everyone, _PILOT, groups):
        drawn = sampler.draw(index, _PILOT, reflected=False)
        control.add(index, drawn)
        shadows.add(index, drawn)
    left, samples, share = everyone, _MIN_SAMPLES, 0.0
    largest, by_samples = np.zeros((groups, count)), np.zeros((groups, count), bool)
    unsure, inside, searched = np.zeros(count), np.zeros(count, bool), False
    with progress("illuminance", 1.0) as advance:
        while len(left):
            for index in _chunks(left, samples, groups):
                drawn = sampler.draw(index, samples, reflected=reflected)
                c = control.coefficient(index)
                known, found = c * summed[:, index], drawn.t - drawn.of_emitters(c) * drawn.w
                y = known.sum(axis=0)[:, None] + found
                other = np.where(drawn.w > 0, 0, drawn.t)
                direct.add(index, y)
                total.add(index, y + drawn.r)
                others.add(index, other)
                rest.add(index, other + drawn.r)
                if lamps is not None:
                    lamps.add(index, drawn, known, found, other)
                control.add(index, drawn)
                shadows.add(index, drawn)
                largest[:, index] = np.maximum(largest[:, index], c)
                by_samples[:, index] |= drawn.sums(drawn.sampled) > 0
            mean, sampled = total.mean, total.variance
            unsure = rest.doubt if reflected else by_samples.any(axis=0) * others.doubt
            variance = sampled + unsure + shadows.doubt(summed.sum(axis=0))
            # More samples do not help where one was infinite.
            lost = ~np.isfinite(variance)
            level = mean[~lost].mean() if not lost.all() else 0.0
            goal = (error * np.maximum(mean, FLOOR * level)) ** 2
            unseen, number = total.hits == 0, total.number
            enough = (variance <= goal) & (~unseen | (number >= _UNSEEN))
            if not rest.hits.any():
                enough &= number.sum() >= _UNSEEN
            if lamps is not None:
                # A part counts where another lamp is brighter, too.
                parts = sum(lamps.variances(by_samples, shadows.doubt(summed)))
                enough &= np.max(parts, axis=0) <= np.minimum(goal, (error * level) ** 2)
            # Samples for doubt are limited.
            enough |= (sampled <= goal) & (number >= _MAX_UNSEEN)
            if not searched:
                # After the first pass: else they would get the most samples of all.
                dark, searched = np.flatnonzero(total.mean == 0), True
                inside[dark] = sampler.enclosed(dark)
            left = np.flatnonzero(~enough & ~lost & ~inside)
            part = np.where(lost | inside, 1, _ratio(goal, np.maximum(goal, variance)))
            done = float(part.mean())
            spent = time.perf_counter() - start
            if seconds is not None:
                done = max(done, min(1.0, spent / seconds))
                if spent >= seconds:
                    left = left[:0]
            advance(max(0.0, done - share), f"{len(left):,} points left")
            share = max(share, done)
            most = max(_MAX_SAMPLES, int(number[left].min(initial=_AT_ONCE)) // 2)
            samples = int(np.clip(_AT_ONCE // max(len(left), 1), _MIN_SAMPLES, most))
    # Samples share the error of S.
    shared = (largest**2 * summed_variance).sum(axis=0) + shadows.doubt(summed.sum(axis=0))
    unknown_inside = np.where(inside, np.nan, 1)
    by_lamp = None
    if lamps is not None:
        of_lamps = largest**2 * summed_variance + shadows.doubt(summed)
        by_lamp = unknown_inside * lamps.estimate(by_samples, of_lamps)
    doubt = by_samples.any(axis=0) * others.doubt
    return Estimate(
        unknown_inside * direct.mean,
        unknown_inside * np.sqrt(direct.variance + doubt + shared),
        unknown_inside * total.mean,
        unknown_inside * np.sqrt(total.variance + unsure + shared),
        total.number.astype(np.int64),
        by_lamp,
    )


class _Sampler:
    """Samples of the illuminance of receivers, pass by pass."""

    def __init__(self, scene: PathScene, points: _Array, normals: _Array, seed: int) -> None:
        self._scene, self._points, self._normals, self._seed = scene, points, normals, seed
        self._sums = scene.layers if isinstance(scene.layers, PathSums) else None
        self._step = 0
        self._groups = 1 if self._sums is None else self._sums.groups.count

    def draw(self, index: NDArray[np.int64], count: int, *, reflected: bool) -> _Samples:
        """Samples of the receivers of an index [M], `count` of each."""
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
        found, sampled = [reached, unshadowed], mi.UInt32(light.found & ~summed)
        shape, sums, group = (len(index), count), self._sums, mi.UInt32(0)
        if sums is not None:
            group = sums.groups.of(light.emitter, light.found)
            sums.clear(count * len(index) if reflected else 0)
        if reflected:
            found.append(reflected_light(self._scene, si, medium, sampler))
        dr.eval(*found, sampled, group, () if sums is None else sums.sums)
        t, w, *r = (luminance(np.array(each).T).reshape(shape) for each in found)
        samples = _Samples(
            t, w, r[0] if r else np.zeros((len(index), 1)), np.array(sampled).reshape(shape) > 0
        )
        if sums is not None:
            samples.groups, samples.group = sums.groups.count, np.array(group).reshape(shape)
            if reflected:
                samples.reflected = np.array(sums.sums).reshape(-1, *shape)
                samples.reflected *= math.pi * LUMENS_PER_WATT
        return samples

    def enclosed(self, index: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether dark receivers of an index [M] are inside solids.

        The walls of a room may have their backs inside too. There paths find lit surfaces.
        """
        found = np.zeros(len(index), bool)
        for part in _chunks(np.arange(len(index)), _MIN_SAMPLES):
            found[part] = self._behind(index[part]) > _ENCLOSED
        for part in _chunks(np.flatnonzero(found), _SEARCH, self._groups):
            drawn = self.draw(index[part], _SEARCH, reflected=True)
            found[part] = ~((drawn.t > 0) | (drawn.r > 0)).any(axis=1)
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
    """S [G, N] of each group of emitters, lx, and its variance; `error` as for `estimate`."""
    lamps = lamps_of(scene.whole.emitters())
    groups, group_of = 1, np.zeros(len(scene.whole.emitters()), np.uint32)
    if isinstance(scene.layers, PathSums):
        groups, group_of = scene.layers.groups.count, scene.layers.groups.of_emitters
    sums = _Moments(groups, len(points))
    left, count, step = np.arange(len(points)), _SUMS, 0
    while lamps and len(left) and count <= _MAX_SUMS:
        for index in _chunks(left, count, groups):
            stream = SeedStream(Purpose.ILLUMINANCE, step, 1)
            si = receivers(points[index], normals[index], count)
            found: dict[int, _Array] = {}
            for number, (emitter, lamp) in enumerate(lamps.items()):
                random = random_numbers(dr.width(si.p), stream.seed(seed, number))
                summed = lamp.is_summed(si.p, dr.full(mi.Bool, True, dr.width(si.p)))
                light = lamp.irradiance(si.p, mi.Vector3f(si.n), random, summed) & summed
                lux = luminance(as_rows(light)).reshape(len(index), count)
                group = int(group_of[emitter])
                found[group] = found.get(group, 0) + lux
            for group, lux in found.items():
                sums.add((group, index), lux)
            step += 1
        # Lamps have other random points each, so their variances add.
        mean, variance = sums.mean.sum(axis=0), sums.variance.sum(axis=0)
        left = np.flatnonzero(variance > (error * np.maximum(mean, FLOOR * mean.mean())) ** 2)
        count *= 2
    return sums.mean, sums.variance


def _chunks(index: NDArray[np.int64], samples: int, groups: int = 1) -> list[NDArray[np.int64]]:
    """Parts of an index, none empty, whose samples are few enough to be computed at once.

    Each sample may have a value for each group of emitters.
    """
    at_once = min(_AT_ONCE, max(1, _MAX_BY_GROUP // groups))
    parts = np.array_split(index, max(1, -(-len(index) * samples // at_once)))
    return [part for part in parts if len(part)]


def _ratio(a: Any, b: Any) -> Any:
    return np.divide(a, b, out=np.ones_like(a), where=b > 0)


@dataclasses.dataclass
class EmitterLight:
    """Irradiance by one sampled direction of one sampled emitter (a PyTree of Dr.Jit)."""

    # fmt: off
    emitter: mi.EmitterPtr
    unshadowed: mi.Spectrum  # Irradiance without shadows
    through: mi.Spectrum     # Transmittance of the shadow ray
    found: mi.Bool           # Whether there is any light
    stored: mi.Bool          # Whether it comes from a light field, for a receiver outside the box
    # fmt: on


def receivers(
    points: NDArray[np.floating], normals: NDArray[np.floating], count: int
) -> mi.SurfaceInteraction3f:
    """Receivers on the device, each `count` times in succession.

    Args:
        points: [N, 3].
        normals: [N, 3], of any length.
    """
    place = [np.repeat(each, count, axis=0) for each in (points, normals)]
    si = dr.zeros(mi.SurfaceInteraction3f, len(points) * count)
    si.p = on_device(mi.Point3f, place[0])
    si.n = dr.normalize(on_device(mi.Vector3f, place[1]))
    si.sh_frame = mi.Frame3f(si.n)
    return si


def medium_at(scene: PathScene, si: mi.SurfaceInteraction3f) -> mi.MediumPtr:
    """Medium that receivers are in: at the first border along their normals, on this side."""
    if not scene.has_media:
        return dr.zeros(mi.MediumPtr, dr.width(si.p))
    owners = scene.divided.owners

    def is_border(hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        # The glass of a placed lamp does not state the medium around it.
        return hit.is_medium_transition() & (owners.of(hit.shape, active) == NONE)

    ray = spawn(si, mi.Vector3f(si.n), scene.extent)
    return medium_paths.medium_around(scene.divided.surfaces, ray, scene.extent, is_border)


def emitter_light(
    scene: PathScene,
    si: mi.SurfaceInteraction3f,
    medium: mi.MediumPtr,
    sampler: mi.Sampler,
    bsdf_pdf: float = 0,
) -> EmitterLight:
    """Irradiance by emitter sampling, of receivers in `medium`, see `medium_at`.

    `bsdf_pdf` is the density per steradian and cosine of another strategy that samples directions,
    for multiple importance sampling; 0 if there is none.
    """
    active = dr.full(mi.Bool, True, dr.width(si.p))
    # Lamps are selected by their unshadowed light: a shadowed lamp may give most of it.
    n = mi.Vector3f(si.n)
    selected = scene.selection.sample(si, n, mi.UInt32(NONE), sampler, active)
    active &= selected.weight > 0
    emitter = scene.emitter(selected.index, active)
    sample, own = selected.sample, mi.Bool(False)
    sampled = scene.lamps.call("sample_target", emitter, si, n, sample, own, active)
    ds = sampled.ds
    cosine = dr.maximum(dr.dot(si.n, ds.d), 0)
    found = active & sampled.valid & (cosine > 0)
    through = visible(scene, si, ds, sampled.beyond, selected.index, medium, found)
    weight = scene.lamps.call(
        "eval_target", emitter, si, sampled, cosine * bsdf_pdf, selected.emitter_pmf, found
    )
    light = dr.select(found, weight * (cosine * selected.weight), 0)
    return EmitterLight(emitter, light, through, found, sampled.target.place == OUTSIDE)


def behind_surfaces(scene: PathScene, si: mi.SurfaceInteraction3f, sampler: mi.Sampler) -> mi.Bool:
    """Whether a ray in a random direction ends at the back of a surface, as all do in a solid."""
    direction = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    # As rays of `reflected_light`: the receiver may be on a surface.
    start = spawn(si, mi.Vector3f(si.n), scene.extent).o
    hit = scene.divided.surfaces.ray_intersect(mi.Ray3f(start, direction))
    return hit.is_valid() & (dr.dot(hit.n, direction) > 0)


def summed_part(scene: PathScene, si: mi.SurfaceInteraction3f, light: EmitterLight) -> mi.Bool:
    """Whether the emitter's irradiance is known without sampling directions."""
    return light.stored & scene.lamps.call("is_summed", light.emitter, si.p, light.found)


def reflected_light(
    scene: PathScene, si: mi.SurfaceInteraction3f, medium: mi.MediumPtr, sampler: mi.Sampler
) -> mi.Spectrum:
    """Irradiance by one path of light from surfaces and media, of any length."""
    local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    # A ray along the surface has no density, and brings nothing.
    ray = spawn(si, si.to_world(local), scene.extent)
    path = PathState.received(mi.Interaction3f(si), ray, medium, local.z > 0)
    radiance, _, _ = trace_paths(scene, path, sampler, -1, DEFAULT_RR_DEPTH)
    return math.pi * radiance
