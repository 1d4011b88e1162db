"""A luminaire's light as a normalizing flow over rays, as in PureLight (arXiv 2606.04319).

PureLight traces light paths, fits a normalizing flow to the rays that leave through the exit
surfaces, takes radiance as density times flux, and distils it into a small network. This is known
from its abstract and its introduction. Guessed are:

* the exit surface: the sphere through the corners of the luminaire's box;
* the coordinates of a ray: direction, and where it crosses the disk through the centre across it.
  Their measure is that of radiant flux, so radiance = flux · p / (4π · π R²);
* the flow: coupling layers of splines (`spline_flow`), and that colours are learned apart, as the
  parts of the flux in the three channels at given coordinates;
* all sizes, steps and step sizes; they are small, for two minutes on 2 CPU cores. PureLight calls
  its flow large.

The distilled network gives the logarithm of radiance at the same coordinates. The networks are
evaluated by JAX, outside of Mitsuba's kernels. PureLight also has a network that samples directions
for a receiver, and one that blends; they are not rebuilt.

Symbols
    R            radius of the sphere
    x            coordinates of a ray, [0, 1]⁴
"""

import math
from typing import Any

import drjit as dr
import jax
import jax.numpy as jnp
import mitsuba as mi
import numpy as np
import optax
from flax import nnx
from numpy.typing import NDArray

from benchmarks.baselines.descent import Budget, descend, num_bytes
from benchmarks.baselines.places import Disk
from benchmarks.baselines.spline_flow import Conditioner, SplineFlow
from benchmarks.baselines.traced_rays import TracedRays
from lumitree.core.device import on_device
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.trace.emitted_rays import RayBatch, seeded_sampler

LAYERS, BINS, WIDTH = 8, 16, 64
# Radiance below that of an even distribution by this exponent is black to the small network.
BLACK = 7.0
_BATCH = 1024
_RATES = 3e-3, 3e-5
# Coordinates at once: the splines of so many rays fit a CPU's caches.
_CHUNK = 4096


class _Networks(nnx.Module):
    """The flow, and the logits [N, 3] of the parts of the flux that are red, green and blue."""

    def __init__(self, seed: int) -> None:
        self.flow = SplineFlow(LAYERS, BINS, WIDTH, seed)
        self.colour = Conditioner(4, 3, WIDTH, nnx.Rngs(seed + 1))


