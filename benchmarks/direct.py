"""What bakes are worth, luminaire by luminaire: python benchmarks/direct.py NAME ...

Bakes every luminaire by each `--method`, evaluates it on the views of its name in the folder of
`--references`, and puts the row into `direct.md` and `direct.json` in benchmarks/results/, in place
of an earlier row of the same luminaire and method; all others stay, with the commit they were
measured at. Without stored views, some are captured, with fewer samples: the table says how many.
"""

import argparse
import json
import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from lumitree import pipeline
from lumitree.core.dataset import MANIFEST
from lumitree.core.files import write_json
from setting import setting

RESULTS = Path(__file__).parent / "results"
COLUMNS = {
    "psnr_linear": 2,
    "gain_linear": 2,
    "psnr_mulaw": 2,
    "gain_mulaw": 2,
    "ssim_linear": 3,
    "opacity_rmse": 4,
    "flux_error": 3,
}
NETWORK = "network"


def measure(name: str, method: str, facts: dict, args: argparse.Namespace, folder: Path) -> dict:
    """One row: a bake and what it is worth."""
    title = label(name)
    asset = str(args.assets / f"{title}-{method}.lumitree")
    if method == NETWORK:
        baked = pipeline.bake_network(name, asset)
    else:
        baked = pipeline.bake(name, asset, quality=method)
    views = args.references / title if args.references else Path()
    target = str(views) if (views / MANIFEST).is_file() else name
    report = pipeline.evaluate(asset, target, sheet=str(folder / "sheet.png"), num_views=4)
    metrics = report["metrics"]
    for kind in ("linear", "mulaw"):
        metrics[f"gain_{kind}"] = metrics[f"psnr_{kind}"] - metrics[f"psnr_{kind}_black"]
    return {
        "luminaire": title,
        "method": method,
        "setting": facts,
        "stored_views": target != name,
        "seconds": sum(baked["seconds"].values()),
        "peak_memory_bytes": baked["peak_memory_bytes"],
        "leaves": baked["asset"]["leaves"],
        "bytes": Path(asset).stat().st_size,
        "rays": baked.get("rays"),
        "metrics": metrics,
    }


def label(name: str) -> str:
    """Name of a luminaire's row: a file's is its folder's where the file is `luminaire.xml`."""
    path = Path(name)
    return path.parent.name if path.stem == "luminaire" else path.stem


def table(rows: list[dict]) -> str:
    """The rows in Markdown."""
    heads = ["luminaire", "method", "s", "peak GB", "leaves", "MB", *COLUMNS, "commit"]
    lines = ["| " + " | ".join(heads) + " |", "|---|---" + "|---:" * (len(heads) - 2) + "|"]
    for row in rows:
        cells = [
            row["luminaire"] + ("" if row["stored_views"] else " *"),
            row["method"],
            f"{row['seconds']:.0f}",
            f"{row['peak_memory_bytes'] / 1e9:.1f}" if row["peak_memory_bytes"] else "",
            f"{row['leaves']:,}",
            f"{row['bytes'] / 1e6:.1f}",
            *(f"{row['metrics'][name]:.{digits}f}" for name, digits in COLUMNS.items()),
            row["setting"]["commit"],
        ]
        lines.append("| " + " | ".join(cells) + " |")
    note = "A star after the name: on 4 views of 256² captured with 256 samples a pixel.\n"
    return "\n".join(lines) + "\n\n" + note


def main() -> None:
    parser = argparse.ArgumentParser(description="What bakes are worth, luminaire by luminaire.")
    parser.add_argument("luminaires", metavar="NAME", nargs="+")
    parser.add_argument("--references", metavar="FOLDER", type=Path)
    parser.add_argument(
        "--assets", metavar="FOLDER", type=Path, default=Path(tempfile.gettempdir())
    )
    parser.add_argument(
        "--method",
        action="append",
        choices=["preview", "standard", "high", NETWORK],
        help="quality of the direct bake, or the network; may be repeated (default: standard)",
    )
    args = parser.parse_args()
    facts = setting()
    # A process for each: the peak of memory is the bake's own.
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as process,
    ):
        for name in args.luminaires:
            for method in args.method or ["standard"]:
                write(process.submit(measure, name, method, facts, args, Path(folder)).result())


def write(row: dict) -> None:
    """Both files, with this row in place of an earlier one."""
    RESULTS.mkdir(exist_ok=True)
    stored = RESULTS / "direct.json"
    rows = {key(row): row for row in json.loads(stored.read_text())} if stored.is_file() else {}
    rows[key(row)] = row
    ordered = [rows[name] for name in sorted(rows)]
    write_json(stored, ordered)
    settings = {json.dumps(row["setting"] | {"commit": ""}): row["setting"] for row in ordered}
    notes = [
        f"* {name}: {value}"
        for each in settings.values()
        for name, value in each.items()
        if name != "commit"
    ]
    (RESULTS / "direct.md").write_text(
        "# What bakes are worth\n\n" + table(ordered) + "\n" + "\n".join(notes) + "\n"
    )


def key(row: dict) -> tuple[str, str]:
    """What tells rows apart."""
    return row["luminaire"], row["method"]


if __name__ == "__main__":
    main()
