"""Time at equal error of a lamp and of its bake, in a room.

One pair:   --luminaire bulbs --asset bulbs.lumitree --room room_night.xml --at x y z --size s
Many pairs: --pairs benchmarks/equal_quality_pairs.toml --rooms FOLDER --assets FOLDER

For each pair, with `--time` seconds of rendering in all:

* a long run of the explicit lamp (two fifths of the time): the reference. Its own error, from the
  spread of its independent batches, is stated, and nothing is compared below it;
* a long run of the baked lamp (as long): its noise, and the *bake's error*, the difference of the
  two long runs with the noise of both subtracted;
* both methods with 1, 2, 4, ... samples a pixel, timed.

Everything is kept in the `--cache` folder under the hash of what it depends on. The same command
again spends its time on making the long runs longer. Readings (one row a pair):

* speedup: as in the paper's Table 5, the time for the RMSE that the baked lamp has at 32 samples.
  Its RMSE and the explicit lamp's time are expected values: the mean squared error is variance /
  samples (+ the bake's error), with the variance of the long runs; a sample's time is measured
  with both methods taking turns. Where rare samples are very bright, most pictures look better
  than they are on average, so this is the sound reading;
* lit: the same over the pixels whose rays do not meet the lamp's box. Camera paths find what shines
  in a lamp with little noise, whoever renders it, and filaments are a thousand times brighter than
  the room, so that they decide an RMSE of the whole picture. What a lamp is for is the rest. With
  fewer samples than 32 where the reference is not good enough for more, and as a bound (>) where
  one sample is better than the reference;
* lit, robust: the same pixels by relMSE, without the 0.1 % of them that are noisiest by either
  method: mirror images of filaments, which no sampling of lamps finds;
* measured: the first by the ladders' RMSE alone, marked ~ where it lies beyond the last rung;
* display: the time for `rmse_display` of 8, 5 and 2.7 over the whole image, the lamp in it, which
  the paper's RMSE are taken to be; from ladders and long runs, marked ~ where the
  explicit lamp's time lies beyond the longest;
* robust: the time for equal relMSE of the whole picture without the 0.1 % of the pixels with the
  largest errors, from the ladders as well.

The explicit lamp is the baseline. Writes equal_quality.json, equal_quality.md and pictures.
"""

import argparse
import functools
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.results import Results, notes
from benchmarks.common.timing import ClockName, Job, interleaved
from benchmarks.equal_error.error_against_time import (
    ratio_of_means,
    relative_weights,
    squared_difference,
    trimming,
)
from benchmarks.equal_error.method import Method
from benchmarks.equal_error.pairs import Pair, add_folders, read_pairs, shows_lamp
from benchmarks.equal_error.readings import (
    Reference,
    display_levels,
    display_rows,
    expected_levels,
    headline,
    levels,
    noise_of_mean,
    readable,
    rung_rows,
)
from benchmarks.equal_error.report import (
    display_table,
    draw_curves,
    draw_pictures,
    level_table,
    table,
)
from lumitree.errors import LumitreeError

REFERENCE_SHARE, BAKED_SHARE, LADDER_SHARE = 0.4, 0.4, 0.1  # the last one twice
TIMED_SAMPLES = 8  # a pixel


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--luminaire", help="built-in name or file")
    parser.add_argument("--asset", help="its bake, a .lumitree file")
    parser.add_argument("--room", help="Mitsuba scene file with a camera")
    parser.add_argument("--at", nargs=3, type=float, metavar=("X", "Y", "Z"), help="box centre")
    parser.add_argument("--size", type=float, help="largest side of its box, scene units")
    parser.add_argument("--bake-seconds", type=float, help="what the bake took, for the break-even")
    parser.add_argument("--pairs", type=Path, help="TOML file of pairs instead")
    add_folders(parser)
    parser.add_argument("--time", type=float, default=240, help="seconds a pair, by the wall")
    parser.add_argument("--width", type=int, default=240, help="of the pictures, pixels")
    parser.add_argument("--path-depth", type=int, default=64, help="longest path")
    parser.add_argument(
        "--explicit", default="lumitree_path", help="the explicit lamp's integrator"
    )
    parser.add_argument("--clock", choices=("wall", "cpu"), default="wall", help="what times mean")
    parser.add_argument("--cache", type=Path, default=Path("equal-quality.work"))


