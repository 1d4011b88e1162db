"""Illuminance of lamps in rooms, against Radiance.

    python -m benchmarks radiance [--divisions N] [--repeats N] [--error E] [CASE ...]

Each case is a lamp in a room of grey boxes: an IES file, which goes through `ies2rad`, or a lamp
that lumitree bakes and of which Radiance gets the surfaces. The illuminance of a horizontal plane,
direct and total, by `rtrace` of Radiance (the baseline) is compared with that by
`lumitree.illuminance`. Writes `radiance.md`, `radiance.json` and `radiance.png`: ratio of the
means, root mean square and largest relative difference of the points, and CPU seconds of both;
lumitree computes direct and total illuminance together, with the compilation of its kernels. Points
of less than 5 % of the plane's mean are left out of relative differences.

Needs the package `pyradiance`, the extra `radiance`.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.common.options import add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.radiance_rooms.cases import Case, cases
from benchmarks.radiance_rooms.program import Radiance
from benchmarks.radiance_rooms.rooms import mitsuba_scene, radiance_text
from lumitree.core.files import atomic_path
from lumitree.errors import LumitreeError

# The plane: above the table, below the pendant.
CENTRE, EXTENT, SPACING = (0.0, 0.85, 0.0), (3.6, 2.7), 0.3
# Reflections that Radiance follows; what is beyond is below 0.01 %.
BOUNCES = 24
# Least part of the plane's mean at which relative differences are taken.
LEAST = 0.05
Array = NDArray[np.float64]


def measure(case: Case, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Rows of the table: direct and total illuminance of a case."""
    import lumitree

    with tempfile.TemporaryDirectory() as scratch:
        radiance = Radiance(Path(scratch))
        placement = case.lamp.placement(Path(scratch), case.at)
        plane = lumitree.Plane(centre=CENTRE, normal=(0, 1, 0), extent=EXTENT, spacing=SPACING)
        start = time.process_time()
        found = lumitree.illuminance(
            mitsuba_scene(case.boxes),
            [placement],
            planes=[plane],
            error=options.error,
            direct=case.black,
            seed=options.seed,
        )
        seconds = time.process_time() - start
        text = radiance_text(case.boxes) + case.lamp.radiance(radiance, placement)
        rows = []
        for quantity in ("direct",) if case.black else ("direct", "total"):
            theirs = radiance.illuminance(
                text,
                found.position,
                found.normal,
                0 if quantity == "direct" else BOUNCES,
                options.divisions,
                # Direct light takes little time.
                options.repeats * (4 if quantity == "direct" else 1),
            )
            ours = getattr(found, quantity), getattr(found, f"{quantity}_error")
            rows.append(
                {
                    "case": case.name,
                    "quantity": quantity,
                    **compared(*ours, theirs.lux, theirs.error),
                    "radiance_cpu_seconds": theirs.cpu_seconds,
                    "lumitree_cpu_seconds": seconds,
                    "lux": ours[0].tolist(),
                    "lux_error": ours[1].tolist(),
                    "radiance_lux": theirs.lux.tolist(),
                    "radiance_lux_error": theirs.error.tolist(),
                }
            )
    return rows


def compared(lux: Array, error: Array, baseline: Array, baseline_error: Array) -> dict[str, Any]:
    """Figures of the illuminance [N] of points against a baseline.

    Args:
        lux, error: illuminance and its standard error.
        baseline, baseline_error: the same by Radiance.

    Returns:
        `points` and `compared`, their numbers; `mean_lux` of the baseline; `ratio` of the means
        and `ratio_error`; `rms_of_mean`, the root mean square difference over that mean; of the
        compared points `rms`, the root mean square of relative differences, `noise`, what of it is
        expected of noise, and `worst`, the largest, with its standard error `worst_error`. Noise
        is subtracted from both root mean squares.
    """
    mean = baseline.mean()
    ratio = lux.mean() / mean
    square = ((lux - baseline) ** 2 - error**2 - baseline_error**2).mean()
    mean_error = np.sqrt((error**2 + (ratio * baseline_error) ** 2).sum()) / len(lux) / mean
    lit = baseline > LEAST * mean
    relative = lux[lit] / baseline[lit] - 1
    noise = np.hypot(error[lit], baseline_error[lit]) / baseline[lit]
    worst = int(np.abs(relative).argmax())
    return {
        "points": len(lux),
        "compared": int(lit.sum()),
        "mean_lux": float(mean),
        "ratio": float(ratio),
        "ratio_error": float(mean_error),
        "rms_of_mean": float(np.sqrt(max(square, 0)) / mean),
        "rms": float(np.sqrt(max((relative**2).mean() - (noise**2).mean(), 0))),
        "noise": float(np.sqrt((noise**2).mean())),
        "worst": float(relative[worst]),
        "worst_error": float(noise[worst]),
    }


