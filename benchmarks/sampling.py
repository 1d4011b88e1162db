"""Variance and time of sampling by emission against uniform sampling of the proxy.

    python -m benchmarks sampling --rooms FOLDER --assets FOLDER --data FOLDER

For the pairs of `equal_quality_pairs.toml`. Direct and full light. Variances are of pixels beside
the lamp, over the square of their mean, without the 0.1 % of largest; times are medians of passes,
the two samplings taking turns. Uniform sampling is the baseline. Writes `sampling.md` and
`sampling.json`.
"""

import argparse
import math
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.options import add_pixels, add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import Job, interleaved, kernel, ratios
from benchmarks.equal_error.pairs import PAIRS, Pair, add_folders, read_pairs, shows_lamp

PATH_DEPTHS = {"direct": 2, "full": 8}
BASELINE = "uniform"
SAMPLINGS = (BASELINE, "emission")
TRIMMED = 0.001
SHADING_POINTS = {"below": (0, -6, 0), "far below": (0, -30, 3), "beside": (4, 0, 0.5)}
POINT_SAMPLES = 1 << 17


def scenes(pair: Pair, width: int) -> dict:
    """The room with the lamp in it, by kind of sampling."""
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import (
        PlacedLuminaire,
        load_scene,
        place_luminaires,
        set_film_width,
    )

    scene, _ = load_scene(pair.room)
    set_film_width(scene, width)
    place = PlacedLuminaire(Placement(pair.asset, pair.at, pair.size))
    return {kind: place_luminaires(scene, [place], sampling=kind) for kind in SAMPLINGS}


def measure_paths(by_kind: dict, path_depth: int, options: argparse.Namespace) -> dict:
    """Variance and time of a sample a pixel, by kind of sampling."""
    import mitsuba as mi

    from lumitree.rendering.passes import Budget, render_passes

    integrator = {"type": "lumitree_path", "max_depth": path_depth, "rr_depth": 1000}
    beside = ~shows_lamp(by_kind["emission"])[..., 0]
    passes: dict = {kind: [] for kind in SAMPLINGS}

    def job(kind: str) -> Job:
        def render(index: int) -> None:
            seed = options.seed + 1 + index
            image = render_passes(
                by_kind[kind], mi.load_dict(integrator), Budget(options.spp), seed=seed
            ).radiance
            passes[kind].append(image)

        return lambda index: lambda: render(index)

    times = interleaved({kind: job(kind) for kind in SAMPLINGS}, options.passes)
    # The first pass compiles, and is not timed.
    images = {kind: [each[beside].mean(axis=1) for each in passes[kind][1:]] for kind in passes}
    mean = np.mean(images["emission"], axis=0)
    scale = mean**2 + (0.01 * mean.mean()) ** 2
    row = {}
    for kind in SAMPLINGS:
        relative = np.sort(np.var(images[kind], axis=0, ddof=1) * options.spp / scale)
        kept = relative[: max(1, round(len(relative) * (1 - TRIMMED)))]
        row[f"variance_{kind}"] = float(kept.mean())
        row[f"seconds_{kind}"] = times[kind] / options.spp
    ratio = row["variance_uniform"] / row["variance_emission"]
    time_ratio = ratios(times, BASELINE)["emission"]
    row |= {"variance_ratio": ratio, "error_ratio_equal_time": math.sqrt(ratio / time_ratio)}
    return row


def measure_points(asset: str, options: argparse.Namespace) -> dict:
    """Without a room: variance ratios from points about the lamp, and time a sample."""
    import drjit as dr

    from lumitree.rendering.asset_cache import open_field
    from lumitree.rendering.sampling.emitter_sampling import EmitterSampler
    from lumitree.rendering.sampling.light_leaves import light_leaves
    from lumitree.rendering.sampling.proxy import BoxProxy

    field = open_field(asset)
    half = field.asset.frame.half_extents
    start = time.perf_counter()
    leaves = light_leaves(field)
    dr.sync_thread()
    row: dict = {"table_seconds": time.perf_counter() - start}
    proxy = BoxProxy(half)
    samplers = {
        "uniform": EmitterSampler(proxy, field, None),
        "emission": EmitterSampler(proxy, field, leaves),
    }
    points = {
        **SHADING_POINTS,
        "above": (0.5, 3, 1),
        "near": (0.2, -float(half[1]) - 0.2, 0.1),
        "corner": tuple((1.1 * half).tolist()),
    }
    timed: dict[str, Job] = {}
    for name, place in points.items():
        variance = {}
        for kind, sampler in samplers.items():
            variance[kind], jobs = _measure_point(proxy, sampler, place, options.seed)
            if name == "below":
                timed |= {f"ns_{job}_{kind}": kernel(record) for job, record in jobs.items()}
        row[name] = variance[BASELINE] / variance["emission"]
    times = interleaved(timed)
    return row | {name: seconds / POINT_SAMPLES * 1e9 for name, seconds in times.items()}


