"""The network: a step, the paper's settings for as long as there is time, and its octree."""

import time
from pathlib import Path
from typing import Any

import lumitree
from benchmarks.gpu_parts.part import Context, UnfinishedError, read_json
from benchmarks.paper_tables.running import Setting, run_cell
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
        `command`, which measures it; its `values` and `seconds`.

    Raises:
        UnfinishedError: the time is spent before it is complete.
    """
    context.check_jax()
    scale = context.sizes.paper
    command = f"python -m benchmarks paper --scale {scale} --cell {cell}"
    setting = Setting(
        scale=scale,
        results=context.benchmarks,
        images=context.work / "images",
        work=context.work / "paper",
        rooms=context.work / "rooms",
        variant=context.variant,
        command=f"{command} --variant {context.variant}",
        end=context.end - _MARGIN,
    )
    if not run_cell(cell, setting):
        raise UnfinishedError
    record = setting.store.record(cell)
    assert record is not None
    return {name: record[name] for name in ("values", "seconds")} | {"command": setting.command}


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
    """Octrees of the network that is trained so far, one depth after the other.

    Returns:
        `steps` of the training, and `octrees`: of each its `depth`, `seconds`, `leaves` and
        `bytes`, and `samples_per_leaf`.

    Raises:
        UnfinishedError: nothing is trained yet.
    """
    context.check_jax()
    from lumitree.fit.network.run import HISTORY

    history = read_json(run_folder(context) / HISTORY)
    if not history:
        raise UnfinishedError("the network is not trained yet")
    depths, samples = context.sizes.extraction
    values: dict[str, Any] = {"steps": history[-1]["step"], "octrees": []}
    for depth in depths:
        start = time.monotonic()
        path = context.work / "extracted.lumitree"
        found = lumitree.extract(
            run_folder(context),
            path,
            tree_depth=depth,
            samples_per_leaf=samples,
            variant=context.variant,
        )
        octree = {"depth": depth, "samples_per_leaf": samples}
        octree |= {"seconds": time.monotonic() - start, "leaves": found.asset.num_leaves}
        values["octrees"].append(octree | {"bytes": path.stat().st_size})
        context.report(values)
    return values


def run_folder(context: Context) -> Path:
    """Folder of the training."""
    return context.work / "run"
