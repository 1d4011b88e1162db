"""What a direct bake gains by time, depth, harmonics and leaves: python benchmarks/scaling.py NAME

    python benchmarks/scaling.py bulbs --references FOLDER [--time 45] [--depth 7] [--l-max 2]

Bakes the luminaire once with every value of one setting while the others stay as given, evaluates
on the views in FOLDER/NAME (see `lumitree capture --split test`), and writes `scaling.json` and
`scaling.png` into benchmarks/results/. The bakes by depth are shown by their leaves as well.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter

import lumitree
from lumitree.core.files import atomic_path, write_json
from lumitree.octree.build import MAX_TREE_DEPTH
from setting import setting

RESULTS = Path(__file__).parent / "results"
TIMES = (0.5, 1.0, 2.0, 4.0)  # times the budget
DEPTHS = (-2, -1, 0, 1)  # more than the given one
L_MAX = (0, 1, 2, 3, 4)
PANELS = {
    "rays": "rays of the refinement",
    "depth": "octree levels",
    "l_max": "highest harmonics",
    "leaves": "leaves",
}


def measure(name: str, views: str, folder: Path, **how: Any) -> dict:
    """One bake and what it is worth."""
    asset = str(folder / "lamp.lumitree")
    Path(asset).unlink(missing_ok=True)
    baked = lumitree.bake(name, asset, quality="preview", **how)
    sheet = str(folder / "sheet.png")
    metrics = lumitree.evaluate(asset, views, sheet).metrics
    return {
        "seconds": sum(baked.seconds.values()),
        "rays": baked.rays,
        "depth": how["tree_depth"],
        "l_max": how["l_max"],
        "leaves": baked.asset.num_leaves,
        "bytes": Path(asset).stat().st_size,
        "gain_linear": metrics["psnr_linear"] - metrics["psnr_linear_black"],
        "gain_mulaw": metrics["psnr_mulaw"] - metrics["psnr_mulaw_black"],
        **metrics,
    }


def draw(report: dict, path: Path) -> None:
    """Four panels: gains over black, and the opacity's error on an axis of its own."""
    figure = Figure(figsize=(12, 7), layout="constrained")
    for axis, (key, label) in zip(figure.subplots(2, 2).flat, PANELS.items(), strict=True):
        rows = report["depth" if key == "leaves" else key]
        values = [row[key] for row in rows]
        for metric, colour in (("gain_linear", "#2f6fb0"), ("gain_mulaw", "#b04a2f")):
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
    setting = report["setting"]
    figure.suptitle(
        f"{setting['luminaire']}; where not varied: {setting['seconds']:g} s, depth "
        f"{setting['tree_depth']}, l_max {setting['l_max']}"
    )
    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=80, format="png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("luminaire", metavar="NAME")
    parser.add_argument("--references", metavar="FOLDER", type=Path, required=True)
    parser.add_argument("--time", type=float, metavar="S", default=45.0)
    parser.add_argument("--depth", type=int, metavar="D", default=7)
    parser.add_argument("--l-max", type=int, metavar="L", default=2)
    args = parser.parse_args()
    views = str(args.references / args.luminaire)
    given = {"seconds": args.time, "tree_depth": args.depth, "l_max": args.l_max}
    runs = {
        "rays": [{"seconds": factor * args.time} for factor in TIMES],
        "depth": [
            {"tree_depth": args.depth + more}
            for more in DEPTHS
            if 1 <= args.depth + more <= MAX_TREE_DEPTH
        ],
        "l_max": [{"l_max": l_max} for l_max in L_MAX],
    }
    facts = setting(luminaire=args.luminaire, **given)
    report: dict = {"setting": facts, **{key: [] for key in runs}}
    known: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as folder:
        for key, changes in runs.items():
            for change in changes:
                how = given | change
                text = json.dumps(how)
                if text not in known:
                    known[text] = measure(args.luminaire, views, Path(folder), **how)
                report[key].append(known[text])
                print(key, change, {k: report[key][-1][k] for k in ("gain_linear", "gain_mulaw")})
                write_json(RESULTS / "scaling.json", report)
    draw(report, RESULTS / "scaling.png")


if __name__ == "__main__":
    main()