def table(rows: list[dict[str, Any]]) -> Table:
    """A line for each case and quantity."""
    heads = ["case", "illuminance", "points", "mean, lx", "ratio of means", "RMS / mean"]
    heads += ["RMS", "noise", "worst", "CPU s, Radiance", "CPU s, lumitree"]
    lines = [
        [
            row["case"],
            row["quantity"],
            f"{row['compared']} of {row['points']}",
            f"{row['mean_lux']:.1f}",
            f"{row['ratio']:.4f} ± {row['ratio_error']:.4f}",
            f"{row['rms_of_mean']:.2%}",
            f"{row['rms']:.2%}",
            f"{row['noise']:.2%}",
            f"{row['worst']:+.1%} ± {row['worst_error']:.1%}",
            f"{row['radiance_cpu_seconds']:.1f}",
            f"{row['lumitree_cpu_seconds']:.1f}",
        ]
        for row in rows
    ]
    return Table(heads, lines, left=2)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Illuminance by Radiance and by lumitree, and relative difference; a line for each row."""
    figure = Figure(figsize=(11, 2.5 * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), 3, squeeze=False)
    x, z = EXTENT
    sides = {"origin": "lower", "extent": (-x / 2, x / 2, -z / 2, z / 2)}
    for line, row in zip(panels, rows, strict=True):
        theirs, ours = (on_grid(row[key]) for key in ("radiance_lux", "lux"))
        shared = {**sides, "vmin": 0, "vmax": max(theirs.max(), ours.max())}
        lit = theirs > LEAST * theirs.mean()
        difference = np.where(lit, 100 * (ours / np.where(lit, theirs, 1) - 1), np.nan)
        limit = max(float(np.nanmax(np.abs(difference))), 1.0)
        spread = {**sides, "vmin": -limit, "vmax": limit, "cmap": "RdBu_r"}
        for panel, values, how, title, unit in (
            (line[0], theirs, shared, "Radiance", "lx"),
            (line[1], ours, shared, "lumitree", "lx"),
            (line[2], difference, spread, "relative difference", "%"),
        ):
            image = panel.imshow(values, **how)
            panel.set_title(title, fontsize=9)
            panel.tick_params(labelsize=7)
            figure.colorbar(image, ax=panel).set_label(unit, fontsize=8)
        line[0].set_ylabel(f"{row['case']},\n{row['quantity']}", fontsize=8)
    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=90, format="png")


def on_grid(values: list[float]) -> Array:
    """Values of the points of the plane, by rows of -z and columns of x."""
    return np.array(values).reshape([round(side / SPACING) for side in reversed(EXTENT)])


def chosen(names: list[str]) -> list[Case]:
    """The cases of these names; all without names.

    Raises:
        LumitreeError: there is no case of a name.
    """
    known = {case.name: case for case in cases()}
    for name in names:
        if name not in known:
            raise LumitreeError(f"there is no case {name!r}; expected one of {list(known)}")
    return [known[name] for name in names or known]


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cases", metavar="CASE", nargs="*")
    parser.add_argument("--divisions", type=int, metavar="N", default=256, help="-ad of rtrace")
    parser.add_argument("--repeats", type=int, metavar="N", default=8, help="of each point")
    parser.add_argument(
        "--error", type=float, default=0.005, help="relative standard error of lumitree's points"
    )
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        version = Radiance(Path(scratch)).version()
    results = Results(options, radiance=version, bounces=BOUNCES, clock="cpu")
    rows: list[dict[str, Any]] = []
    for case in chosen(options.cases):
        rows += measure(case, options)
        facts = results.setting()
        text = "# Illuminance, against Radiance\n\n![Illuminance and differences](radiance.png)"
        text += f"\n\n{table(rows).markdown()}\n{notes(facts)}"
        results.write({"setting": facts, "rows": rows}, text)
        draw(rows, results.folder / "radiance.png")
        print(f"measured {case.name}", file=sys.stderr)
    print(table(rows).text())