class LightFlow:
    """The representation: rays are sampled by the flow, and radiance is that of the small network.

    Args:
        steps: of the training of the flow, and of the distillation.

    Attributes:
        num_bytes: of all weights, in half precision.
        distilled_bytes: of those of the distilled network alone.
        flux: float64 [3], of the rays.
    """

    def __init__(self, rays: TracedRays, seed: int, steps: int = 2000) -> None:
        self.flux = rays.flux.sum(axis=0, dtype=np.float64)
        self._radius = float(np.linalg.norm(rays.half_extents))
        seeds = SeedStream(Purpose.LIGHT_FIELD, 0, draw=3)
        # Flax and JAX take seeds below 2³¹.
        parts = [seeds.seed(seed, part) % (2**31 - 2) for part in range(4)]
        # Logarithm of the radiance of an even distribution, which the small network starts from.
        even = self.flux / (4 * math.pi**2 * self._radius**2)
        self._middle = jnp.asarray(np.log(even + 1e-30), jnp.float32)
        self._networks = _train(rays, self._radius, parts[:2], steps)
        self._distilled = self._distil(parts[2:], steps)
        self.distilled_bytes = num_bytes(self._distilled)
        self.num_bytes = num_bytes(self._networks) + self.distilled_bytes
        self._sample = jax.jit(
            lambda z: _coloured(self._networks, self._networks.flow.sample(z)[0])
        )
        self._eval = jax.jit(lambda x: jnp.exp(self._distilled(x) + self._middle))

    def draw(self, count: int, seed: int) -> RayBatch:
        """As `EmittedRays.draw`; the flow maps the sampler's numbers to rays."""
        sampler = seeded_sampler(seed, count)
        first, second = sampler.next_2d(), sampler.next_2d()
        z = np.stack([np.array(v, np.float32) for v in (*first, *second)], axis=-1)
        x, colour = _in_chunks(self._sample, z)
        flux = colour * (self.flux.sum() / count).astype(np.float32)
        origin, direction = rays_of(x, self._radius)
        return RayBatch(origin, direction, on_device(mi.Color3f, flux))

    def sample_direction(self, x: Any, sampler: Any) -> None:
        """The flow has no distribution of directions at a receiver."""

    def eval(self, origin: Any, direction: Any) -> Any:
        """As `Representation.eval`, by the distilled network."""
        _, _, hit = Disk(self._radius).seen(origin, direction)
        (radiance,) = _in_chunks(
            lambda x: (self._eval(x),), coordinates(origin, direction, self._radius)
        )
        return dr.select(hit, on_device(mi.Color3f, radiance), 0)

    def log_radiance(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        """Logarithm of the flow's radiance [N, 3] at coordinates [N, 4]."""
        return np.asarray(_log_radiance(self._networks, jnp.asarray(x), self.flux, self._radius))

    def _distil(self, seeds: list[int], steps: int) -> Conditioner:
        """The small network: half of its rays are the flow's, half are uniform."""
        graph, start = nnx.split(Conditioner(4, 3, WIDTH, nnx.Rngs(seeds[0])))

        def loss(params: Any, key: jax.Array) -> jax.Array:
            z = jax.random.uniform(key, (_BATCH, 4))
            x = jnp.where(jnp.arange(_BATCH)[:, None] % 2, z, self._networks.flow.sample(z)[0])
            wanted = _log_radiance(self._networks, x, self.flux, self._radius)
            found = nnx.merge(graph, params)(x) + self._middle
            return jnp.mean((found - jnp.maximum(wanted, self._middle - BLACK)) ** 2)

        root = jax.random.key(seeds[1])
        params, _, _ = descend(
            loss,
            nnx.to_pure_dict(start),
            lambda index: (jax.random.fold_in(root, index),),
            _RATES,
            Budget(steps=steps),
        )
        return nnx.merge(graph, params)


def coordinates(origin: Any, direction: Any, radius: float) -> NDArray[np.float32]:
    """Coordinates [N, 4] of rays (mi.Point3f, mi.Vector3f, unit) that meet the sphere."""
    offset = mi.Frame3f(direction).to_local(mi.Vector3f(origin)) / radius
    squares = (
        mi.warp.uniform_sphere_to_square(direction),
        mi.warp.uniform_disk_to_square_concentric(mi.Point2f(offset.x, offset.y)),
    )
    values = [np.array(value, np.float32) for square in squares for value in square]
    # Lines of one image have one direction.
    return np.stack(np.broadcast_arrays(*values), axis=-1).clip(0, 1)


def rays_of(x: NDArray[np.float32], radius: float) -> tuple[Any, Any]:
    """Where rays of coordinates [N, 4] enter the sphere (mi.Point3f), and their directions.

    Not where they leave it: a receiver that touches the box lies inside of the sphere.
    """
    direction = mi.warp.square_to_uniform_sphere(on_device(mi.Point2f, x[:, :2]))
    disk = mi.warp.square_to_uniform_disk_concentric(on_device(mi.Point2f, x[:, 2:]))
    before = -dr.safe_sqrt(1 - dr.squared_norm(disk))
    local = radius * mi.Vector3f(disk.x, disk.y, before)
    origin = mi.Point3f(mi.Frame3f(direction).to_world(local))
    dr.eval(origin, direction)
    return origin, direction


def _train(rays: TracedRays, radius: float, seeds: list[int], steps: int) -> _Networks:
    x = coordinates(
        on_device(mi.Point3f, rays.origin), on_device(mi.Vector3f, rays.direction), radius
    )
    power = rays.flux.sum(axis=1, dtype=np.float64)
    total = np.cumsum(power)
    parts = (rays.flux / np.maximum(power, 1e-30)[:, None]).astype(np.float32)
    graph, start = nnx.split(_Networks(seeds[0]))

    def draw(index: int) -> tuple[jax.Array, jax.Array]:
        """Rays by their flux."""
        random = np.random.default_rng((seeds[1], index))
        rows = np.searchsorted(total, random.random(_BATCH) * total[-1], side="right")
        rows = np.minimum(rows, len(total) - 1)
        return jnp.asarray(x[rows]), jnp.asarray(parts[rows])

    def loss(params: Any, points: jax.Array, colours: jax.Array) -> jax.Array:
        networks = nnx.merge(graph, params)
        cross = optax.softmax_cross_entropy(networks.colour(points), colours)
        return jnp.mean(cross - networks.flow.log_density(points))

    params, _, _ = descend(loss, nnx.to_pure_dict(start), draw, _RATES, Budget(steps=steps))
    return nnx.merge(graph, params)


def _coloured(networks: _Networks, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    return x, jax.nn.softmax(networks.colour(x))


def _log_radiance(
    networks: _Networks, x: jax.Array, flux: NDArray[np.float64], radius: float
) -> jax.Array:
    scale = math.log(float(flux.sum()) / (4 * math.pi**2 * radius**2))
    colour = jax.nn.log_softmax(networks.colour(x))
    return networks.flow.log_density(x)[:, None] + colour + scale


def _in_chunks(function: Any, points: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Results of a jitted function of points [N, 4], by equal parts so that it compiles once."""
    count = len(points)
    padded = np.zeros((-(-count // _CHUNK) * _CHUNK, 4), np.float32)
    padded[:count] = points
    parts = [function(padded[start : start + _CHUNK]) for start in range(0, len(padded), _CHUNK)]
    return [np.concatenate(each)[:count] for each in zip(*parts, strict=True)]
