"""Error of bakes on held-out views, as the gain over an all-black image.

    python -m benchmarks octree_fit NAME ... --references FOLDER

Bakes every luminaire by each `--method`, evaluates it on the views of its name in each folder of
`--references` (see `lumitree capture --split test`), and puts the rows into `octree_fit.md` and
`octree_fit.json`, in place of earlier rows of the same luminaire, method and resolution; all others
stay, with the commit they were measured at. The baseline is an all-black image on the same views.
"""

import argparse
import dataclasses
import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import cast

import lumitree
from benchmarks.common.options import add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from lumitree.core.dataset import Dataset
from lumitree.fit.config import QUALITIES, Quality

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


def measure(name: str, method: str, options: argparse.Namespace, folder: Path) -> list[dict]:
    """A bake and its errors: a row for each set of views."""
    title = label(name)
    asset = str(options.assets / f"{title}-{method}.lumitree")
    if method == NETWORK:
        baked = lumitree.bake_network(
            name,
            asset,
            dataclasses.replace(lumitree.NetworkConfig.preview(), irradiance_paths=0),
            variant=options.variant,
        )
    else:
        baked = lumitree.bake(
            name,
            asset,
            dataclasses.replace(
                QUALITIES[cast(Quality, method)],
                parts=("light", "field"),
                irradiance_paths=0,
                seed=options.seed,
            ),
            variant=options.variant,
        )
    bake = {
        "luminaire": title,
        "method": method,
        "seconds": sum(baked.seconds.values()),
        "peak_memory_bytes": baked.peak_memory_bytes,
        "leaves": baked.asset.num_leaves,
        "bytes": Path(asset).stat().st_size,
        "rays": baked.rays,
    }
    sheet = str(folder / "sheet.png")
    return [bake | errors(asset, references / title, sheet) for references in options.references]


def errors(asset: str, folder: Path, sheet: str) -> dict:
    """Metrics of an asset on stored views, and what these are."""
    views = Dataset.open(str(folder)).manifest
    metrics = lumitree.evaluate(asset, str(folder), sheet).metrics
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


def table(rows: list[dict]) -> Table:
    """A line for each row."""
    heads = ["luminaire", "method", "views", "s", "peak GB", "leaves", "MB", *COLUMNS, "commit"]
    lines = [
        [
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
        for row in rows
    ]
    return Table(heads, lines, left=3)


def add_options(parser: argparse.ArgumentParser) -> None:
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
        help="quality of the octree fit, or the network; may be repeated (default: standard)",
    )
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    for name in options.luminaires:
        for references in options.references:
            Dataset.open(str(references / label(name)))  # before an hour of bakes, not after
    results = Results(options)
    # A process for each: the peak of memory is the bake's own.
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as process,
    ):
        for name in options.luminaires:
            for method in options.method or ["standard"]:
                job = process.submit(measure, name, method, options, Path(folder))
                rows = [row | {"setting": results.setting()} for row in job.result()]
                print(table(rows).text(), flush=True)
                write(rows, results)


def write(new: list[dict], results: Results) -> None:
    """Both files, with these rows in place of earlier ones."""
    rows = {key(row): row for row in [*results.stored([]), *new]}
    ordered = [rows[name] for name in sorted(rows)]
    own = ("commit", "command", "seconds")  # of each row
    lines = [
        notes({name: value})
        for row in ordered
        for name, value in row["setting"].items()
        if name not in own
    ]
    text = f"# What bakes are worth\n\n{table(ordered).markdown()}\n{''.join(dict.fromkeys(lines))}"
    results.write(ordered, text)


def key(row: dict) -> tuple[str, str, int]:
    """What tells rows apart."""
    return row["luminaire"], row["method"], row["resolution"]
