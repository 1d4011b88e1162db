"""Methods that make a representation of a luminaire from its views, with the same time for each."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

BASELINE = "network, octree"
TREE_DEPTH = 7
SAMPLES_PER_LEAF = 64
# Steps by which the speed of the paper's network is measured.
_TIMED_STEPS = 20


def fits(
    name: str, folder: Path, seconds: float, seed: int, converge: bool
) -> dict[str, Callable[[], Any]]:
    """What is compared, by name: a function that makes a `ZhuLuminaire` or the path of an asset.

    Args:
        name: of the luminaire.
        folder: holds the views in `train`; assets and runs are made in it.
        seconds: that each method gets.
        converge: whether the networks of Zhu et al. are trained to convergence too.
    """
    import lumitree

    views = folder / "train"

    config = dataclasses.replace(
        lumitree.BakeConfig.preview(),
        tree_depth=TREE_DEPTH,
        time=seconds,
        parts=("field",),
        irradiance_paths=0,
        seed=seed,
    )

    def direct() -> Path:
        output = folder / "direct.lumitree"
        lumitree.bake(name, output, config, progress=None)
        return output

    def from_views() -> Path:
        output = folder / "views.lumitree"
        lumitree.bake_views(views, output, config.octree_fit, progress=None)
        return output

    chosen: dict[str, Callable[[], Any]] = {"Zhu et al.": lambda: zhu(views, seconds, seed)}
    if converge:
        chosen["Zhu et al., converged"] = lambda: zhu(views, None, seed)
    return chosen | {
        BASELINE: lambda: network(views, folder, seconds, seed),
        "direct, views": from_views,
        "direct": direct,
    }


def zhu(views: Path, seconds: float | None, seed: int) -> Any:
    """The networks of Zhu et al., trained on the views."""
    from benchmarks.baselines.descent import Budget
    from benchmarks.baselines.zhu import train_zhu
    from benchmarks.baselines.zhu_networks import ZhuConfig
    from lumitree.core.dataset import Dataset
    from lumitree.fit.network.ray_set import load_rays

    dataset = Dataset.open(views)
    rays, _ = load_rays(dataset, "straight_through", skip_empty=False)
    half = dataset.manifest.local_frame.half_extents
    return train_zhu(rays, half, ZhuConfig(seed=seed), Budget(seconds))


def network(views: Path, folder: Path, seconds: float, seed: int) -> Path:
    """The paper's network, trained on the views, as an asset."""
    import lumitree
    from lumitree.fit.network.config import PRESETS
    from lumitree.fit.network.train import train

    config = dataclasses.replace(PRESETS["preview"], seed=seed)
    steps = max(1, round(seconds * _steps_per_second(views, config)))
    train(views, folder / "run", dataclasses.replace(config, num_steps=steps))
    output = folder / "network.lumitree"
    lumitree.extract(
        folder / "run",
        output,
        tree_depth=TREE_DEPTH,
        samples_per_leaf=SAMPLES_PER_LEAF,
        progress=None,
    )
    return output


def _steps_per_second(views: Path, config: Any) -> float:
    """Speed of the training, with the drawing of rays and without compilation."""
    import jax

    from lumitree.core.dataset import Dataset
    from lumitree.fit.network.ray_set import load_rays
    from lumitree.fit.network.step import initial_state, make_step, state_sharding

    rays, occupancy = load_rays(Dataset.open(views), config.opacity_kind, config.skip_empty)
    graph, state = initial_state(config, rays.typical_part)
    state, occupancy = jax.device_put((state, occupancy), state_sharding(config))
    step = make_step(config, graph, rays.max_radiance)
    start = 0.0
    for index in range(_TIMED_STEPS + 1):
        if index == 1:  # the first compiles
            jax.block_until_ready(state)
            start = time.perf_counter()
        batch = rays.draw(config.seed, index, config.rays_per_batch)
        state, _, _ = step(state, batch, occupancy)
    jax.block_until_ready(state)
    return _TIMED_STEPS / (time.perf_counter() - start)