def run(options: argparse.Namespace) -> None:
    one = (options.luminaire, options.asset, options.room, options.at, options.size)
    if (options.pairs is None) == any(value is None for value in one):
        raise LumitreeError("give --pairs, or all of --luminaire --asset --room --at --size")
    if options.pairs is not None:
        pairs = read_pairs(options.pairs, options.rooms, options.assets, options.data)
    else:
        luminaire, asset, room, at, size = one
        pairs = [Pair(luminaire, asset, room, tuple(at), size, options.bake_seconds)]
    results = Results(
        options,
        seconds_a_pair=options.time,
        clock=options.clock,
        path_depth=options.path_depth,
        baseline="explicit lamp",
    )
    for pair in pairs:
        row = measure(pair, options)
        write([row], results)
        print(table([row]).text(), flush=True)


def measure(pair: Pair, options: argparse.Namespace) -> dict:
    """Render what the budget allows, compare, draw."""
    explicit, baked = (Method(pair, is_baked, options) for is_baked in (False, True))
    budget = LADDER_SHARE * options.time
    explicit.spend(REFERENCE_SHARE * options.time, budget)
    baked.spend(BAKED_SHARE * options.time, budget)
    row = compare(pair, explicit, baked, options.clock)
    folder = Path(options.output) / "equal_quality"
    folder.mkdir(parents=True, exist_ok=True)
    row["pictures"] = [f"equal_quality/{pair.name}.png", f"equal_quality/{pair.name}-curves.png"]
    pictures, curves = (Path(options.output) / name for name in row["pictures"])
    draw_pictures(pictures, row, explicit.long.mean, explicit.rungs, baked.rungs)
    draw_curves(curves, row)
    return row


def seconds_per_sample(methods: dict[str, Method], clock: ClockName) -> dict[str, float]:
    """Seconds that a sample a pixel takes, by method."""

    def job(method: Method) -> Job:
        return lambda index: functools.partial(method.render, TIMED_SAMPLES, index)

    times = interleaved({name: job(method) for name, method in methods.items()}, clock=clock)
    return {name: seconds / TIMED_SAMPLES for name, seconds in times.items()}


def reading(
    explicit: Method, baked: Method, seconds: list[float], counts: list[int], weights: Any
) -> dict:
    """Expected errors, weighted, and what bounds them.

    Args:
        seconds: a sample of each method takes.
        counts: samples a pixel of the baked lamp.
        weights: [H, W, 3] of squared errors.
    """
    bias = squared_difference(baked.long.batches, explicit.long.batches, weights)
    paces = explicit.pace(seconds[0], 0.0, weights), baked.pace(seconds[1], bias.value, weights)
    samples = explicit.long.samples_per_pixel
    floor = paces[0].variance.value / samples
    rows = expected_levels(counts, *paces, floor)
    best = readable(rows)
    # The room's own light, whatever the errors are weighted with.
    means = ratio_of_means(*(method.long.batches * (weights > 0) for method in (baked, explicit)))
    return {
        "speedup": best["speedup"],
        "speedup_error": best["speedup_error"],
        "baked_spp": best["baked_spp"],
        # Where one sample is better than the reference: the time for the reference's own error.
        "speedup_bound": samples * seconds[0] / rows[0]["baked_seconds"],
        "levels": rows,
        "variance_ratio": paces[0].variance.value / paces[1].variance.value,
        "bake_mse": bias.value,
        "bake_mse_error": bias.error,
        "mean_ratio": means.value,
        "mean_ratio_error": means.error,
        "reference_rmse": float(np.sqrt(floor)),
    }


