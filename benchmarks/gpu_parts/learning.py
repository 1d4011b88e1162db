"""The network: a step, the paper's settings for as long as there is time, and its octree."""

import time
from pathlib import Path
from typing import Any

import lumitree
from benchmarks.gpu_parts.part import Context, UnfinishedError, read_json
from benchmarks.paper_tables.scales import SCALES
from benchmarks.paper_tables.work import Work
from lumitree.core.backend import load_rgb

# Steps that tell the speed, and the least that is worth starting.
_FIRST_STEPS, _LEAST_STEPS = 300, 200
# Seconds in which a run is saved and evaluated.
_MARGIN = 20.0
# Part of the time left that is planned for steps; compiling takes some of it again.
_PLANNED = 0.8


def measure_paper(context: Context, cell: str) -> dict[str, Any]:
    """A cell of the benchmark `paper`.

    Returns:
        Its values and the command that measures it.
    """
    context.check_jax()
    scale = context.sizes.paper
    page = context.folder / "paper" / scale / "page.md"
    arguments = ["--scale", scale, "--cell", cell, "--page", page, "--work", context.work / "paper"]
    found = context.benchmark("paper", *arguments)
    record = read_json(context.folder / "paper" / scale / f"{cell}.json")
    return {"command": found["command"], "values": record["values"], "costs": record["seconds"]}


def train_network(context: Context) -> dict[str, Any]:
    """Train by the paper's settings until the time is spent; a later call continues.

    Returns:
        `steps` of `planned`; `seconds` of training; `rays_per_second`; `psnr` of held-out rays and
        `psnr_black`, dB; and `history`, the PSNR by step and second.

    Raises:
        UnfinishedError: the time is spent before the last step.
    """
    context.check_jax()
    load_rgb(context.variant)
    from lumitree.fit.network.run import HISTORY
    from lumitree.fit.network.train import train

    sizes, run = context.sizes, run_folder(context)
    work = Work(context.work / "paper" / sizes.paper, SCALES[sizes.paper])
    dataset = work.views(sizes.network_lamp, sizes.views, "train").path
    steps = _FIRST_STEPS
    while True:
        start = time.monotonic()
        result = train(dataset, run, sizes.network, resume=run.exists(), stop_after=steps)
        values = {
            "steps": result.steps,
            "planned": sizes.network.num_steps,
            "seconds": result.seconds,
            "rays_per_second": result.rays_per_second,
            "psnr": result.psnr,
            "psnr_black": result.psnr_black,
            "history": read_json(run / HISTORY),
        }
        context.report(values)
        if result.steps >= sizes.network.num_steps:
            return values
        rate = steps / (time.monotonic() - start)
        steps = int(_PLANNED * rate * (context.seconds_left - _MARGIN))
        if steps < _LEAST_STEPS or result.stopped_by is not None:
            raise UnfinishedError


def extract_octree(context: Context) -> dict[str, Any]:
    """The octree of the network that is trained so far.

    Raises:
        UnfinishedError: nothing is trained yet.
    """
    context.check_jax()
    run = run_folder(context)
    if not (run / "history.json").is_file():
        raise UnfinishedError("the network is not trained yet")
    depth, samples = context.sizes.extraction
    start = time.monotonic()
    found = lumitree.extract(
        run,
        context.work / "extracted.lumitree",
        tree_depth=depth,
        samples_per_leaf=samples,
        variant=context.variant,
    )
    return {
        "depth": depth,
        "samples_per_leaf": samples,
        "seconds": time.monotonic() - start,
        "leaves": found.asset.num_leaves,
        "bytes": (context.work / "extracted.lumitree").stat().st_size,
    }


def run_folder(context: Context) -> Path:
    """Folder of the training."""
    return context.work / "run"
