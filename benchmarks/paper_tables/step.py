"""One training step: its arithmetic, its speed against the machine's, and what limits it."""

import dataclasses
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from benchmarks.paper_tables.cells import Cell, Measured
from benchmarks.paper_tables.found import Found
from benchmarks.paper_tables.scales import SCALES, Scale
from benchmarks.paper_tables.work import Work
from lumitree.fit.network.config import TrainConfig

CELL = "step"
_ROUNDS = 7
# Of the large matrix product.
_SIDE = 2048


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
    """Each network's step."""
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

    from lumitree.fit.network.occupancy import full_occupancy
    from lumitree.fit.network.ray_set import Batch
    from lumitree.fit.network.step import initial_state, make_step

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

    work = flops(config)
    chunks = _num_chunks(config)
    seconds = _seconds(
        {
            "step": one_step,
            "networks": _networks(config, chunks),
            "peak": _large_product(),
        }
    )
    return {
        "seconds": seconds["step"],
        "networks_seconds": seconds["networks"],
        "networks_share": seconds["networks"] / seconds["step"],
        "flops": work,
        "flops_per_second": work / seconds["step"],
        "peak_flops_per_second": 2 * _SIDE**3 / seconds["peak"],
        "chunks": chunks,
    }


def _num_chunks(config: TrainConfig) -> int:
    from lumitree.fit.network import step

    return step._num_chunks(config, config.rays_per_batch)


def _rows(config: TrainConfig, chunks: int) -> tuple[int, int]:
    """Positions of a chunk of rays at which the coarse and the fine network are evaluated."""
    rays = config.rays_per_batch // chunks
    return rays * config.num_coarse, rays * (config.num_coarse + config.num_fine)


def _networks(config: TrainConfig, chunks: int) -> Callable[[], Any]:
    """Both networks at all positions of the step, forwards and backwards, in chunks as there.

    With features and activations. Weights are arguments: as constants of the kernel they make it
    half as fast.
    """
    import jax
    import jax.numpy as jnp
    from flax import nnx

    from lumitree.fit.network.network import NerfSH

    graph, weights = nnx.split(NerfSH(config, 0.1, nnx.Rngs(0)))
    positions = tuple(
        jax.random.uniform(jax.random.key(0), (chunks, rows, 3), minval=-1.0)
        for rows in _rows(config, chunks)
    )

    def outputs(weights: Any, chunk: Any) -> Any:
        total = jnp.zeros(())
        for each, positions in zip(weights, chunk, strict=True):
            density, coefficients = nnx.merge(graph, each)(positions)
            total += jnp.sum(density) + jnp.sum(coefficients**2)
        return total

    def gradient(weights: Any, positions: Any) -> Any:
        def add(total: Any, chunk: Any) -> tuple[Any, None]:
            return jax.tree.map(jnp.add, total, jax.grad(outputs)(weights, chunk)), None

        return jax.lax.scan(add, jax.tree.map(jnp.zeros_like, weights), positions)[0]

    compiled = jax.jit(gradient)
    return lambda: compiled((weights, weights), positions)


def _large_product() -> Callable[[], Any]:
    """A matrix product that reaches the machine's speed."""
    import jax
    import jax.numpy as jnp

    a = jnp.ones((_SIDE, _SIDE), jnp.float32)
    product = jax.jit(lambda a: a @ a)
    return lambda: product(a)


def _seconds(jobs: Mapping[str, Callable[[], Any]]) -> dict[str, float]:
    """Least wall time of each job by name: others on the machine only make it longer.

    The jobs take turns, so that a machine's changes of speed meet all of them alike.
    """
    import jax

    least = dict.fromkeys(jobs, math.inf)
    for index in range(_ROUNDS + 1):
        for name, job in jobs.items():
            start = time.perf_counter()
            jax.block_until_ready(job())
            if index:  # the first call compiles
                least[name] = min(least[name], time.perf_counter() - start)
    return least


def section(found: Found) -> str:
    """A row for each network."""
    heads = ["network", "s a step", "GFLOP a step", "GFLOP/s", "share of the peak"]
    heads += ["GFLOP/s of a 2048² product", "networks", "everything else"]
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
                f"{values['networks_share']:.0%}",
                f"{1 - values['networks_share']:.0%}",
            ]
        )
    return found.table(heads, rows) if rows else f"{found.missing.capitalize()}.\n"
