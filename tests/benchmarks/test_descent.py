"""Training of baselines: budgets, and the end by convergence."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.baselines.descent import Budget, descend

TARGET = jnp.asarray([1.0, -2.0])


def _descend(budget, quality=None):
    """Of a noisy quadratic; the weights, the steps and the steps that were drawn."""
    drawn = []

    def draw(index):
        drawn.append(index)
        return (jax.random.normal(jax.random.fold_in(jax.random.key(0), index), (2,)),)

    def loss(weights, noise):
        return ((weights - TARGET - 0.3 * noise) ** 2).sum()

    weights, steps, seconds = descend(loss, jnp.zeros(2), draw, (3e-2, 1e-4), budget, quality)
    assert seconds > 0
    return np.asarray(weights), steps, drawn


def test_a_budget_of_steps_is_kept_and_repeats():
    weights, steps, drawn = _descend(Budget(steps=300))
    assert steps == 300
    # The first is also the one that compiles.
    assert drawn == [0, *range(300)]
    np.testing.assert_allclose(weights, TARGET, atol=0.05)
    np.testing.assert_array_equal(weights, _descend(Budget(steps=300))[0])


@pytest.mark.slow
def test_training_ends_when_quality_stands_still():
    asked = []

    def quality(weights):
        asked.append(float(-10 * np.log10(((np.asarray(weights) - TARGET) ** 2).mean() + 1e-3)))
        return min(asked[-1], 15.0)

    weights, steps, _ = _descend(Budget(), quality)
    # Once at the start, once after a window that improves it, and once after one that does not.
    assert len(asked) == 3
    assert steps == 2 * (20 + 2 * 1000)
    np.testing.assert_allclose(weights, TARGET, atol=0.05)


def test_a_share_of_a_budget():
    assert Budget(seconds=10).part(0.2) == Budget(seconds=2)
    assert Budget(steps=50).part(0.2) == Budget(steps=50)
    assert Budget().part(0.2) == Budget()
