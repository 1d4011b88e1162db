"""Gradient descent on the leaves of an octree with fresh, noisy rays.

The gradient of the loss is linear in the target, so its noise averages out over rays and steps
(noise2noise): every step draws new rays instead of looking at stored pictures. For the same reason
lines, and light from the emitters, may bring in different parts of it (see `Rays`).

Symbols
    L, T        radiance / L_max and transmittance of the field along a ray
    l, t        what the ray should show, noisy
    loss        mean of D(L + epsilon, l + epsilon) + opacity_weight (T - t)², where
                D(x, y) = x - y log x is the Poisson deviance but for what does not depend on x:
                where it has no slope x and y agree in sum, so that the field gives as much light
                as the luminaire. Relative squared errors (Eq. 8) agree in another sum
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.direct.balance import balance
from lumitree.direct.estimate import OPAQUE, split
from lumitree.direct.leaf_field import LEAVES, LeafField
from lumitree.direct.ray_source import TILE_LINES, RaySource
from lumitree.errors import LumitreeError

# L_max of a bake, where the sigmoid ends, over the radiance that pixels reach (D9): a thin filament
# outshines its pixel, in a leaf that hides only part of it.
HEADROOM = 4.0
_BETA_1, _BETA_2 = 0.9, 0.98
# Lines of which the blame is found, before leaves are split.
_BLAME_LINES, _BLAME_BATCHES = 1 << 20, 4
# Beside light that is wrong by all of itself: an opacity wrong by 0.045 counts as much.
_OPACITY_BLAME = 500.0
# Lines followed straight alone, for each line whose light is asked for too: they cost a third.
_STRAIGHT_LINES = 4
# The steps between two times at which the coefficients are smoothed.
_SMOOTH_EVERY = 8
# Leaves thinner than this (optical depth across) are dropped.
_MIN_DEPTH = 2e-3


@dataclasses.dataclass(frozen=True)
class RefineConfig:
    """How to descend.

    Attributes:
        lines: lines drawn for a step; those that meet no leaf cost little.
        epsilon: of the loss, in units of L_max.
        opacity_weight: of the loss.
        density_rate, coefficient_rate: first steps of Adam for log density and coefficients.
        smoothing: part of the way from a leaf's coefficients to the mean of its neighbours' that
            they are drawn at first, once in so many steps as `_SMOOTH_EVERY` says.
        final_rate: last step over first; the rates fall exponentially with the budget spent, and
            the smoothing with them.
        max_leaves: no more are made by splitting.
    """

    lines: int = 1 << 15
    epsilon: float = 0.002 / HEADROOM
    opacity_weight: float = 5.0
    density_rate: float = 0.15
    coefficient_rate: float = 0.03
    smoothing: float = 0.5
    final_rate: float = 0.05
    max_leaves: int = 3_000_000

    def __post_init__(self) -> None:
        if self.lines < TILE_LINES or self.lines % TILE_LINES:
            raise LumitreeError(f"lines is {self.lines}; expected a multiple of {TILE_LINES}")
        for name in ("epsilon", "density_rate", "coefficient_rate", "final_rate"):
            if not getattr(self, name) > 0:
                raise LumitreeError(f"{name} is {getattr(self, name)}; expected more than 0")
        if self.final_rate > 1:
            raise LumitreeError(f"final_rate is {self.final_rate}; expected at most 1")
        if not 0 <= self.smoothing <= 1:
            raise LumitreeError(f"smoothing is {self.smoothing}; expected 0 to 1")


class Refiner:
    """A field being refined, with the state of its optimiser.

    Attributes:
        field: the leaves so far.
        step: steps done.
    """

    def __init__(
        self, field: LeafField, source: RaySource, max_radiance: float, config: RefineConfig
    ) -> None:
        self.field, self.step = field, 0
        self._source, self._config = source, config
        self._max_radiance = max_radiance
        self._density_adam = Adam(field.num_leaves)
        self._coefficient_adam = Adam(field.num_leaves * field.width)

    def advance(self, progress: float) -> int:
        """One step at `progress` in [0, 1] of the budget; returns the number of rays used."""
        field, config = self.field, self._config
        self.step += 1
        rays = self._source.draw(
            config.lines, SeedStream(Purpose.REFINEMENT, self.step), field.meets
        )
        straight = self._source.straight(
            _STRAIGHT_LINES * config.lines, SeedStream(Purpose.STRAIGHT, self.step), field.meets
        )
        count = dr.width(rays.origin) + dr.width(straight[0])
        if dr.width(rays.origin) == 0 or dr.width(straight[0]) == 0:
            return count
        integrated = field.integrate(rays.origin, rays.direction)
        radiance, through, _ = integrated
        dr.eval(integrated)
        weight = dr.rcp(radiance + config.epsilon)
        light = rays.light * dr.opaque(mi.Float, 1 / self._max_radiance)
        # Lines of both kinds tell of the opacity.
        part = 1 / (1 + _STRAIGHT_LINES)
        d_density, d_coefficients = field.gradients(
            rays.origin,
            rays.direction,
            integrated,
            weight * (rays.share * radiance - light),
            part * rays.share * self._by_depth(through, rays.transmittance),
        )
        through = field.through(*straight[:2])
        share = dr.opaque(mi.Float, (1 - part) / dr.width(straight[0]))
        d_depth = share * self._by_depth(through, straight[2])
        dr.eval(d_depth)
        d_density += field.depth_gradient(*straight[:2], d_depth)
        fallen = config.final_rate ** min(progress, 1.0)
        field.log_density = dr.minimum(
            self._density_adam.descend(field.log_density, d_density, fallen * config.density_rate),
            self._densest(),
        )
        field.coefficients = self._coefficient_adam.descend(
            field.coefficients, d_coefficients, fallen * config.coefficient_rate
        )
        dr.eval(field.log_density, field.coefficients)
        if self.step % _SMOOTH_EVERY == 0:
            field.smooth(fallen * config.smoothing)
        return count

    def _by_depth(self, through: Any, wanted: Any) -> Any:
        """Derivative of the opacity loss by the optical depth of rays that let `through` pass."""
        # Beyond saturation the linear law's is 0: taken for that of tau, or nothing could thin out.
        slope = through if self.field.law == "exponential" else 1
        return 2 * self._config.opacity_weight * (wanted - through) * slope

    def _densest(self) -> Any:
        """Log density [M] at which each leaf is opaque."""
        return math.log(OPAQUE / 2) + self.field.device_levels * math.log(2)

    def prune(self) -> None:
        """Drop the leaves that hide next to nothing, wherever they are seen from."""
        depth = np.exp(np.array(self.field.log_density)) * 2.0 ** (1 - self.field.levels)
        kept = np.flatnonzero(depth >= _MIN_DEPTH)
        if len(kept):
            self._rebuild(kept, self.field.cells[kept], self.field.levels[kept])

    def balance(self) -> None:
        """Scale the emission of regions to the light they send to each side, see `balance`."""
        stream = SeedStream(Purpose.CALIBRATION, self.step)
        balance(self.field, self._source, self._max_radiance, stream)

    def split(self, deepest: int) -> None:
        """Split the leaves above level `deepest` that answer for most of the loss.

        As many as `max_leaves` allows, worst first; children begin as their parent was.
        """
        field = self.field
        blame = self._blame()
        blame[field.levels >= deepest] = 0
        order = np.argsort(-blame)
        # Leaves beyond these answer for a hundredth of the loss together.
        enough = np.searchsorted(np.cumsum(blame[order]), 0.99 * blame.sum()) + 1
        room = max(0, (self._config.max_leaves - field.num_leaves) // 7)
        chosen = np.zeros(field.num_leaves, bool)
        chosen[order[: min(enough, room)]] = True
        chosen &= blame > 0
        whole, parents = np.flatnonzero(~chosen), np.flatnonzero(chosen)
        self._rebuild(
            np.concatenate([whole, np.repeat(parents, 8)]),
            np.concatenate([field.cells[whole], split(field.cells[parents])]),
            np.concatenate([field.levels[whole], np.repeat(field.levels[parents] + 1, 8)]),
        )

    def _blame(self) -> NDArray[np.float32]:
        """How much of the loss each leaf answers for [M], by its weight in the rays."""
        field, config = self.field, self._config
        blame = dr.zeros(mi.Float, field.num_leaves)
        for batch in range(_BLAME_BATCHES):
            stream = SeedStream(Purpose.ERROR_INDICATOR, self.step, batch)
            pairs = self._source.pairs(_BLAME_LINES, stream, 1)
            radiance, through, _ = field.integrate(pairs.origin, pairs.direction)
            scale = dr.opaque(mi.Float, 1 / self._max_radiance)
            # Without bias, so that noise takes no part.
            square = (radiance - pairs.first * scale) * (radiance - pairs.second * scale)
            loss = dr.sum(square * dr.rcp(dr.square(radiance + config.epsilon)))
            loss += _OPACITY_BLAME * dr.square(through - pairs.transmittance)
            dr.eval(loss)
            blame += field.share_out(pairs.origin, pairs.direction, loss)
            dr.eval(blame)
        return np.maximum(np.array(blame), 0)

    def _rebuild(
        self, origin: NDArray[np.int64], cells: NDArray[np.int64], levels: NDArray[np.int64]
    ) -> None:
        """Make a field of new leaves; leaf i continues what leaf `origin[i]` was."""
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

    def state(self) -> dict[str, NDArray[Any]]:
        """All that `restore` needs to go on, as arrays."""
        field, density, coefficients = self.field, self._density_adam, self._coefficient_adam
        return field.arrays() | {
            "density_mean": np.array(density.mean),
            "density_square": np.array(density.square),
            "coefficient_mean": np.array(coefficients.mean),
            "coefficient_square": np.array(coefficients.square),
            "steps": np.array([self.step, density.steps]),
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from what `state` returned."""
        self.field = self.field.with_leaves(*(state[name] for name in LEAVES))
        density, coefficients = self._density_adam, self._coefficient_adam
        density.mean = on_device(mi.Float, state["density_mean"])
        density.square = on_device(mi.Float, state["density_square"])
        coefficients.mean = on_device(mi.Float, state["coefficient_mean"])
        coefficients.square = on_device(mi.Float, state["coefficient_square"])
        self.step = int(state["steps"][0])
        density.steps = coefficients.steps = int(state["steps"][1])


class Adam:
    """Adam's moments of one flat array; Kingma and Ba 2015."""

    def __init__(self, size: int) -> None:
        self.mean, self.square = dr.zeros(mi.Float, size), dr.zeros(mi.Float, size)
        self.steps = 0

    def descend(self, values: Any, gradient: Any, rate: float) -> Any:
        """The values after one step."""
        self.steps += 1
        # Opaque, or every step would compile a kernel of its own.
        step = dr.opaque(mi.Float, rate / (1 - _BETA_1**self.steps))
        correction = dr.opaque(mi.Float, 1 / (1 - _BETA_2**self.steps))
        self.mean = _BETA_1 * self.mean + (1 - _BETA_1) * gradient
        self.square = _BETA_2 * self.square + (1 - _BETA_2) * dr.square(gradient)
        moved = values - step * self.mean / (dr.sqrt(self.square * correction) + 1e-15)
        dr.eval(self.mean, self.square, moved)
        return moved

    def take(self, index: Any) -> None:
        """Keep the moments of some elements, in their order."""
        self.mean = dr.gather(mi.Float, self.mean, index)
        self.square = dr.gather(mi.Float, self.square, index)
        dr.eval(self.mean, self.square)
