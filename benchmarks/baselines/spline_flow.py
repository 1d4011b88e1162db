"""A normalizing flow on the unit cube: coupling layers of monotonic rational-quadratic splines.

Durkan et al., "Neural Spline Flows", 2019; as used for sampling by Müller et al., "Neural
Importance Sampling", 2019. The base density is uniform on [0, 1]^D, and so is the flow at first.

Symbols
    z            point of the base
    x            point that the flow maps it to; log p(x) = -log |det dx/dz|
    B            bins of a spline
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import nnx

from lumitree.fit.network.network import fourier_features

# No bin of a spline is smaller than this part of a mean one, nor its slope than this.
_SMALLEST, _FLATTEST = 1e-3, 1e-3


class Spline(NamedTuple):
    """Monotonic map of [0, 1]: B + 1 knots in z and x, and the slopes there, each [..., B + 1]."""

    z: jax.Array
    x: jax.Array
    slope: jax.Array


# `to_x` or `to_z`.
Transform = Callable[[Spline, jax.Array], tuple[jax.Array, jax.Array]]


def spline_of(raw: jax.Array) -> Spline:
    """The spline of unconstrained numbers [..., 3 B + 1]; zeros give the identity."""
    bins = (raw.shape[-1] - 1) // 3
    widths, heights, slopes = jnp.split(raw, [bins, 2 * bins], axis=-1)

    def knots(logits: jax.Array) -> jax.Array:
        parts = (1 - _SMALLEST) * jax.nn.softmax(logits) + _SMALLEST / bins
        inner = jnp.cumsum(parts, axis=-1)[..., :-1]
        return jnp.concatenate(
            [jnp.zeros_like(parts[..., :1]), inner, jnp.ones_like(parts[..., :1])], axis=-1
        )

    # softplus(log(e - 1)) = 1
    slope = _FLATTEST + (1 - _FLATTEST) * jax.nn.softplus(slopes + 0.541324855)
    return Spline(knots(widths), knots(heights), slope)


def to_x(spline: Spline, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """x [...] and log dx/dz of z [...] in [0, 1]."""
    z0, width, x0, height, s0, s1 = _bin(spline, spline.z, z)
    mean, t = height / width, jnp.clip((z - z0) / width, 0, 1)
    rest = mean + (s0 + s1 - 2 * mean) * t * (1 - t)
    x = x0 + height * (mean * t**2 + s0 * t * (1 - t)) / rest
    return x, _log_slope(mean, s0, s1, t, rest)


def to_z(spline: Spline, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """z [...] and log dx/dz there, of x [...] in [0, 1]."""
    z0, width, x0, height, s0, s1 = _bin(spline, spline.x, x)
    mean, y = height / width, jnp.clip((x - x0) / height, 0, 1)
    bend = s0 + s1 - 2 * mean
    a = mean - s0 + y * bend
    b = s0 - y * bend
    # The root of a t² + b t = mean y that lies in [0, 1], without cancellation.
    t = 2 * mean * y / (b + jnp.sqrt(jnp.maximum(b**2 + 4 * a * mean * y, 1e-12)))
    t = jnp.clip(t, 0, 1)
    return z0 + t * width, _log_slope(mean, s0, s1, t, mean + bend * t * (1 - t))


def _log_slope(
    mean: jax.Array, s0: jax.Array, s1: jax.Array, t: jax.Array, rest: jax.Array
) -> jax.Array:
    top = s1 * t**2 + 2 * mean * t * (1 - t) + s0 * (1 - t) ** 2
    return 2 * jnp.log(mean) + jnp.log(top) - 2 * jnp.log(rest)


def _bin(spline: Spline, knots: jax.Array, value: jax.Array) -> tuple[jax.Array, ...]:
    """Left ends and sizes of the bins that hold the values, and the slopes at their ends."""
    index = jnp.sum(knots[..., 1:-1] <= value[..., None], axis=-1, keepdims=True)

    def pick(values: jax.Array) -> jax.Array:
        return jnp.take_along_axis(values, index, axis=-1)[..., 0]

    z0, x0 = pick(spline.z[..., :-1]), pick(spline.x[..., :-1])
    width, height = pick(spline.z[..., 1:]) - z0, pick(spline.x[..., 1:]) - x0
    return z0, width, x0, height, pick(spline.slope[..., :-1]), pick(spline.slope[..., 1:])


class Conditioner(nnx.Module):
    """Two hidden layers with Fourier features: points [N, D] of the unit cube to numbers [N, O].

    Its output is 0 at first.
    """

    def __init__(self, inputs: int, outputs: int, width: int, rngs: nnx.Rngs) -> None:
        self.frequencies = 4
        init, features = nnx.initializers.he_normal(), inputs * (1 + 2 * self.frequencies)
        self.first = nnx.Linear(features, width, kernel_init=init, rngs=rngs)
        self.second = nnx.Linear(width, width, kernel_init=init, rngs=rngs)
        self.last = nnx.Linear(width, outputs, kernel_init=nnx.initializers.zeros, rngs=rngs)

    def __call__(self, points: jax.Array) -> jax.Array:
        hidden = nnx.relu(self.first(fourier_features(points, self.frequencies)))
        return self.last(nnx.relu(self.second(hidden)))


class SplineFlow(nnx.Module):
    """Coupling layers over [0, 1]⁴: each maps two coordinates by splines that the others choose.

    Args:
        layers: number of layers.
        bins: B.
        width: neurons of the conditioners.
        seed: of the initial weights.
    """

    # The coordinates that a layer maps; layers take turns.
    SPLITS = ((0, 1), (2, 3), (0, 2), (1, 3), (0, 3), (1, 2))

    def __init__(self, layers: int, bins: int, width: int, seed: int) -> None:
        rngs, outputs = nnx.Rngs(seed), 2 * (3 * bins + 1)
        self.conditioners = nnx.List([Conditioner(2, outputs, width, rngs) for _ in range(layers)])

    def sample(self, z: jax.Array) -> tuple[jax.Array, jax.Array]:
        """x [N, 4] of z [N, 4], and log p(x) [N]."""
        log_density = jnp.zeros(len(z))
        for index, conditioner in enumerate(self.conditioners):
            z, change = self._layer(conditioner, index, z, to_x)
            log_density -= change
        return z, log_density

    def log_density(self, x: jax.Array) -> jax.Array:
        """log p(x) [N] of x [N, 4]."""
        log_density = jnp.zeros(len(x))
        for index in reversed(range(len(self.conditioners))):
            x, change = self._layer(self.conditioners[index], index, x, to_z)
            log_density -= change
        return log_density

    def _layer(
        self, conditioner: Conditioner, index: int, points: jax.Array, transform: Transform
    ) -> tuple[jax.Array, jax.Array]:
        mapped = jnp.array(self.SPLITS[index % len(self.SPLITS)])
        kept = jnp.array([i for i in range(4) if i not in self.SPLITS[index % len(self.SPLITS)]])
        raw = conditioner(points[:, kept]).reshape(len(points), 2, -1)
        found, change = transform(spline_of(raw), points[:, mapped])
        return points.at[:, mapped].set(found), change.sum(axis=-1)