def _measure_point(
    proxy: Any, sampler: Any, place: tuple[float, ...], seed: int
) -> tuple[float, dict[str, Callable[[], Any]]]:
    """Variance of the light that arrives at a point, and the parts of a sample, to be timed."""
    import drjit as dr
    import mitsuba as mi

    random = mi.PCG32(POINT_SAMPLES, 5 + seed)
    origin = mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in place))
    uniform = mi.Point2f(random.next_float32(), random.next_float32())
    dr.eval(uniform)
    direction, reach = sampler.sample(origin, uniform)
    distance, _, enters = proxy.enter(origin, direction)
    entry = origin + distance * direction
    dr.eval(direction, reach, distance, enters, entry)
    radiance, _, pdf = sampler.eval(origin, entry, direction, distance, enters, reach)
    weight = dr.mean(radiance) * dr.select(pdf > 0, dr.rcp(pdf), 0)
    return float(np.array(weight, np.float64).var()), {
        "sample": lambda: sampler.sample(origin, uniform),
        "eval": lambda: sampler.eval(origin, entry, direction, distance, enters, reach),
        "pdf": lambda: sampler.pdf(origin, entry, direction, distance, enters),
    }


def path_table(rows: list[dict]) -> Table:
    """A line for each pair and light."""
    heads = ["lamp, room", "light", "variance ratio at equal samples"]
    heads += ["error ratio at equal time", "s a sample, uniform", "by emission"]
    lines = [
        [
            f"{row['luminaire']}, {row['room']}",
            row["light"],
            f"{row['variance_ratio']:.1f}",
            f"{row['error_ratio_equal_time']:.2f}",
            f"{row['seconds_uniform']:.3f}",
            f"{row['seconds_emission']:.3f}",
        ]
        for row in rows
    ]
    return Table(heads, lines, left=2)


def point_table(rows: list[dict]) -> Table:
    """A line for each lamp: variance ratios from points, and times of a sample's parts."""
    lines = [[v if isinstance(v, str) else f"{v:.3g}" for v in row.values()] for row in rows]
    return Table(list(rows[0]), lines)


def means(rows: list[dict]) -> str:
    """Geometric means and least values of the ratios, a line each."""
    lines = []
    for name in ("variance_ratio", "error_ratio_equal_time"):
        values = [row[name] for row in rows]
        mean = math.exp(statistics.fmean(map(math.log, values)))
        lines.append(f"* {name}: geometric mean {mean:.2f}, least {min(values):.2f}\n")
    return "".join(lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--pairs", metavar="FILE", type=Path, default=PAIRS, help="of pairs, TOML")
    add_folders(parser)
    add_pixels(parser, "--width", 64, 16)
    parser.add_argument("--passes", type=int, metavar="N", default=8, help="timed, at least 5")
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    pairs = read_pairs(options.pairs, options.rooms, options.assets, options.data)
    results = Results(
        options,
        width=options.width,
        samples_per_pixel=options.spp,
        passes=options.passes,
        baseline=f"{BASELINE} sampling",
    )
    points = []
    for pair in pairs:
        points.append({"luminaire": pair.lamp_name} | measure_points(pair.asset, options))
    print(point_table(points).text(), flush=True)
    rows = []
    for pair in pairs:
        by_kind = scenes(pair, options.width)
        for light, depth in PATH_DEPTHS.items():
            names = {"luminaire": pair.lamp_name, "room": pair.room_name, "light": light}
            rows.append(names | measure_paths(by_kind, depth, options))
    print(path_table(rows).text())
    print(means(rows))
    facts = results.setting()
    text = f"# Sampling by emission\n\n{path_table(rows).markdown()}\n{means(rows)}\n"
    text += f"## From points\n\n{point_table(points).markdown()}\n{notes(facts)}"
    results.write({"setting": facts, "pairs": rows, "points": points}, text)
