"""One training step: its arithmetic, its speed against the machine's, and what limits it."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

from benchmarks.paper_tables.cells import Cell, Measured
from benchmarks.paper_tables.found import Found
from benchmarks.paper_tables.scales import SCALES, Scale
from benchmarks.paper_tables.work import Work
from lumitree.nerf.config import TrainConfig

CELL = "step"
_ROUNDS = 5


def cells(scale: Scale) -> list[Cell]:
    """One."""
    return [
        Cell(CELL, 0, {"networks": networks(scale)}, 4.0, measure),
    ]


def networks(scale: Scale) -> dict[str, TrainConfig]:
    """Settings whose step is timed: the scale's, and the paper's network on fewer rays."""
    chosen = {"of this scale": scale.network}
    if scale.name == "cpu":
        paper = SCALES["paper"].network
        chosen["of the paper, 128 rays"] = dataclasses.replace(paper, rays_per_batch=128)
    return chosen


def measure(work: Work) -> Measured:
    """Each network's step, and matrix products of the size of its layers."""
    return Measured({name: measure_step(each) for name, each in networks(work.scale).items()})


def flops(config: TrainConfig) -> float:
    """Multiplications and additions of one step in matrix products, forwards and backwards.

    The gradient of a layer costs twice its evaluation. Everything else, such as features, harmonics
    and transmittance, is left out.
    """
    features = 3 + 6 * config.num_frequencies
    skip = config.num_layers // 2 if config.num_layers >= 6 else None
    products = 0
    for index in range(config.num_layers):
        inputs = features if index == 0 else config.width
        products += (inputs + (features if index == skip else 0)) * config.width
    products += config.width * (1 + config.output_width)
    products += config.output_width * 3 * (config.l_max + 1) ** 2
    positions = config.rays_per_batch * (2 * config.num_coarse + config.num_fine)
    return 2 * 3 * products * positions


def measure_step(config: TrainConfig) -> dict[str, Any]:
    """Seconds of a step and of its parts, on random rays through the whole box."""
    import jax
    import numpy as np

    from lumitree.nerf.occupancy import full_occupancy
    from lumitree.nerf.ray_set import Batch
    from lumitree.nerf.step import initial_state, make_step

    rng = np.random.default_rng(0)
    count = config.rays_per_batch
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = rng.uniform(-0.5, 0.5, (count, 3)) - 3 * directions
    arrays = (origins, directions, rng.random((count, 3)), rng.random(count))
    batch = Batch(*(jax.numpy.asarray(each, jax.numpy.float32) for each in arrays))
    occupancy = jax.device_put(full_occupancy(np.ones(3)))
    graph, state = initial_state(config, 0.1)
    step = make_step(config, graph, 1.0)
    holder = [state]

    def one_step() -> Any:
        holder[0], loss, _ = step(holder[0], batch, occupancy)
        return loss

    seconds = _seconds(one_step)
    work = flops(config)
    chunks = _num_chunks(config)
    products = _product_seconds(config, chunks)
    networks = _network_seconds(config, chunks)
    return {
        "seconds": seconds,
        "networks_seconds": networks,
        "networks_share": networks / seconds,
        "flops": work,
        "flops_per_second": work / seconds,
        "layers_seconds": products,
        "layers_share": products / seconds,
        "peak_flops_per_second": _peak(),
        "chunks": chunks,
    }


def _num_chunks(config: TrainConfig) -> int:
    from lumitree.nerf import step

    return step._num_chunks(config, config.rays_per_batch)


def _product_seconds(config: TrainConfig, chunks: int) -> float:
    """Seconds of the step's matrix products alone, of the layers between hidden layers.

    As many as the step has, by arithmetic: the products of one hidden layer, forwards and
    backwards, times the arithmetic of the step over theirs.
    """
    import jax
    import jax.numpy as jnp

    rows = config.rays_per_batch * (2 * config.num_coarse + config.num_fine) // chunks
    width = config.width
    x = jnp.ones((rows, width), jnp.float32)
    w = jnp.full((width, width), 1e-3, jnp.float32)

    @jax.jit
    def layer(x: Any, w: Any) -> Any:
        y = x @ w
        return y @ w.T, x.T @ y

    seconds = _seconds(lambda: layer(x, w))
    return seconds * flops(config) / (3 * 2 * rows * width * width)


def _network_seconds(config: TrainConfig, chunks: int) -> float:
    """Seconds of one network at all positions of the step, forwards and backwards.

    With features and activations, in chunks as in the step. Coarse and fine network cost the same.
    """
    import jax
    import jax.numpy as jnp
    from flax import nnx

    from lumitree.nerf.network import NerfSH

    graph, weights = nnx.split(NerfSH(config, 0.1, nnx.Rngs(0)))
    rows = config.rays_per_batch * (2 * config.num_coarse + config.num_fine) // chunks
    positions = jax.random.uniform(jax.random.key(0), (chunks, rows, 3), minval=-1.0)

    def outputs(weights: Any, chunk: Any) -> Any:
        density, coefficients = nnx.merge(graph, weights)(chunk)
        return jnp.sum(density) + jnp.sum(coefficients**2)

    def add(total: Any, chunk: Any) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, jax.grad(outputs)(weights, chunk)), None

    @jax.jit
    def gradient(positions: Any) -> Any:
        return jax.lax.scan(add, jax.tree.map(jnp.zeros_like, weights), positions)[0]

    return _seconds(lambda: gradient(positions))


def _peak(side: int = 2048) -> float:
    """Floating-point operations a second of a large matrix product."""
    import jax
    import jax.numpy as jnp

    a = jnp.ones((side, side), jnp.float32)
    product = jax.jit(lambda a: a @ a)
    return 2 * side**3 / _seconds(lambda: product(a))


def _seconds(job: Callable[[], Any]) -> float:
    """Least wall time of a call: others on the machine only make it longer."""
    import jax

    jax.block_until_ready(job())
    times = []
    for _ in range(_ROUNDS):
        start = time.perf_counter()
        jax.block_until_ready(job())
        times.append(time.perf_counter() - start)
    return min(times)


def section(found: Found) -> str:
    """A row for each network."""
    heads = ["network", "s a step", "GFLOP a step", "GFLOP/s", "share of the peak"]
    heads += ["GFLOP/s of a 2048² product", "products of layers", "rest of the networks"]
    heads += ["everything else"]
    rows = []
    for name, values in found.values(CELL).items():
        rows.append(
            [
                name,
                f"{values['seconds']:.3f}",
                f"{values['flops'] / 1e9:.1f}",
                f"{values['flops_per_second'] / 1e9:.0f}",
                f"{values['flops_per_second'] / values['peak_flops_per_second']:.0%}",
                f"{values['peak_flops_per_second'] / 1e9:.0f}",
                f"{values['layers_share']:.0%}",
                f"{values['networks_share'] - values['layers_share']:.0%}",
                f"{1 - values['networks_share']:.0%}",
            ]
        )
    return found.table(heads, rows) if rows else f"{found.missing.capitalize()}.\n"
