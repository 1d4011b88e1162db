"""The training step: its loss (Eq. 7 to 9), its devices, and the evaluation between steps.

Every random number of a step is a function of the seed and the step's index, and belongs to a
ray's place in its chunk, not to a device. The state therefore consists of the weights, Adam's
moments and the step. A resumed run equals an uninterrupted one, and the number of devices changes
only the order of sums.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import nnx
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from lumitree.fit.network.config import TrainConfig
from lumitree.fit.network.network import CoarseAndFine, Composite, render
from lumitree.fit.network.rays import Batch, Occupancy

Tree = TypeVar("Tree")
_RAYS = "rays"


def ray_mesh(num_rays: int) -> Mesh:
    """The devices that share `num_rays` rays: as many of this process as divide their number."""
    devices = jax.local_devices()
    count = max(n for n in range(1, len(devices) + 1) if num_rays % n == 0)
    return Mesh(np.array(devices[:count]), (_RAYS,))


def divided(mesh: Mesh, chunks: Tree) -> Tree:
    """Within a jitted function: arrays [C, R, ...] of C chunks, whose R rays are divided."""
    return jax.lax.with_sharding_constraint(chunks, NamedSharding(mesh, PartitionSpec(None, _RAYS)))


def on_all(mesh: Mesh) -> NamedSharding:
    """The sharding of arrays of which every device has a whole copy."""
    return NamedSharding(mesh, PartitionSpec())


# The regulariser of Eq. 8, radiance units.
EPSILON = 0.01


def hdr_loss(
    predicted: jax.Array, radiance: jax.Array, max_radiance: float, stop_gradient: bool
) -> jax.Array:
    """Relative squared error of HDR radiance (Eq. 8), the mean over rays.

    As in the paper, the error is in radiance / L_max, and the denominator is in radiance
    units. If the error were in radiance units too, this term would be L_max² times larger, and the
    opacity loss would have no effect; see docs/decisions/network.md.

    Args:
        predicted: [R, 3] radiance, >= 0.
        radiance: [R, 3] captured radiance, >= 0.
        max_radiance: L_max, > 0.
        stop_gradient: treat the denominator as constant in the gradient. The minimum over noisy
            captures is then their mean; otherwise it is biased towards higher radiance.
    """
    denominator = jax.lax.stop_gradient(predicted) if stop_gradient else predicted
    error = (predicted - radiance) / max_radiance / (denominator + EPSILON)
    return jnp.mean(jnp.sum(error**2, axis=-1))


def colour_loss(
    predicted: jax.Array, radiance: jax.Array, max_radiance: float, config: TrainConfig
) -> jax.Array:
    """The error of colours that the settings choose (`config.ColourLoss`), the mean over rays."""
    if config.colour_loss == "mse":
        error = (predicted - radiance) / max_radiance
        return jnp.mean(jnp.sum(error**2, axis=-1))
    loss = hdr_loss(predicted, radiance, max_radiance, config.stop_gradient)
    return loss * max_radiance**2 if config.colour_loss == "hdr_radiance" else loss


def opacity_loss(predicted: jax.Array, opacity: jax.Array) -> jax.Array:
    """Squared error of opacity [R] (Eq. 9), averaged over rays."""
    return jnp.mean((predicted - opacity) ** 2)


def total_loss(
    coarse: Composite,
    fine: Composite,
    radiance: jax.Array,
    opacity: jax.Array,
    max_radiance: float,
    config: TrainConfig,
) -> jax.Array:
    """L_c + L_f + L_opacity with equal weights (Eq. 7); L_opacity uses the fine network's opacity.

    Without `config.supervise_opacity` the loss has no L_opacity.
    """
    loss = colour_loss(coarse.radiance, radiance, max_radiance, config)
    loss += colour_loss(fine.radiance, radiance, max_radiance, config)
    return loss + opacity_loss(fine.opacity, opacity) if config.supervise_opacity else loss


def psnr(predicted: jax.Array, radiance: jax.Array, max_radiance: float) -> jax.Array:
    """Peak signal-to-noise ratio of rays [R, 3] in dB, of radiance / L_max clipped to [0, 1]."""
    found, true = (jnp.clip(value / max_radiance, 0, 1) for value in (predicted, radiance))
    return -10 * jnp.log10(jnp.maximum(jnp.mean((found - true) ** 2), 1e-12))


# Positions evaluated at once on a CPU. The activations of a few thousand positions fit its caches.
# A step is then 2 to 3 times faster than one pass over the batch (2 cores, width 64).
_CPU_POSITIONS = 6000
# The HDR loss has heavy tails: a bright ray whose prediction is still dark has 10^4 times the
# weight of others. Without the clipping, and with Adam's default decay of 0.999 (about 1000
# steps), a few such rays would determine the step size. The clipped gradients of all steps have
# similar lengths.
_MAX_GRADIENT = 0.1
_SECOND_MOMENT_DECAY = 0.99


class TrainState(NamedTuple):
    """Steps done, weights of both networks and Adam's moments."""

    step: jax.Array
    params: Any
    moments: Any


