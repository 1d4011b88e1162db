"""Table 4: transmittance laws, on `portica` and `dallas`, with several seeds."""

import dataclasses
import math
import statistics
from typing import Any

import numpy as np

from benchmarks.paper_tables.cells import Cell, Found, Measured
from benchmarks.paper_tables.scales import Scale
from benchmarks.paper_tables.scoring import costs, score_asset, score_network, test_views
from benchmarks.paper_tables.work import Work
from lumitree.asset.asset import Asset
from lumitree.asset.file import load
from lumitree.core.device import on_device
from lumitree.fit.network.config import TrainConfig

# Title and changes of the settings; docs/decisions/field.md has the literal reading of Eq. 3.
LAWS: dict[str, tuple[str, dict[str, Any]]] = {
    "exponential": ("exponential", {"law": "exponential"}),
    "linear": ("linear", {"law": "linear"}),
    "literal": ("linear, Eq. 3 as printed", {"law": "linear", "emission_weights": "literal"}),
}
# PSNR (dB) and SSIM of the paper, by lamp and law.
PAPER = {
    ("portica", "exponential"): (28.43737, 0.8566),
    ("portica", "linear"): (28.6694, 0.8594),
    ("dallas", "exponential"): (31.4002, 0.9371),
    ("dallas", "linear"): (31.5072, 0.9374),
}
# Both have an octree.
STORED = ("exponential", "linear")
QUERY_RAYS = 1 << 18


def settings(scale: Scale, law: str, longer: int = 1) -> TrainConfig:
    """Settings of a run; `longer` times the steps, with the schedule as long."""
    steps = longer * scale.network.num_steps
    return dataclasses.replace(scale.network, num_steps=steps, **LAWS[law][1])


def cells(scale: Scale) -> list[Cell]:
    """A training for each lamp, law and seed; longer ones; and the time of queries."""
    views = {"train": scale.train, "test": scale.test}
    octree = {"depth": scale.network_depth, "samples_per_leaf": scale.samples_per_leaf}

    def training(
        lamp: str, law: str, end: str, config: TrainConfig, seed: int, longer: int
    ) -> Cell:
        return Cell(
            f"4-{lamp}-{law}-{end}",
            4,
            {"lamp": lamp, "network": config, "seed": seed, **views, **octree},
            longer * scale.minutes[0],
            lambda work: measure(work, lamp, config, seed),
        )

    lamps = scale.transmittance_lamps
    found = [
        training(lamp, law, str(seed), settings(scale, law), seed, 1)
        for seed in range(scale.seeds)
        for lamp in lamps
        for law in LAWS
    ]
    if scale.longer > 1:
        found += [
            training(lamp, law, "longer", settings(scale, law, scale.longer), 0, scale.longer)
            for lamp in lamps
            for law in STORED
        ]
    for lamp in lamps:
        networks = {law: settings(scale, law) for law in STORED}
        found.append(
            Cell(
                f"4-{lamp}-query",
                4,
                {"lamp": lamp, "networks": networks, **octree, "rays": QUERY_RAYS},
                1.0,
                lambda work, lamp=lamp: measure_query(work, lamp),
            )
        )
    return found


def measure(work: Work, lamp: str, config: TrainConfig, seed: int) -> Measured:
    """Errors of the network, and of its octree where an asset can hold it."""
    run, views = work.run(lamp, config, seed), test_views(work, lamp)
    values: dict[str, Any] = {
        "network": score_network(run.path, views).metrics,
        "costs": costs(run),
    }
    if config.emission_weights == "decrease":
        asset = work.network_asset(lamp, config, seed)
        values |= {"octree": score_asset(asset.path, views).metrics, "costs": costs(run, asset)}
    return Measured(values)


def measure_query(work: Work, lamp: str) -> Measured:
    """CPU nanoseconds of an emission query, the laws taking turns."""
    from benchmarks.common.timing import interleaved, kernel
    from lumitree.octree.field import Field

    jobs, leaves = {}, {}
    for law in STORED:
        asset = load(work.network_asset(lamp, settings(work.scale, law)).path)
        field, lines = Field(asset), random_lines(asset, QUERY_RAYS, seed=0)
        jobs[law] = kernel(lambda field=field, lines=lines: field.emission(*lines))
        leaves[law] = asset.num_leaves
    seconds = interleaved(jobs, rounds=9, clock="cpu")
    nanoseconds = {law: each / QUERY_RAYS * 1e9 for law, each in seconds.items()}
    return Measured({"nanoseconds": nanoseconds, "leaves": leaves})


def random_lines(asset: Asset, count: int, seed: int) -> tuple[Any, Any]:
    """Origins and directions of random lines through the proxy box."""
    import mitsuba as mi

    random = np.random.default_rng(seed)
    d = random.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = random.uniform(-1, 1, (count, 3)) * asset.frame.half_extents - 3 * d
    return on_device(mi.Point3f, o), on_device(mi.Vector3f, d)


def section(found: Found) -> str:
    """Quality as mean ± standard error over seeds; the time of queries."""
    heads = ["lamp", "law", "paper: PSNR", "SSIM", "seeds", "network: PSNR", "SSIM"]
    heads += ["octree: PSNR", "SSIM", "RMSE of opacity (network)", "ns a query"]
    rows = []
    for lamp in found.scale.transmittance_lamps:
        times = found.values(f"4-{lamp}-query").get("nanoseconds", {})
        for law, (title, _) in LAWS.items():
            runs = [found.values(f"4-{lamp}-{law}-{seed}") for seed in range(found.scale.seeds)]
            runs = [each for each in runs if each]
            paper = PAPER.get((lamp, law))
            row = [lamp, title]
            row += ["", ""] if paper is None else [f"{paper[0]:.2f}", f"{paper[1]:.4f}"]
            row.append(str(len(runs)))
            for part in ("network", "octree"):
                if part == "octree" and law == "literal":
                    row += ["no asset has it"] * 2
                    continue
                row += [
                    _mean(found, runs, part, "psnr_linear", 2),
                    _mean(found, runs, part, "ssim_linear", 4),
                ]
            row.append(_mean(found, runs, "network", "opacity_rmse", 4))
            row.append("" if law == "literal" else found.number(times.get(law), 0))
            rows.append(row)
    text = found.table(heads, rows, left=2)
    if found.scale.longer > 1:
        text += f"\n{_longer(found)}"
    return text


def _longer(found: Found) -> str:
    steps = found.scale.network.num_steps
    ends = {"0": steps, "longer": found.scale.longer * steps}
    heads = ["lamp", "law"]
    heads += [f"{name}, {count} steps" for name in ("PSNR", "SSIM") for count in ends.values()]
    rows = []
    for lamp in found.scale.transmittance_lamps:
        for law in STORED:
            runs = [found.values(f"4-{lamp}-{law}-{end}").get("network", {}) for end in ends]
            row = [lamp, LAWS[law][0]]
            row += [found.number(run.get("psnr_linear"), 2) for run in runs]
            row += [found.number(run.get("ssim_linear"), 4) for run in runs]
            rows.append(row)
    return f"The networks of the first seed, trained for longer:\n\n{found.table(heads, rows, 2)}"


def _mean(found: Found, runs: list[dict[str, Any]], part: str, name: str, digits: int) -> str:
    values = [run[part][name] for run in runs]
    if not values:
        return found.missing
    mean = statistics.fmean(values)
    if len(values) == 1:
        return f"{mean:.{digits}f}"
    error = statistics.stdev(values) / math.sqrt(len(values))
    return f"{mean:.{digits}f} ± {error:.{digits}f}"
