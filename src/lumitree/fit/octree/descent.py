"""Gradient descent on the leaves of an octree with fresh, noisy rays, within a budget.

The gradient of the loss is linear in the target, so its noise averages out over rays and steps
(noise2noise): every step draws new rays instead of stored ones. For the same reason rays and light
paths may bring different parts of the target (see `rays.Rays`).

Symbols
    L, T        radiance / L_max and transmittance of the field along a ray
    l, t        noisy estimates of L and T of the luminaire
    loss        mean of D(L + epsilon, l + epsilon) + opacity_weight (T - t)², where
                D(x, y) = x - y log x is the Poisson deviance without the terms that do not depend
                on x: at its minimum x and y agree in sum, so that the field has the flux of the
                luminaire. Relative squared errors (Eq. 8) agree in another sum.
"""

from __future__ import annotations

import dataclasses
import math
import time

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.checkpoint import Arrays, Checkpoint
from lumitree.core.device import on_device, parameter
from lumitree.core.interruption import Interruption
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.octree.calibration import calibrate
from lumitree.fit.octree.config import (
    TILE_RAYS,
    HeldOutConfig,
    OctreeConfig,
    RefineConfig,
    SplitConfig,
)
from lumitree.fit.octree.leaf_field import (
    LEAVES,
    OPAQUE_DEPTH,
    LeafField,
    accumulate_by_weight,
    depth_gradient,
    gradients,
)
from lumitree.fit.octree.rays import RaySource
from lumitree.octree.build import child_cells


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
        origin, direction: local frame.
        first, second: a and b.
    """

    origin: mi.Point3f
    direction: mi.Vector3f
    first: mi.Color3f
    second: mi.Color3f
    transmittance: mi.Float

    @staticmethod
    def trace(source: RaySource, max_radiance: float, config: HeldOutConfig) -> HeldOut:
        """Rays that no step of a bake draws."""
        pairs = source.draw_pairs(config.rays, SeedStream(Purpose.HELD_OUT), config.paths)
        scale = parameter(mi.Float, 1 / max_radiance)
        a, b = (dr.minimum(value * scale, 1) for value in (pairs.first, pairs.second))
        return HeldOut(pairs.origin, pairs.direction, a, b, pairs.transmittance)

    def rescaled(self, factor: float) -> HeldOut:
        """The same for an L_max `factor` times as large; clipped values stay clipped."""
        scale = parameter(mi.Float, 1 / factor)
        a, b = (dr.minimum(value * scale, 1) for value in (self.first, self.second))
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


class Refiner:
    """A field being refined, with the state of its optimiser, after `step` steps."""

    def __init__(
        self,
        field: LeafField,
        source: RaySource,
        max_radiance: float,
        config: RefineConfig,
        splitting: SplitConfig,
    ) -> None:
        self.field, self.step = field, 0
        self._source, self._config, self._splitting = source, config, splitting
        self._max_radiance = max_radiance
        decays = config.mean_decay, config.square_decay
        self._density_adam = Adam(field.num_leaves, *decays)
        self._coefficient_adam = Adam(field.num_leaves * field.width, *decays)

    def advance(self, progress: float) -> int:
        """One step at `progress` in [0, 1] of the budget; returns the number of rays used."""
        field, config = self.field, self._config
        self.step += 1
        rays = self._source.draw(
            config.rays,
            SeedStream(Purpose.REFINEMENT, self.step),
            field.meets,
            config.light_paths_per_ray,
        )
        origin, direction, transmittance = self._source.draw_opacity(
            config.opacity_rays_per_ray * config.rays,
            SeedStream(Purpose.STRAIGHT, self.step),
            field.meets,
        )
        num_rays, num_opacity_rays = dr.width(rays.origin), dr.width(origin)
        if num_rays == 0 or num_opacity_rays == 0:
            return num_rays + num_opacity_rays
        integrated = field.integrate(rays.origin, rays.direction)
        radiance, through, _ = integrated
        dr.eval(integrated)
        weight = dr.rcp(radiance + config.epsilon)
        light = rays.light * parameter(mi.Float, 1 / self._max_radiance)
        # Rays of both kinds contribute to the mean of the opacity's loss.
        part = 1 / (1 + config.opacity_rays_per_ray)
        d_density, d_coefficients = gradients(
            field,
            rays.origin,
            rays.direction,
            integrated,
            weight * (rays.share * radiance - light),
            part * rays.share * self._opacity_slope(through, rays.transmittance),
        )
        through = field.through(origin, direction)
        share = parameter(mi.Float, (1 - part) / num_opacity_rays)
        d_depth = share * self._opacity_slope(through, transmittance)
        dr.eval(d_depth)
        d_density += depth_gradient(field, origin, direction, d_depth)
        decay = config.final_rate ** min(progress, 1.0)
        opaque = math.log(OPAQUE_DEPTH / 2) + field.device_levels * math.log(2)
        field.log_density = dr.minimum(
            self._density_adam.descend(field.log_density, d_density, decay * config.density_rate),
            opaque,
        )
        field.coefficients = self._coefficient_adam.descend(
            field.coefficients, d_coefficients, decay * config.coefficient_rate
        )
        dr.eval(field.log_density, field.coefficients)
        if self.step % config.smoothing_interval == 0:
            field.smooth(decay * config.smoothing)
        return num_rays + num_opacity_rays

    def _opacity_slope(self, through: mi.Float, target: mi.Float) -> mi.Float:
        """Derivative of the opacity's loss by the optical depth of rays of transmittance T."""
        # Where the linear law is saturated, its derivative is 0 and no leaf could become thinner:
        # the one of tau is used instead.
        slope = through if self.field.law == "exponential" else 1
        return 2 * self._config.opacity_weight * (target - through) * slope

    def prune(self) -> None:
        """Drop the leaves whose opacity is negligible in every direction."""
        depth = np.exp(np.array(self.field.log_density)) * 2.0 ** (1 - self.field.levels)
        kept = np.flatnonzero(depth >= self._splitting.min_optical_depth)
        if len(kept):
            self._rebuild(kept, self.field.cells[kept], self.field.levels[kept])

    def split(self, deepest: int) -> None:
        """Split the leaves above level `deepest` that account for most of the error.

        As many as `max_leaves` allows, those with the largest error first; children start with
        their parent's values.
        """
        field, config = self.field, self._splitting
        error = self._error_indicator()
        error[field.levels >= deepest] = 0
        order = np.argsort(-error)
        enough = np.searchsorted(np.cumsum(error[order]), config.covered_error * error.sum()) + 1
        allowed = max(0, (config.max_leaves - field.num_leaves) // 7)
        chosen = np.zeros(field.num_leaves, bool)
        chosen[order[: min(enough, allowed)]] = True
        chosen &= error > 0
        whole, parents = np.flatnonzero(~chosen), np.flatnonzero(chosen)
        self._rebuild(
            np.concatenate([whole, np.repeat(parents, 8)]),
            np.concatenate([field.cells[whole], child_cells(field.cells[parents]).reshape(-1, 3)]),
            np.concatenate([field.levels[whole], np.repeat(field.levels[parents] + 1, 8)]),
        )

    def _error_indicator(self) -> NDArray[np.float32]:
        """Per-leaf error indicator [M]: errors of rays, accumulated by the leaves' weights."""
        field, config = self.field, self._splitting
        indicator = dr.zeros(mi.Float, field.num_leaves)
        for batch in range(config.indicator_batches):
            stream = SeedStream(Purpose.ERROR_INDICATOR, self.step, batch)
            pairs = self._source.draw_pairs(config.indicator_rays, stream, 1)
            radiance, through, _ = field.integrate(pairs.origin, pairs.direction)
            scale = parameter(mi.Float, 1 / self._max_radiance)
            # The product of two independent errors: noise causes no bias.
            square = (radiance - pairs.first * scale) * (radiance - pairs.second * scale)
            error = dr.sum(square * dr.rcp(dr.square(radiance + self._config.epsilon)))
            error += config.indicator_opacity_weight * dr.square(through - pairs.transmittance)
            dr.eval(error)
            indicator += accumulate_by_weight(field, pairs.origin, pairs.direction, error)
            dr.eval(indicator)
        return np.maximum(np.array(indicator), 0)

    def _rebuild(
        self, origin: NDArray[np.int64], cells: NDArray[np.int64], levels: NDArray[np.int64]
    ) -> None:
        """Make a field of new leaves; leaf i takes the values of the former leaf `origin[i]`."""
        index = on_device(mi.UInt32, origin)
        width = self.field.width
        wide = dr.repeat(index, width) * width + dr.tile(dr.arange(mi.UInt32, width), len(origin))
        self.field = self.field.with_leaves(
            cells,
            levels,
            dr.gather(mi.Float, self.field.log_density, index),
            dr.gather(mi.Float, self.field.coefficients, wide),
        )
        self._density_adam.take(index)
        self._coefficient_adam.take(wide)

    def state(self) -> Arrays:
        """The field and the state of the optimiser as arrays, for `restore`."""
        field, density, coefficients = self.field, self._density_adam, self._coefficient_adam
        return field.arrays() | {
            "density_mean": np.array(density.mean),
            "density_square": np.array(density.square),
            "coefficient_mean": np.array(coefficients.mean),
            "coefficient_square": np.array(coefficients.square),
            "steps": np.array([self.step, density.steps]),
        }

    def restore(self, state: Arrays) -> None:
        """Continue from a former `state`."""
        self.field = self.field.with_leaves(*(state[name] for name in LEAVES))
        density, coefficients = self._density_adam, self._coefficient_adam
        density.mean = on_device(mi.Float, state["density_mean"])
        density.square = on_device(mi.Float, state["density_square"])
        coefficients.mean = on_device(mi.Float, state["coefficient_mean"])
        coefficients.square = on_device(mi.Float, state["coefficient_square"])
        self.step = int(state["steps"][0])
        density.steps = coefficients.steps = int(state["steps"][1])


class Adam:
    """Adam's moments of one flat array; the decays are beta_1 and beta_2 of Kingma and Ba 2015."""

    def __init__(self, size: int, mean_decay: float, square_decay: float) -> None:
        self._decays = mean_decay, square_decay
        self.mean, self.square = dr.zeros(mi.Float, size), dr.zeros(mi.Float, size)
        self.steps = 0

    def descend(self, values: mi.Float, gradient: mi.Float, rate: float) -> mi.Float:
        """The values after one step."""
        self.steps += 1
        beta_1, beta_2 = self._decays
        # Opaque, or every step would compile another kernel.
        step = parameter(mi.Float, rate / (1 - beta_1**self.steps))
        correction = parameter(mi.Float, 1 / (1 - beta_2**self.steps))
        self.mean = beta_1 * self.mean + (1 - beta_1) * gradient
        self.square = beta_2 * self.square + (1 - beta_2) * dr.square(gradient)
        moved = values - step * self.mean / (dr.sqrt(self.square * correction) + 1e-15)
        dr.eval(self.mean, self.square, moved)
        return moved

    def take(self, index: mi.UInt32) -> None:
        """Keep the moments of some elements, in their order."""
        self.mean = dr.gather(mi.Float, self.mean, index)
        self.square = dr.gather(mi.Float, self.square, index)
        dr.eval(self.mean, self.square)


class Budget:
    """Time and rays that a bake has spent, in this run and in those that it continues.

    Args:
        config: the budget.
        seconds, rays: spent by earlier runs.

    Attributes:
        rays: rays of the descent so far.
        reserved: seconds that are kept for what follows the descent.
    """

    def __init__(self, config: OctreeConfig, seconds: float, rays: int) -> None:
        self._config, self._earlier, self.rays = config, seconds, rays
        self._start = time.monotonic()
        self.reserved = 0.0

    @property
    def seconds(self) -> float:
        """Seconds so far."""
        return self._earlier + time.monotonic() - self._start

    @property
    def is_over(self) -> bool:
        """Whether the time is spent, also what is reserved; False without a limit of time."""
        return self._config.time is not None and self.seconds >= self._config.time

    @property
    def progress(self) -> float:
        """Share of the budget that is spent, 1 when it is all."""
        shares = [0.0]
        if self._config.time is not None:
            shares.append((self.seconds + self.reserved) / self._config.time)
        if self._config.rays is not None:
            shares.append(self.rays / self._config.rays)
        return min(max(shares), 1.0)


class Descent:
    """The descent of one bake; `best` is the field with the highest rank of its score."""

    def __init__(
        self,
        refiner: Refiner,
        best: LeafField,
        source: RaySource,
        max_radiance: float,
        held_out: HeldOut,
        budget: Budget,
        config: OctreeConfig,
        checkpoint: Checkpoint,
    ) -> None:
        self._refiner, self._source, self._max_radiance = refiner, source, max_radiance
        self._held_out, self._budget, self._config = held_out, budget, config
        self._checkpoint = checkpoint
        self.best, self.best_score = best.copy(), held_out.score(best)

    def run(self, name: str, interruption: Interruption) -> None:
        """Refine until the budget is spent or `interruption` is set, and save the state.

        Args:
            name: of the task, for the progress that is shown.
        """
        schedule = self._config.schedule
        done = self._budget.progress
        with progress(name, 1.0, done) as advance:
            while done < 1 and not interruption:
                self._budget.rays += self._refiner.advance(done)
                before, done = done, self._budget.progress
                self._restructure(before, done)
                if _passes(schedule.score_interval, before, done):
                    self.keep_better(self._refiner.field)
                self._checkpoint.offer(self.state)
                advance(
                    done - before, f"{self.best_score}, {self._refiner.field.num_leaves} leaves"
                )
        # The calibration that follows can be repeated from here, without the descent. Saved first:
        # where a signal ended the descent, the bake that continues would not keep this field.
        self.save()
        self.keep_better(self._refiner.field)

    def keep_better(self, field: LeafField) -> None:
        """Make a field the best so far, if it is."""
        score = self._held_out.score(field)
        if score.rank >= self.best_score.rank:
            self.best, self.best_score = field.copy(), score

    def save(self) -> None:
        """Save the state."""
        self._checkpoint.try_save(self.state())

    def state(self) -> Arrays:
        """The refiner's state, the best field, and what was spent, as arrays."""
        spent = {"seconds": self._budget.seconds, "rays": self._budget.rays}
        numbers = {**spent, "max_radiance": self._max_radiance}
        best = {f"best_{name}": value for name, value in self.best.arrays().items()}
        return {
            **self._refiner.state(),
            **best,
            **{name: np.array(value) for name, value in numbers.items()},
        }

    def _restructure(self, before: float, done: float) -> None:
        """When it is time, drop and calibrate leaves, and split some of them by one level."""
        schedule, refiner = self._config.schedule, self._refiner
        if not _passes(schedule.split_interval, before, done) or done > schedule.last_split:
            return
        refiner.prune()
        start = time.monotonic()
        stream = SeedStream(Purpose.CALIBRATION, refiner.step)
        calibrate(refiner.field, self._source, self._max_radiance, self._config.calibration, stream)
        self._budget.reserved = schedule.closing_calibrations * (time.monotonic() - start)
        deepest = int(refiner.field.levels.max())
        if deepest < self._config.tree_depth and self._budget.progress < 1:
            refiner.split(deepest + 1)


def _passes(interval: float, before: float, done: float) -> bool:
    """Whether a multiple of `interval` lies between two shares of the budget."""
    return int(done / interval) > int(before / interval)
