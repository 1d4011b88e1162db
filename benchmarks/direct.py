"""The direct bake on many luminaires: python benchmarks/direct.py --references FOLDER NAME ...

For every luminaire (or dataset of held-out views in FOLDER of its row's name): bakes it, with
`--quality` and `--time`, and by the network where `--network` asks for it, evaluates both on the
same views, and writes `direct.md` and `direct.json` into benchmarks/results/. Without stored
views, some are captured, with fewer samples: the table says how many.
"""

import argparse
import json
import tempfile
from pathlib import Path

from lumitree import pipeline
from lumitree.core.dataset import MANIFEST
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


def measure(name: str, method: str, args: argparse.Namespace, folder: Path) -> dict:
    """One row: a bake and what it is worth."""
    title = label(name)
    asset = str(args.assets / f"{title}-{method}.lumitree")
    if method == "nerf":
        baked = pipeline.bake_network(name, asset)
    else:
        baked = pipeline.bake(name, asset, quality=args.quality, seconds=args.time)
    views = args.references / title if args.references else Path()
    target = str(views) if (views / MANIFEST).is_file() else name
    report = pipeline.evaluate(asset, target, sheet=str(folder / "sheet.png"), num_views=4)
    metrics = report["metrics"]
    for kind in ("linear", "mulaw"):
        metrics[f"gain_{kind}"] = metrics[f"psnr_{kind}"] - metrics[f"psnr_{kind}_black"]
    return {
        "luminaire": title,
        "method": method,
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
    heads = ["luminaire", "method", "s", "leaves", "MB", *COLUMNS]
    lines = ["| " + " | ".join(heads) + " |", "|---|---" + "|---:" * (len(heads) - 2) + "|"]
    for row in rows:
        cells = [
            row["luminaire"] + ("" if row["stored_views"] else " *"),
            row["method"],
            f"{row['seconds']:.0f}",
            f"{row['leaves']:,}",
            f"{row['bytes'] / 1e6:.1f}",
            *(f"{row['metrics'][name]:.{digits}f}" for name, digits in COLUMNS.items()),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    note = "A star after the name: on 4 views of 256² captured with 256 samples a pixel.\n"
    return "\n".join(lines) + "\n\n" + note


def main() -> None:
    parser = argparse.ArgumentParser(description="The direct bake on many luminaires.")
    parser.add_argument("luminaires", metavar="NAME", nargs="+")
    parser.add_argument("--references", metavar="FOLDER", type=Path)
    parser.add_argument(
        "--assets", metavar="FOLDER", type=Path, default=Path(tempfile.gettempdir())
    )
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--time", type=float, metavar="S")
    parser.add_argument("--network", action="store_true")
    args = parser.parse_args()
    facts = setting(quality=args.quality, seconds=args.time)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in args.luminaires:
            for method in ("direct", "nerf") if args.network else ("direct",):
                rows.append(measure(name, method, args, Path(folder)))
                write(rows, facts)


def write(rows: list[dict], facts: dict) -> None:
    """Both files, after every row."""
    RESULTS.mkdir(exist_ok=True)
    text = json.dumps({"setting": facts, "rows": rows}, indent=1)
    (RESULTS / "direct.json").write_text(text + "\n")
    note = "\n".join(f"* {key}: {value}" for key, value in facts.items())
    (RESULTS / "direct.md").write_text(f"# The direct bake\n\n{table(rows)}\n{note}\n")


if __name__ == "__main__":
    main()
