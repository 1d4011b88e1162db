"""Training of a baseline's network by Adam, for a time, for a number of steps, or to convergence.

The step size is constant in the first half of the steps and decays exponentially in the second.
Where no budget is given, the first half ends when the network has converged: when a window of steps
has improved a measure of its quality by less than `_PLATEAU`.
"""

import dataclasses
import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import nnx

# Steps between two checks of convergence, and the improvement below which it has come, dB.
_WINDOW, _PLATEAU = 1000, 0.05
# Steps without a budget and a measure of quality.
_STEPS = 10_000
_TIMED_STEPS = 20


@dataclasses.dataclass(frozen=True)
class Budget:
    """What a training may take; without both it goes on until the networks have converged.

    Attributes:
        seconds: of all steps, without compilation.
        steps: number of steps of the networks of rays, and of the sampling network; at least 40.
    """

    seconds: float | None = None
    steps: int | None = None

    def part(self, share: float) -> "Budget":
        """A share of the seconds; as many steps."""
        return Budget(None if self.seconds is None else share * self.seconds, self.steps)


def descend(
    loss: Callable[..., jax.Array],
    params: Any,
    draw: Callable[[int], tuple[Any, ...]],
    rates: tuple[float, float],
    budget: Budget,
    quality: Callable[[Any], float] | None = None,
) -> tuple[Any, int, float]:
    """Minimise a loss.

    Args:
        loss: of weights and of what `draw` returns for a step.
        params: weights at the start, a tree of arrays.
        rates: step sizes at the start and at the end.
        quality: of weights, dB; it ends a training without a budget.

    Returns:
        The weights, the number of steps, and the seconds without compilation.
    """
    adam = optax.scale_by_adam()

    @jax.jit
    def advance(params: Any, moments: Any, rate: jax.Array, *drawn: Any) -> tuple[Any, Any]:
        updates, moments = adam.update(jax.grad(loss)(params, *drawn), moments)
        updates = jax.tree.map(lambda update: -rate * update, updates)
        return optax.apply_updates(params, updates), moments

    def steps(state: tuple[Any, Any], first: int, count: int, decay: float) -> tuple[Any, Any]:
        """Of which the last has the step size `decay` times that of the first."""
        for index in range(count):
            rate = jnp.float32(rates[0] * decay ** (index / max(count - 1, 1)))
            state = advance(*state, rate, *draw(first + index))
        jax.block_until_ready(state)
        return state

    initial = params, adam.init(params)
    steps(initial, 0, 1, 1.0)  # compiles
    start = time.perf_counter()
    state, half = steps(initial, 0, _TIMED_STEPS, 1.0), _TIMED_STEPS
    speed = _TIMED_STEPS / (time.perf_counter() - start)
    if quality is not None and budget == Budget():
        best = -np.inf
        while (now := quality(state[0])) > best + _PLATEAU:
            print(f"step {half}: {now:.2f} dB", file=sys.stderr)
            best = now
            state, half = steps(state, half, _WINDOW, 1.0), half + _WINDOW
    else:
        rest = max(0, _half(budget, speed) - half)
        state, half = steps(state, half, rest, 1.0), half + rest
    state = steps(state, half, half, rates[1] / rates[0])
    return state[0], 2 * half, time.perf_counter() - start


def _half(budget: Budget, speed: float) -> int:
    """Half of the steps that a budget allows, at so many steps a second."""
    if budget.steps is not None:
        return budget.steps // 2
    return _STEPS // 2 if budget.seconds is None else round(speed * budget.seconds / 2)


def num_bytes(network: nnx.Module) -> int:
    """Bytes of a network's weights in half precision, in which renderers evaluate such networks."""
    return 2 * sum(int(leaf.size) for leaf in jax.tree.leaves(nnx.state(network, nnx.Param)))
