"""Table 3: bands of the spherical harmonics, on `cluster`, by network and by octree fit."""

import dataclasses
import statistics
from typing import Any

from benchmarks.common.timing import Clock
from benchmarks.paper_tables.cells import Cell, Found, Measured
from benchmarks.paper_tables.scales import Scale
from benchmarks.paper_tables.scoring import bytes_of, costs, score_asset, test_views
from benchmarks.paper_tables.work import Built, Work
from lumitree.asset.file import load
from lumitree.lamp.dataset import Dataset

# PSNR (dB) and SSIM of the paper, by l_max.
PAPER = {2: (27.7260, 0.8872), 3: (27.6958, 0.8860), 4: (27.7367, 0.8859)}
METHODS = ("network", "direct")
_TIMED_VIEWS = 5


def lamp_of(scale: Scale) -> str:
    """The lamp of the paper's table, where the scale has it."""
    return "cluster" if "cluster" in scale.lamps else scale.lamps[0]


def cells(scale: Scale) -> list[Cell]:
    """For each l_max a network with its octree, and an octree fit."""
    lamp, found = lamp_of(scale), []
    for l_max in scale.bands:
        config = dataclasses.replace(scale.network, l_max=l_max)
        network = {"train": scale.train, "network": config, "depth": scale.network_depth}
        network |= {"samples_per_leaf": scale.samples_per_leaf}
        direct = {"direct": scale.direct, "l_max": l_max}
        for method, parameters in (("network", network), ("direct", direct)):
            found.append(
                Cell(
                    f"3-{l_max}-{method}",
                    3,
                    {"lamp": lamp, "test": scale.test, **parameters},
                    scale.minutes[METHODS.index(method)],
                    lambda work, l_max=l_max, method=method: measure(work, l_max, method),
                )
            )
    return found


def measure(work: Work, l_max: int, method: str) -> Measured:
    """Errors, bytes, and CPU seconds a view."""
    lamp = lamp_of(work.scale)
    if method == "network":
        asset = work.network_asset(lamp, dataclasses.replace(work.scale.network, l_max=l_max))
    else:
        asset = work.direct_asset(lamp, work.scale.direct, l_max)
    dataset = test_views(work, lamp)
    values: dict[str, Any] = {
        "metrics": score_asset(asset.path, dataset).metrics,
        "bytes": bytes_of(asset),
        "leaves": load(asset.path).num_leaves,
        "view_seconds": view_seconds(asset, dataset),
        "costs": costs(asset),
    }
    return Measured(values)


def view_seconds(asset: Built, dataset: Dataset) -> float:
    """CPU seconds of a view of 16 rays a pixel; the first, which compiles, does not count."""
    from lumitree.rendering.asset_images import baked_view

    opened, frames = load(asset.path), dataset.manifest.frames
    seconds = []
    for index in range(_TIMED_VIEWS + 1):
        clock = Clock()
        baked_view(opened, dataset.manifest, frames[index % len(frames)])
        seconds.append(clock.read()["cpu"])
    return statistics.median(seconds[1:])


def section(found: Found) -> str:
    """A row for each l_max."""
    heads = ["l_max", "paper: PSNR", "SSIM"]
    for method in METHODS:
        heads += [f"{method}: PSNR", "SSIM", "MB", "bytes a leaf", "CPU s a view"]
    rows = []
    for l_max in found.scale.bands:
        paper = PAPER.get(l_max)
        row = [str(l_max)]
        row += ["", ""] if paper is None else [f"{paper[0]:.2f}", f"{paper[1]:.4f}"]
        for method in METHODS:
            values = found.values(f"3-{l_max}-{method}")
            metrics = values.get("metrics", {})
            size, leaves = values.get("bytes"), values.get("leaves")
            row += [
                found.number(metrics.get("psnr_linear"), 2),
                found.number(metrics.get("ssim_linear"), 4),
                found.number(None if size is None else size / 1e6, 1),
                found.number(None if size is None else size / leaves, 0),
                found.number(values.get("view_seconds"), 2),
            ]
        rows.append(row)
    return found.table(heads, rows, left=0)
