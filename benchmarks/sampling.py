"""Sampling by emission against uniform sampling of the proxy, in the same run.

    python benchmarks/sampling.py --rooms FOLDER --assets FOLDER --data FOLDER [--write]

For the pairs of `equal_quality_pairs.toml`. Direct and full light. Variances are of pixels beside
the lamp, over the square of their mean, without the 0.1 % of largest; times are medians of passes,
the two samplings taking turns. `--write` puts `sampling.md` and `sampling.json` into the results.
"""

import argparse
import math
import statistics
import time
from pathlib import Path

import numpy as np

from equal_quality import Pair, read_pairs, shows_lamp
from lumitree.core.backend import load_mitsuba
from lumitree.core.files import atomic_path, write_json
from setting import setting

HERE = Path(__file__).parent
RESULTS, PAIRS = HERE / "results", HERE / "equal_quality_pairs.toml"
WIDTH, SAMPLES, PASSES = 64, 16, 8
PATH_DEPTHS = {"direct": 2, "full": 8}
SAMPLINGS = ("uniform", "emission")
TRIMMED = 0.001
SHADING_POINTS = {"below": (0, -6, 0), "far below": (0, -30, 3), "beside": (4, 0, 0.5)}
POINT_SAMPLES = 1 << 17


def scenes(pair: Pair) -> dict:
    """The room with the lamp in it, by kind of sampling."""
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import (
        PlacedLuminaire,
        load_scene,
        place_luminaires,
        set_film_width,
    )

    scene, _ = load_scene(pair.room)
    set_film_width(scene, WIDTH)
    place = PlacedLuminaire(Placement(pair.asset, pair.at, pair.size))
    return {kind: place_luminaires(scene, [place], sampling=kind) for kind in SAMPLINGS}


def measure_paths(by_kind: dict, path_depth: int) -> dict:
    """Variance and time of a sample a pixel, by kind of sampling."""
    import mitsuba as mi

    from lumitree.rendering.scene import render_scene

    def integrator(depth):
        return mi.load_dict({"type": "lumitree_path", "max_depth": depth, "rr_depth": 1000})

    lamp_seen = shows_lamp(by_kind["emission"])[..., 0]
    images: dict = {kind: [] for kind in SAMPLINGS}
    seconds: dict = {kind: [] for kind in SAMPLINGS}
    for index in range(PASSES + 1):
        for kind, scene in by_kind.items():
            start = time.perf_counter()
            image = render_scene(scene, integrator(path_depth), SAMPLES, seed=1 + index)
            if index:  # the first compiles
                seconds[kind].append(time.perf_counter() - start)
                images[kind].append(image[~lamp_seen].mean(axis=1))
    mean = np.mean(images["emission"], axis=0)
    scale = mean**2 + (0.01 * mean.mean()) ** 2
    row = {}
    for kind in SAMPLINGS:
        relative = np.sort(np.var(images[kind], axis=0, ddof=1) * SAMPLES / scale)
        kept = relative[: max(1, round(len(relative) * (1 - TRIMMED)))]
        row[f"variance_{kind}"] = float(kept.mean())
        row[f"seconds_{kind}"] = statistics.median(seconds[kind]) / SAMPLES
    ratio = row["variance_uniform"] / row["variance_emission"]
    time_ratio = row["seconds_uniform"] / row["seconds_emission"]
    row |= {"variance_ratio": ratio, "error_ratio_equal_time": math.sqrt(ratio * time_ratio)}
    return row


def measure_points(asset: str) -> dict:
    """Without a room: variance ratios from points about the lamp, and time a sample."""
    import drjit as dr

    from lumitree.rendering.emitter_sampling import EmitterSampler
    from lumitree.rendering.light_leaves import light_leaves
    from lumitree.rendering.opened import open_field
    from lumitree.rendering.proxy import make_proxy

    field = open_field(asset)
    half = field.asset.half_extents
    start = time.perf_counter()
    leaves = light_leaves(field)
    dr.sync_thread()
    row: dict = {"table_seconds": time.perf_counter() - start}
    proxy = make_proxy("box", half)
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
    for name, place in points.items():
        variance = {}
        for kind, sampler in samplers.items():
            variance[kind], jobs = _measure_point(proxy, sampler, place)
            if name == "below":
                row |= {f"ns_{job}_{kind}": _nanoseconds(run) for job, run in jobs.items()}
        row[name] = variance["uniform"] / variance["emission"]
    return row


