"""What bakes are worth: python benchmarks/direct.py NAME ... --references FOLDER

Bakes every luminaire by each `--method`, evaluates it on the views of its name in each folder of
`--references` (see `lumitree capture --split test`), and puts the rows into `direct.md` and
`direct.json` in benchmarks/results/, in place of earlier rows of the same luminaire, method and
resolution; all others stay, with the commit they were measured at.
"""

import argparse
import json
import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import lumitree
from lumitree.core.dataset import Dataset
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


def measure(
    name: str, method: str, facts: dict, args: argparse.Namespace, folder: Path
) -> list[dict]:
    """A bake and what it is worth: a row for each set of views."""
    title = label(name)
    asset = str(args.assets / f"{title}-{method}.lumitree")
    if method == NETWORK:
        baked = lumitree.bake_network(name, asset)
    else:
        baked = lumitree.bake(name, asset, quality=method)
    bake = {
        "luminaire": title,
        "method": method,
        "setting": facts,
        "seconds": sum(baked.seconds.values()),
        "peak_memory_bytes": baked.peak_memory_bytes,
        "leaves": baked.asset.num_leaves,
        "bytes": Path(asset).stat().st_size,
        "rays": baked.rays,
    }
    sheet = str(folder / "sheet.png")
    return [bake | worth(asset, references / title, sheet) for references in args.references]


def worth(asset: str, folder: Path, sheet: str) -> dict:
    """Metrics of an asset on stored views, and what these are."""
    views = Dataset.open(str(folder)).manifest
    metrics = lumitree.evaluate(asset, str(folder), sheet).metrics
    for kind in ("linear", "mulaw"):
        metrics[f"gain_{kind}"] = metrics[f"psnr_{kind}"] - metrics[f"psnr_{kind}_black"]
    return {
        "resolution": views.resolution,
        "views": len(views.frames),
        "samples_per_pixel": views.samples_per_pixel,
        "metrics": metrics,
    }


def label(name: str) -> str:
    """Name of a luminaire's row: a file's is its folder's where the file is `luminaire.xml`."""
    path = Path(name)
    return path.parent.name if path.stem == "luminaire" else path.stem


def table(rows: list[dict]) -> str:
    """The rows in Markdown."""
    heads = ["luminaire", "method", "views", "s", "peak GB", "leaves", "MB", *COLUMNS, "commit"]
    lines = ["| " + " | ".join(heads) + " |", "|---|---|---" + "|---:" * (len(heads) - 3) + "|"]
    for row in rows:
        cells = [
            row["luminaire"],
            row["method"],
            f"{row['views']} of {row['resolution']}², {row['samples_per_pixel']} spp",
            f"{row['seconds']:.0f}",
            f"{row['peak_memory_bytes'] / 1e9:.1f}" if row["peak_memory_bytes"] else "",
            f"{row['leaves']:,}",
            f"{row['bytes'] / 1e6:.1f}",
            *(f"{row['metrics'][name]:.{digits}f}" for name, digits in COLUMNS.items()),
            row["setting"]["commit"],
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description="What bakes are worth, luminaire by luminaire.")
    parser.add_argument("luminaires", metavar="NAME", nargs="+")
    parser.add_argument(
        "--references",
        metavar="FOLDER",
        type=Path,
        action="append",
        required=True,
        help="holds a folder of views for each NAME; may be repeated",
    )
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
    for name in args.luminaires:
        for references in args.references:
            Dataset.open(str(references / label(name)))  # before an hour of bakes, not after
    facts = setting()
    # A process for each: the peak of memory is the bake's own.
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as process,
    ):
        for name in args.luminaires:
            for method in args.method or ["standard"]:
                write(process.submit(measure, name, method, facts, args, Path(folder)).result())


def write(new: list[dict]) -> None:
    """Both files, with these rows in place of earlier ones."""
    RESULTS.mkdir(exist_ok=True)
    stored = RESULTS / "direct.json"
    rows = {key(row): row for row in json.loads(stored.read_text())} if stored.is_file() else {}
    rows |= {key(row): row for row in new}
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


def key(row: dict) -> tuple[str, str, int]:
    """What tells rows apart."""
    return row["luminaire"], row["method"], row["resolution"]


if __name__ == "__main__":
    main()