def compare(pair: Pair, explicit: Method, baked: Method, clock: ClockName) -> dict:
    """The pair's row: every reading."""
    reference = Reference.of(explicit.long.batches)
    bias = squared_difference(baked.long.batches, explicit.long.batches)
    rows = {
        name: rung_rows(method.rungs, reference, clock)
        for name, method in (("explicit", explicit), ("baked", baked))
    }
    per_sample = seconds_per_sample({"explicit": explicit, "baked": baked}, clock)
    seconds = list(per_sample.values())
    paces = explicit.pace(seconds[0], 0.0, 1.0), baked.pace(seconds[1], bias.value, 1.0)
    readings = levels(rows["explicit"], rows["baked"], paces, reference)
    best = headline(readings)
    lit = 1.0 - shows_lamp(baked.scene)
    relative = relative_weights(reference.picture)
    noisy = [method.variance() * relative * lit for method in (explicit, baked)]
    counts = [rung["spp"] for rung in rows["baked"]]
    parts = {
        name: reading(explicit, baked, seconds, counts, weights)
        for name, weights in (
            ("lit", lit / lit.mean()),
            ("lit_robust", relative * lit * trimming(*noisy)),
        )
    }
    runs = {
        name: (method.rungs, method.long.batches, method.long.seconds[clock])
        for name, method in (("explicit", explicit), ("baked", baked))
    }
    converging = (name for name, m in (("explicit", explicit), ("baked", baked)) if m.converges)
    chosen = min(converging, key=lambda name: noise_of_mean(runs[name][1]))
    display, own = display_rows(runs, clock, reference=chosen)
    saved = (best["explicit_seconds"] or 0.0) - best["baked_seconds"]
    means = ratio_of_means(baked.long.batches, explicit.long.batches)
    rel_mse = squared_difference(baked.long.batches, explicit.long.batches, reference.weights)
    return {
        "luminaire": pair.lamp_name,
        "room": pair.room_name,
        "speedup": best["speedup"],
        "speedup_error": best["speedup_error"],
        **{f"speedup_{name}": part["speedup"] for name, part in parts.items()},
        "speedup_measured": best["speedup_measured"],
        "speedup_robust": best["speedup_robust"],
        "at_paper_samples": best,
        "levels": readings,
        "seconds_per_sample": per_sample,
        "lit_share": float(lit.mean()),
        **parts,
        "at": pair.at,
        "size": pair.size,
        "resolution": list(reference.picture.shape[1::-1]),
        "clock": clock,
        "integrators": [explicit.kind, baked.kind],
        "reference": reference.summary()
        | {"spp": explicit.long.samples_per_pixel, "seconds": explicit.long.seconds[clock]},
        "bake": {
            "mse": bias.value,
            "mse_error": bias.error,
            "rmse": float(np.sqrt(max(bias.value, 0.0))),
            "rel_mse": rel_mse.value,
            "rel_mse_error": rel_mse.error,
            "mean_ratio": means.value,
            "mean_ratio_error": means.error,
            "spp": baked.long.samples_per_pixel,
            "seconds": pair.bake_seconds,
            "break_even_pictures": (
                pair.bake_seconds / saved if pair.bake_seconds and saved > 0 else None
            ),
        },
        "ladders": rows,
        "display": {
            "levels": display_levels(display, own),
            "points": display,
            "reference": own,
            "reference_method": chosen,
        },
    }


def write(rows: list[dict], results: Results) -> None:
    """Both files; rows of other pairs that are there already stay."""
    known = results.stored({"pairs": []})["pairs"]
    names = {(row["luminaire"], row["room"]) for row in rows}
    rows = [row for row in known if (row["luminaire"], row["room"]) not in names] + rows
    facts = results.setting()
    tables = {
        "# Time at equal error": f"{table(rows).markdown()}\n{notes(facts)}",
        "## Speed-up at the RMSE of the baked lamp's samples": level_table(rows).markdown(),
        "## The same where the lamp itself is not seen": level_table(rows, "lit").markdown(),
        "## By `rmse_display`, whole image": display_table(rows).markdown(),
        "## There, by relMSE without the noisiest 0.1 %": level_table(
            rows, "lit_robust"
        ).markdown(),
    }
    text = "\n".join(f"{heading}\n\n{content}" for heading, content in tables.items())
    results.write({"setting": facts, "pairs": rows}, text)
