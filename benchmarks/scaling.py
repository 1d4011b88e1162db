"""Gain over black of an octree fit against its time, depth, harmonics and leaves.

    python -m benchmarks scaling bulbs --references FOLDER [--time 45] [--depth 7] [--l-max 2]

Bakes the luminaire once with every value of one setting while the others stay as given, evaluates
on the views in FOLDER/NAME (see `lumitree capture --split test`), and writes `scaling.json` and
`scaling.png`. The bakes by depth are shown by their leaves as well. The baseline is an all-black
image on the same views.
"""

import argparse
import dataclasses
import json
import tempfile
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter

import lumitree
from benchmarks.common.options import add_seed
from benchmarks.common.results import Results
from benchmarks.common.tables import Table
from lumitree.asset.asset import Part
from lumitree.core.files import atomic_path
from lumitree.octree.build import MAX_TREE_DEPTH

TIMES = (0.5, 1.0, 2.0, 4.0)  # times the budget
DEPTHS = (-2, -1, 0, 1)  # more than the given one
L_MAX = (0, 1, 2, 3, 4)
# With the colours of their curves.
GAINS = {"gain_linear": "#2f6fb0", "gain_mulaw": "#b04a2f"}
PANELS = {
    "rays": "rays of the refinement",
    "depth": "octree levels",
    "l_max": "highest harmonics",
    "leaves": "leaves",
}


def measure(
    name: str, views: str, folder: Path, how: dict[str, Any], seed: int, variant: str | None
) -> dict:
    """One bake and its errors."""
    asset = str(folder / "lamp.lumitree")
    Path(asset).unlink(missing_ok=True)
    parts: tuple[Part, ...] = ("light", "field")
    baked = lumitree.bake(
        name,
        asset,
        dataclasses.replace(
            lumitree.BakeConfig.preview(), parts=parts, irradiance_paths=0, seed=seed, **how
        ),
        variant=variant,
    )
    sheet = str(folder / "sheet.png")
    metrics = lumitree.evaluate(asset, views, sheet).metrics
    return {
        "seconds": sum(baked.seconds.values()),
        "rays": baked.rays,
        "depth": how["tree_depth"],
        "l_max": how["l_max"],
        "leaves": baked.asset.num_leaves,
        "bytes": Path(asset).stat().st_size,
        **metrics,
    }


def draw(report: dict, path: Path) -> None:
    """Four panels: gains over black, and the opacity's error on an axis of its own."""
    figure = Figure(figsize=(12, 7), layout="constrained")
    for axis, (key, label) in zip(figure.subplots(2, 2).flat, PANELS.items(), strict=True):
        rows = report["depth" if key == "leaves" else key]
        values = [row[key] for row in rows]
        for metric, colour in GAINS.items():
            axis.plot(values, [row[metric] for row in rows], "o-", color=colour, label=metric)
        other = axis.twinx()
        opacity = [row["opacity_rmse"] for row in rows]
        other.plot(values, opacity, "s--", color="grey", label="opacity_rmse")
        axis.set(xlabel=label, ylabel="dB over black")
        other.set(ylabel="opacity_rmse", ylim=(0, None))
        if key in ("rays", "leaves"):
            axis.set_xscale("log")
            axis.xaxis.set_minor_formatter(NullFormatter())
        else:
            axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.grid(alpha=0.3)
        axis.legend(loc="lower left", fontsize=8)
        other.legend(loc="lower right", fontsize=8)
    facts = report["setting"]
    figure.suptitle(
        f"{facts['luminaire']}; where not varied: {facts['bake_seconds']:g} s, depth "
        f"{facts['tree_depth']}, l_max {facts['l_max']}"
    )
    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=80, format="png")


def table(varied: str, rows: list[dict]) -> Table:
    """The bakes in which one setting varies."""
    heads = ["varied", "s", "rays", "depth", "l_max", "leaves", *GAINS, "opacity_rmse"]
    lines = [
        [
            varied,
            f"{row['seconds']:.0f}",
            f"{row['rays']:,}",
            str(row["depth"]),
            str(row["l_max"]),
            f"{row['leaves']:,}",
            *(f"{row[gain]:.2f}" for gain in GAINS),
            f"{row['opacity_rmse']:.4f}",
        ]
        for row in rows
    ]
    return Table(heads, lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("luminaire", metavar="LUMINAIRE")
    parser.add_argument("--references", metavar="FOLDER", type=Path, required=True)
    parser.add_argument("--time", type=float, metavar="S", default=45.0, help="of a bake, seconds")
    parser.add_argument("--depth", type=int, metavar="D", default=7, help="levels of the octree")
    parser.add_argument("--l-max", type=int, metavar="L", default=2, help="highest harmonics")
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    views = str(options.references / options.luminaire)
    given = {"time": options.time, "tree_depth": options.depth, "l_max": options.l_max}
    settings = {
        "rays": [{"time": factor * options.time} for factor in TIMES],
        "depth": [
            {"tree_depth": options.depth + more}
            for more in DEPTHS
            if 1 <= options.depth + more <= MAX_TREE_DEPTH
        ],
        "l_max": [{"l_max": l_max} for l_max in L_MAX],
    }
    results = Results(
        options,
        luminaire=options.luminaire,
        bake_seconds=options.time,
        tree_depth=options.depth,
        l_max=options.l_max,
    )
    report: dict = {key: [] for key in settings}
    known: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as folder:
        for key, changes in settings.items():
            for change in changes:
                how = given | change
                text = json.dumps(how)
                if text not in known:
                    known[text] = measure(
                        options.luminaire, views, Path(folder), how, options.seed, options.variant
                    )
                report[key].append(known[text])
                results.write({"setting": results.setting(), **report})
            print(table(key, report[key]).text(), flush=True)
    draw({"setting": results.setting(), **report}, results.json_path.with_suffix(".png"))
