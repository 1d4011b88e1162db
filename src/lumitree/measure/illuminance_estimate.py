"""Estimates of illuminance with standard errors, sampled until the errors are small enough.

A receiver is a point with a normal, in free space or on a surface. Its light comes straight from
emitters, by emitter sampling, or from surfaces and media, by paths as `lumitree_path` traces them.

Direct light from the light fields of baked luminaires is a sum over their cells (`S` below), which
holds where nothing of the scene shadows a receiver. Shadows are sampled, and so is the straight
light of luminaires with geometry, which their light fields do not give.

Symbols
    t   sample of direct illuminance, by emitter sampling
    w   the same sample without shadows, for baked luminaires whose light is summed; else 0
    S   mean of w, by summation
    c   coefficient of the control variate w
    y   t + c (S - w), with the same mean as t. Where nothing is shadowed, c = 1 and all samples are
        S; where everything is, c = 0 and all are 0
    r   sample of the light of surfaces and media

A rare event may not be in the samples yet, and then their variance is 0: the shadow of one lamp
among many, or light that comes through glass. So shadows and light that is not summed are counted
separately, and a rare event has a variance of its own until there are enough samples of it.
"""

from __future__ import annotations

import dataclasses
import math
import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device
from lumitree.core.photometry import luminance
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
from lumitree.rendering.proxies import NONE
from lumitree.rendering.sampling import OUTSIDE
from lumitree.trace import medium_paths
from lumitree.trace.spawning import spawn

# Samples that are computed at once, and of a receiver in a pass.
_AT_ONCE = 1 << 20
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
# Passes in which light is searched for at such a receiver before it counts as inside.
_SEARCHES = 16
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

        Where light comes by rare paths, as through glass, the sample variance may be 0. With the
        doubt these receivers have the mean variance of all receivers.
        """
        variance = self.variance
        of_all = (variance * self.number).mean() / self.number
        return np.where(self.hits < _FEW, np.maximum(of_all - variance, 0), 0)


class _Shadows:
    """Numbers of samples of summed lamps that were shadowed, and that reached the receiver."""

    def __init__(self, count: int) -> None:
        self._number, self._shadowed, self._lit = (np.zeros(count, np.int64) for _ in range(3))

    def add(self, index: NDArray[np.int64], t: _Array, w: _Array) -> None:
        self._number[index] += np.count_nonzero(w > 0, axis=1)
        self._shadowed[index] += np.count_nonzero((w > 0) & (t < (1 - _ROUNDING) * w), axis=1)
        self._lit[index] += np.count_nonzero((w > 0) & (t > 0), axis=1)

    def doubt(self, summed: _Array) -> _Array:
        """Added to the variance where shadows, or the light between them, are rare.

        The n samples have about equal parts of S. The rarer kind counts as one sample more than was
        seen.
        """
        rare = np.minimum(self._shadowed, self._lit)
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
        """c [M]: the covariance of t and w over the variance of w; t over w if w is constant."""
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
    # Light that is not summed: its direct part, and all of it.
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
            mean, known = total.mean, total.variance
            unsure = rest.doubt if reflected else by_samples * others.doubt
            variance = known + unsure + shadows.doubt(summed)
            # More samples do not help where one was infinite.
            lost = ~np.isfinite(variance)
            level = mean[~lost].mean() if not lost.all() else 0.0
            goal = (error * np.maximum(mean, FLOOR * level)) ** 2
            unseen, number = total.hits == 0, total.number
            enough = (variance <= goal) & (~unseen | (number >= _UNSEEN))
            if not rest.hits.any():
                enough &= number.sum() >= _UNSEEN
            # Samples for doubt are limited.
            enough |= (known <= goal) & (number >= _MAX_UNSEEN)
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
    unknown_inside = np.ones(count)
    unknown_inside[dark[sampler.enclosed(dark)]] = np.nan
    return Estimate(
        unknown_inside * direct.mean,
        unknown_inside * np.sqrt(direct.variance + by_samples * others.doubt + shared),
        unknown_inside * total.mean,
        unknown_inside * np.sqrt(total.variance + unsure + shared),
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
        """Whether dark receivers of an index [M] are inside solids.

        The walls of a room may have their backs inside too. There paths find lit surfaces.
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
    """S [N], lx, and its variance; `error` as for `estimate`."""
    lamps = list(lamps_of(scene.whole.emitters()).values())
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
    """Parts of an index, none empty, whose samples are few enough to be computed at once."""
    parts = np.array_split(index, max(1, -(-len(index) * samples // _AT_ONCE)))
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
    selected = scene.selection.sample(si, mi.Vector3f(si.n), mi.UInt32(NONE), sampler, active)
    active &= selected.weight > 0
    emitter = scene.emitter(selected.index, active)
    sample = selected.sample
    sampled = scene.lamps.call("sample_target", emitter, si, sample, mi.Bool(False), active)
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
