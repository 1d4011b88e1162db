"""The network by the paper's settings for as long as there is time, with its octree."""

import dataclasses
import importlib
import time
from typing import Any

import lumitree
from benchmarks.common.tables import Table
from benchmarks.gpu_parts.part import Context, SkippedError
from benchmarks.paper_tables.scales import SCALES
from benchmarks.paper_tables.scoring import score_asset, score_network
from benchmarks.paper_tables.work import Work
from lumitree.core.backend import GPU_VARIANT, load_rgb
from lumitree.lamp.dataset import Dataset

# Steps that tell the speed, and the part of the time left that is planned for steps: compiling
# takes some of it again.
_FIRST_STEPS, _PLANNED = 300, 0.8
# On the page.
METRICS = ("psnr_linear", "psnr_linear_black", "psnr_mulaw", "ssim_linear", "opacity_rmse")


def check_jax(context: Context) -> None:
    """Skip a part of the network where it would be trained on the CPU beside a GPU.

    Raises:
        SkippedError: JAX is missing, or Mitsuba uses a GPU and JAX has none.
    """
    try:
        jax = importlib.import_module("jax")
    except ImportError as error:
        raise SkippedError(f"the network needs JAX: {error}") from error
    if context.variant == GPU_VARIANT and jax.default_backend() != "gpu":
        raise SkippedError("JAX has no GPU; pip install 'lumitree[cuda]' brings what it needs")


def learn(context: Context) -> dict[str, Any]:
    """Train by the paper's settings until the time is nearly spent; a later call continues.

    Returns:
        `steps` of `planned`; `seconds` of training; `rays_per_second`; `psnr` of held-out rays and
        `psnr_black`, dB; then `octree`, with its depth, seconds, leaves and bytes; and `scores`,
        the metrics on test views of the network and of the octree.
    """
    check_jax(context)
    load_rgb(context.variant)
    from lumitree.fit.network.train import train

    sizes, run = context.sizes, context.work / "run"
    scale = dataclasses.replace(SCALES[sizes.paper], network=sizes.network)
    work = Work(context.work / "paper" / sizes.paper, scale)
    dataset = work.views(sizes.network_lamp, scale.train, "train").path
    test = Dataset.open(work.views(sizes.network_lamp, scale.test, "test").path)
    steps, values = _FIRST_STEPS, {}
    while steps > 0:
        start = time.monotonic()
        result = train(dataset, run, sizes.network, resume=run.exists(), stop_after=steps)
        values = {
            name: getattr(result, name)
            for name in ("steps", "seconds", "rays_per_second", "psnr", "psnr_black")
        } | {"planned": sizes.network.num_steps}
        context.report(values)
        rate = steps / (time.monotonic() - start)
        left = context.seconds_left - sizes.reserve
        steps = min(int(_PLANNED * rate * left), sizes.network.num_steps - result.steps)
        if steps < _FIRST_STEPS:
            break
    start, path = time.monotonic(), context.work / "extracted.lumitree"
    depth, samples = sizes.octree
    lumitree.extract(run, path, tree_depth=depth, samples_per_leaf=samples, variant=context.variant)
    seconds, leaves = time.monotonic() - start, lumitree.load(path).num_leaves
    values["octree"] = {"depth": depth, "seconds": seconds, "leaves": leaves}
    values["octree"]["bytes"] = path.stat().st_size
    context.report(values)
    scores = {"network": score_network(run, test), "octree": score_asset(path, test)}
    values["scores"] = {name: each.metrics for name, each in scores.items()}
    return values


def show_learning(values: dict[str, Any]) -> str:
    """Markdown of `learn`, also of the values before its end."""
    text = (
        f"{values['steps']:,} of {values['planned']:,} steps in {values['seconds']:.0f} s, "
        f"{values['rays_per_second'] / 1e3:.0f} thousand rays a second; held-out rays of the "
        f"training views: {values['psnr']:.2f} dB, black {values['psnr_black']:.2f} dB.\n"
    )
    if octree := values.get("octree"):
        text += (
            f"Octree of depth {octree['depth']}: {octree['leaves']:,} leaves, "
            f"{octree['bytes'] / 1e6:.1f} MB, {octree['seconds']:.1f} s.\n"
        )
    if scores := values.get("scores"):
        rows = [[name, *(f"{each[name]:.4g}" for each in scores.values())] for name in METRICS]
        text += "\n" + Table(["metric, on test views", *scores], rows).markdown()
    return text
