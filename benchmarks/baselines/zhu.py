"""Training of the three networks of Zhu et al. 2021 (`zhu_networks`), and what they return.

Radiance and opacity are trained on the rays of a dataset that cross the luminaire's box: those that
the project's own network is trained on, and the ones that it may skip because they miss the visual
hull. Then the sampling network is trained against the network of radiance, for receivers whose
distances are uniform in their logarithm, up to 18 radii of the sphere.

Without a budget the training ends when the PSNR of held-out rays of the training views stands still
(`descent`).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import nnx
from numpy.typing import NDArray

from benchmarks.baselines.descent import Budget, descend, num_bytes
from benchmarks.baselines.direction_cells import (
    cone_directions,
    density_of_cells,
    probabilities,
    sample_cells,
)
from benchmarks.baselines.zhu_networks import (
    RayNetworks,
    SamplingNetwork,
    ZhuConfig,
    encode,
)
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.network.losses import psnr
from lumitree.fit.network.occupancy import box_interval
from lumitree.fit.network.ray_set import Batch, RaySet

# Part of the time that the sampling network takes, its receivers in a step, and directions of each.
SAMPLING_SHARE = 0.2
_RECEIVERS, _DIRECTIONS = 64, 64
# Rays evaluated at once: their activations fit a CPU's caches.
_CHUNK = 1024


class ZhuLuminaire:
    """The trained networks.

    Attributes:
        steps: of the networks of rays.
        seconds: of the training of all three, without compilation.
        num_bytes: of the weights, in half precision.
        radius: of the bounding sphere, local units.
    """

    def __init__(
        self, rays: RayNetworks, sampling: SamplingNetwork, half: Any, steps: int, seconds: float
    ) -> None:
        self.steps, self.seconds = steps, seconds
        self.num_bytes = num_bytes(rays) + num_bytes(sampling)
        self._config, self.radius = rays.config, rays.radius

        def eval_rays(origins: jax.Array, directions: jax.Array) -> tuple[jax.Array, jax.Array]:
            standardised, logits = rays(origins, directions)
            near, far = box_interval(origins, directions, half)
            meets = far > near
            radiance = jnp.where(meets[:, None], rays.decode(standardised), 0)
            return radiance, nnx.sigmoid(logits) * meets

        self._eval = jax.jit(eval_rays)
        self._logits = jax.jit(sampling.__call__)

    def eval(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Radiance [R, 3] and opacity [R] of rays [R, 3], local frame; 0 past the box."""
        count = len(origins)
        radiance, opacity = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
        padded = np.ones((2, _CHUNK, 3), np.float32)
        for start in range(0, count, _CHUNK):
            held = slice(start, min(start + _CHUNK, count))
            size = held.stop - start
            padded[:, :size] = origins[held], directions[held]
            found = self._eval(*padded)
            radiance[held], opacity[held] = (np.asarray(each)[:size] for each in found)
        return radiance, opacity

    def sample(
        self, receivers: NDArray[np.floating], seed: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Directions [N, 3] from points [N, 3] outside the sphere, and their densities [N]."""
        points = jnp.asarray(receivers, jnp.float32)
        found = sample_cells(
            self._logits(points), points, self.radius, self._config.rings, jax.random.key(seed)
        )
        return np.asarray(found[0]), np.asarray(found[1])

    def pdf(
        self, receivers: NDArray[np.floating], directions: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """Density [N] with which `sample` returns a direction, by solid angle."""
        points = jnp.asarray(receivers, jnp.float32)
        return np.asarray(
            density_of_cells(
                self._logits(points),
                points,
                jnp.asarray(directions, jnp.float32),
                self.radius,
                self._config.rings,
            )
        )


def train_zhu(
    rays: RaySet, half_extents: NDArray[np.floating], config: ZhuConfig, budget: Budget
) -> ZhuLuminaire:
    """Train all three networks.

    Args:
        rays: of a dataset, without those that miss the box.
        half_extents: [3] of the box, local units.
        config: sizes and settings.
        budget: of all three together.
    """
    networks = _ray_networks(rays, half_extents, config)
    networks, steps, first = _train_rays(networks, rays, config, budget.part(1 - SAMPLING_SHARE))
    sampling, second = _train_sampling(networks, config, budget.part(SAMPLING_SHARE))
    half = jnp.asarray(half_extents, jnp.float32)
    return ZhuLuminaire(networks, sampling, half, steps, first + second)


def _seed(config: ZhuConfig, part: int) -> int:
    return SeedStream(Purpose.LIGHT_FIELD, 0, draw=4).seed(config.seed, part) % 2**31


def _ray_networks(
    rays: RaySet, half_extents: NDArray[np.floating], config: ZhuConfig
) -> RayNetworks:
    sample = rays.radiance[:: max(1, len(rays.radiance) // 1_000_000)]
    encoded = np.asarray(encode(sample, config.encoding))
    radius = float(np.linalg.norm(half_extents))
    moments = float(encoded.mean()), float(encoded.std())
    return RayNetworks(config, radius, moments, rays.max_radiance, _seed(config, 0))


def _train_rays(
    networks: RayNetworks, rays: RaySet, config: ZhuConfig, budget: Budget
) -> tuple[RayNetworks, int, float]:
    """The trained networks of radiance and opacity, steps and seconds."""
    graph, weights = nnx.split(networks)

    def loss(params: Any, batch: Batch) -> jax.Array:
        model = nnx.merge(graph, params)
        radiance, logits = model(batch.origins, batch.directions)
        error = jnp.mean((radiance - model.standardise(batch.radiance)) ** 2)
        return error + jnp.mean(optax.sigmoid_binary_cross_entropy(logits, batch.opacity))

    held_out = rays.held_out()

    @jax.jit
    def quality(params: Any) -> jax.Array:
        model = nnx.merge(graph, params)
        radiance = model.decode(model(held_out.origins, held_out.directions)[0])
        return psnr(radiance, held_out.radiance, rays.max_radiance)

    start, seed = nnx.to_pure_dict(weights), _seed(config, 1)
    params, steps, spent = descend(
        loss,
        start,
        lambda index: (rays.draw(seed, index, config.rays_per_batch),),
        (config.learning_rate_start, config.learning_rate_end),
        budget,
        lambda params: float(quality(params)),
    )
    return nnx.merge(graph, params), steps, spent


def _train_sampling(
    networks: RayNetworks, config: ZhuConfig, budget: Budget
) -> tuple[SamplingNetwork, float]:
    """The trained sampling network, and seconds."""
    radius = networks.radius
    graph, weights = nnx.split(SamplingNetwork(config, radius, _seed(config, 2)))
    cells = config.rings * config.sectors

    def loss(params: Any, key: jax.Array) -> jax.Array:
        receivers, chosen, offset = _receivers(key, radius, cells)
        points = jnp.repeat(receivers, _DIRECTIONS, axis=0)
        ring = (chosen // config.sectors + offset[0]) / config.rings
        sector = (chosen % config.sectors + offset[1]) / config.sectors
        directions = cone_directions(points, radius, ring, sector)
        radiance = networks.decode(networks.radiance(networks.features(points, directions)))
        light = jnp.sum(radiance, axis=-1).reshape(_RECEIVERS, _DIRECTIONS)
        light = light / jnp.maximum(jnp.mean(light, axis=-1, keepdims=True), 1e-9)
        parts = probabilities(nnx.merge(graph, params)(receivers))
        part = jnp.take_along_axis(parts, chosen.reshape(_RECEIVERS, _DIRECTIONS), axis=-1)
        return -jnp.mean(jax.lax.stop_gradient(light) * jnp.log(part * cells))

    start, seed = nnx.to_pure_dict(weights), _seed(config, 3)
    params, _, spent = descend(
        loss,
        start,
        lambda index: (jax.random.fold_in(jax.random.key(seed), index),),
        (config.learning_rate_start, config.learning_rate_end),
        budget,
    )
    return nnx.merge(graph, params), spent


def _receivers(key: jax.Array, radius: float, cells: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Receivers, and for each a stratified set of cells with places in them."""
    keys = jax.random.split(key, 4)
    towards = jax.random.normal(keys[0], (_RECEIVERS, 3))
    towards /= jnp.linalg.norm(towards, axis=-1, keepdims=True)
    distance = radius * 18 ** jax.random.uniform(keys[1], (_RECEIVERS, 1), minval=0.02)
    stratum = jnp.arange(_DIRECTIONS) + jax.random.uniform(keys[2], (_RECEIVERS, _DIRECTIONS))
    chosen = (stratum / _DIRECTIONS * cells).astype(jnp.int32).ravel()
    return distance * towards, chosen, jax.random.uniform(keys[3], (2, len(chosen)))