def _measure_point(proxy, sampler, place: tuple[float, ...]) -> tuple[float, dict]:
    """Variance of the light that arrives at a point, and the parts of a sample, to be timed."""
    import drjit as dr
    import mitsuba as mi

    random = mi.PCG32(POINT_SAMPLES, 5)
    origin = mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in place))
    uniform = mi.Point2f(random.next_float32(), random.next_float32())
    dr.eval(uniform)
    direction, reach = sampler.sample(origin, uniform)
    distance, _, enters = proxy.enter(origin, direction)
    entry = origin + distance * direction
    dr.eval(direction, reach, distance, enters, entry)
    radiance, _, pdf = sampler.eval(entry, direction, distance, enters, reach)
    weight = dr.mean(radiance) * dr.select(pdf > 0, dr.rcp(pdf), 0)
    return float(np.array(weight, np.float64).var()), {
        "sample": lambda: sampler.sample(origin, uniform),
        "eval": lambda: sampler.eval(entry, direction, distance, enters, reach),
        "pdf": lambda: sampler.pdf(entry, direction, distance, enters),
    }


def _nanoseconds(job) -> float:
    """Time a lane of a kernel, its compilation apart: median of 5."""
    import drjit as dr

    times = []
    for _ in range(6):
        start = time.perf_counter()
        dr.eval(job())
        dr.sync_thread()
        times.append(time.perf_counter() - start)
    return statistics.median(times[1:]) / POINT_SAMPLES * 1e9


def table(report: dict) -> str:
    lines = [
        "# Sampling by emission\n",
        f"{report['setting']['device']}, {report['setting']['variant']}, {WIDTH} "
        f"pixels wide, {PASSES} passes of {SAMPLES} samples.",
        "",
        "| lamp, room | light | variance ratio at equal samples | error ratio at equal time |"
        " s a sample, uniform | by emission |",
        "|---|---|---|---|---|---|",
    ]
    for row in report["pairs"]:
        lines.append(
            f"| {row['luminaire']}, {row['room']} | {row['light']} | {row['variance_ratio']:.1f} | "
            f"{row['error_ratio_equal_time']:.2f} | {row['seconds_uniform']:.3f} | "
            f"{row['seconds_emission']:.3f} |"
        )
    for name in ("variance_ratio", "error_ratio_equal_time"):
        values = [row[name] for row in report["pairs"]]
        mean = math.exp(statistics.fmean(map(math.log, values)))
        lines.append(f"\n{name}: geometric mean {mean:.2f}, least {min(values):.2f}")
    lines += ["", "| from points, " + " | ".join(report["points"][0]) + " |"]
    lines += ["|---" * (1 + len(report["points"][0])) + "|"]
    for row in report["points"]:
        values = (v if isinstance(v, str) else f"{v:.3g}" for v in row.values())
        lines.append("| | " + " | ".join(values) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--pairs", type=Path, default=PAIRS)
    for name in ("rooms", "assets", "data"):
        parser.add_argument(f"--{name}", type=Path, required=True, help="see equal_quality.py")
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    load_mitsuba()
    pairs = read_pairs(arguments.pairs, arguments.rooms, arguments.assets, arguments.data)
    report: dict = {"setting": setting(), "pairs": [], "points": []}
    for pair in pairs:
        report["points"].append({"luminaire": pair.lamp_name} | measure_points(pair.asset))
        print(report["points"][-1], flush=True)
    for pair in pairs:
        by_kind = scenes(pair)
        for light, depth in PATH_DEPTHS.items():
            names = {"luminaire": pair.lamp_name, "room": Path(pair.room).resolve().parent.name}
            report["pairs"].append(names | {"light": light} | measure_paths(by_kind, depth))
            print(report["pairs"][-1], flush=True)
    print(table(report))
    if arguments.write:
        write_json(RESULTS / "sampling.json", report)
        with atomic_path(RESULTS / "sampling.md") as path:
            path.write_text(table(report), encoding="utf-8")


if __name__ == "__main__":
    main()