def initial_state(
    config: TrainConfig, initial_emission: float, seed: int = 0
) -> tuple[nnx.GraphDef, TrainState]:
    """The structure of the networks, and the state before the first step (see `NerfSH`)."""
    graph, weights = nnx.split(CoarseAndFine(config, initial_emission, seed))
    params = nnx.to_pure_dict(weights)
    return graph, TrainState(jnp.zeros((), jnp.int32), params, _optimizer(config).init(params))


def make_step(
    config: TrainConfig, graph: nnx.GraphDef, max_radiance: float, seed: int = 0
) -> Callable[[TrainState, Batch, Occupancy], tuple[TrainState, jax.Array, jax.Array]]:
    """The jitted training step, which returns the next state, the loss and the gradient norm.

    All devices share the rays (see `state_sharding`). The step donates the buffers of the given
    state, which cannot be used afterwards.
    """
    optimizer = _optimizer(config)
    num_chunks, mesh = _num_chunks(config, config.rays_per_batch), _mesh(config)

    def loss_of(params: Any, occupancy: Occupancy, rays: Batch, key: jax.Array) -> jax.Array:
        networks = nnx.merge(graph, params)
        coarse, fine = render(
            networks, occupancy, rays.origins, rays.directions, max_radiance, config, key
        )
        return total_loss(coarse, fine, rays.radiance, rays.opacity, max_radiance, config)

    def step(
        state: TrainState, batch: Batch, occupancy: Occupancy
    ) -> tuple[TrainState, jax.Array, jax.Array]:
        def add_chunk(total: Any, chunk: tuple[Batch, jax.Array]) -> tuple[Any, None]:
            value = jax.value_and_grad(loss_of)(state.params, occupancy, *chunk)
            return jax.tree.map(jnp.add, total, value), None

        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), state.step), num_chunks)
        chunks = jax.tree.map(lambda x: x.reshape(num_chunks, -1, *x.shape[1:]), batch)
        chunks = divided(mesh, chunks)
        zero = (jnp.zeros(()), jax.tree.map(jnp.zeros_like, state.params))
        total, _ = jax.lax.scan(add_chunk, zero, (chunks, keys))
        loss, gradients = jax.tree.map(lambda x: x / num_chunks, total)
        updates, moments = optimizer.update(gradients, state.moments)
        params = optax.apply_updates(state.params, updates)
        return (
            TrainState(state.step + 1, params, moments),
            loss,
            optax.global_norm(gradients),
        )

    return jax.jit(step, donate_argnums=0, out_shardings=on_all(mesh))


def state_sharding(config: TrainConfig) -> NamedSharding:
    """Where the arrays of a state must be for `make_step`: on each of the devices that share."""
    return on_all(_mesh(config))


def _mesh(config: TrainConfig) -> Mesh:
    return ray_mesh(config.rays_per_batch // _num_chunks(config, config.rays_per_batch))


def make_evaluation(
    config: TrainConfig, graph: nnx.GraphDef, max_radiance: float
) -> Callable[[Any, Batch, Occupancy], jax.Array]:
    """Jitted function of weights, batch and occupancy: PSNR of the fine network, dB."""

    def evaluate(params: Any, batch: Batch, occupancy: Occupancy) -> jax.Array:
        networks = nnx.merge(graph, params)

        def predict(rays: Batch) -> jax.Array:
            _, fine = render(
                networks, occupancy, rays.origins, rays.directions, max_radiance, config, None
            )
            return fine.radiance

        num_chunks = _num_chunks(config, len(batch.opacity))
        chunks = jax.tree.map(lambda x: x.reshape(num_chunks, -1, *x.shape[1:]), batch)
        predicted = jax.lax.map(predict, chunks).reshape(-1, 3)
        return psnr(predicted, batch.radiance, max_radiance)

    return jax.jit(evaluate)


def learning_rate(config: TrainConfig) -> optax.Schedule:
    """Adam's step size by step: exponential from `learning_rate_start` to `learning_rate_end`."""
    decay = config.learning_rate_end / config.learning_rate_start
    return optax.exponential_decay(config.learning_rate_start, config.num_steps, decay)


def _optimizer(config: TrainConfig) -> optax.GradientTransformation:
    adam = optax.adam(learning_rate(config), b2=_SECOND_MOMENT_DECAY)
    return optax.chain(optax.clip_by_global_norm(_MAX_GRADIENT), adam)


def _num_chunks(config: TrainConfig, num_rays: int) -> int:
    """Number of equal parts of a batch: 1 on a GPU; on a CPU, parts that fit its caches."""
    if jax.default_backend() != "cpu":
        return 1
    positions = num_rays * (2 * config.num_coarse + config.num_fine)
    wanted = min(num_rays, -(-positions // _CPU_POSITIONS))
    return next(count for count in range(wanted, num_rays + 1) if num_rays % count == 0)
