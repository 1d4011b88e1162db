"""Error of the image of a lamp at equal time: explicit, by its field, and by its geometry.

    python -m benchmarks appearance [--data FOLDER] [--assets FOLDER] [LUMINAIRE ...]

Each luminaire hangs in the demonstration's room; the image is cut to the pixels around its box.
The reference is a long run of explicit geometry, and nothing is compared below its error. All
methods render for the same CPU time. Errors are means over independent images: `rmse_display`
(see `display_rmse`), `hdr_flip` and `psnr_mulaw`. *Mean* is the long runs' mean over
the reference's, and z the difference over its standard error; it is about 1 for an unbiased method.

The field is the baseline of the last column, the ratio of `rmse_display`. Writes `appearance.md`
and `appearance.json`; rows of other luminaires that are there already stay.
"""

import argparse
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.demo_lamps import placed
from benchmarks.common.lamps import add_luminaires, file_name, sources
from benchmarks.common.options import add_pixels, add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import Job, interleaved
from benchmarks.equal_error.errors import display_rmse, ratio_of_means
from benchmarks.equal_error.pairs import shows_lamp
from lumitree.asset.asset import PARTS
from lumitree.lamp.source import LuminaireSource

BASELINE = "field"
# Batches of the long runs, at least; of the reference, at most.
BATCHES, MAX_BATCHES = 8, 4096
# Independent images of each method.
IMAGES = 3


def measure(source: LuminaireSource, path: Path, options: argparse.Namespace) -> dict:
    """A row for each way to show a lamp.

    Args:
        source: the luminaire.
        path: of its asset, which is baked where it is missing.
    """
    import lumitree

    if not path.exists():
        lumitree.bake(
            source,
            path,
            lumitree.BakeConfig(
                parts=PARTS,
                octree=lumitree.OctreeConfig(time=options.bake_seconds),
                irradiance_paths=0,
                seed=options.seed,
            ),
        )
    asset = lumitree.load(path)
    methods = scenes(source, asset, options.width)
    batches: dict[str, list[Any]] = {name: [] for name in methods}

    def take(scene: Any, samples: int, index: int) -> Any:
        return image(scene, samples, options.path_depth, options.seed + index)

    def job(name: str) -> Job:
        scene = methods[name]
        return lambda index: lambda: batches[name].append(take(scene, options.spp, index))

    times = interleaved({name: job(name) for name in methods}, BATCHES, clock="cpu")
    seconds = {name: value / options.spp for name, value in times.items()}
    explicit = methods["explicit"]
    count = min(MAX_BATCHES, math.ceil(options.reference / times["explicit"]))
    for index in range(len(batches["explicit"]), count):
        batches["explicit"].append(take(explicit, options.spp, index))
    long = {name: np.array(images) for name, images in batches.items()}
    reference = long["explicit"].mean(axis=0)
    halves = [long["explicit"][part::2].mean(axis=0) for part in (0, 1)]
    row = {
        "luminaire": asset.luminaire,
        "pixels": list(reference.shape[1::-1]),
        # A half has twice the variance, and the difference of two halves four times.
        "reference": float(display_rmse(halves[0][None], halves[1])[0] / 2),
        "reference_spp": len(long["explicit"]) * options.spp,
        "methods": {},
    }
    for name, scene in methods.items():
        samples = max(1, round(options.seconds / seconds[name]))
        images = [take(scene, samples, 5000 + i) for i in range(IMAGES)]
        mean = ratio_of_means(long[name], long["explicit"])
        row["methods"][name] = {
            "samples": samples,
            "seconds_per_sample": seconds[name],
            **errors(np.array(images), reference),
            "mean": mean.value,
            "mean_error": mean.error,
        }
    return row


def scenes(source: LuminaireSource, asset: Any, width: int) -> dict[str, Any]:
    """Scenes by method; their films show the surroundings of the lamp's box alone."""
    made = {"explicit": placed(source, width), "field": placed(asset, width)}
    if asset.geometry is not None:
        made["geometry"] = placed(asset, width, appearance="geometry")
    seen = shows_lamp(made["field"])[..., 0] > 0
    for scene in made.values():
        crop(scene, seen)
    return made


def crop(scene: Any, seen: Any) -> None:
    """Cut the film of a scene to the bounding rectangle of pixels."""
    import mitsuba as mi

    y, x = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
    parameters = mi.traverse(scene.sensors()[0].film())
    parameters["crop_offset"] = [int(x[0]), int(y[0])]
    parameters["crop_size"] = [int(np.ptp(x)) + 1, int(np.ptp(y)) + 1]
    parameters.update()
    scene.sensors()[0].parameters_changed()


def image(scene: Any, samples: int, path_depth: int, seed: int) -> Any:
    """An independent image [H, W, 3]."""
    import mitsuba as mi

    from lumitree.rendering.passes import Budget, render_passes

    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": path_depth})
    return render_passes(scene, integrator, Budget(samples), seed=seed).radiance


def errors(images: Any, reference: Any) -> dict[str, float]:
    """Means over images [R, H, W, 3]."""
    from lumitree.measure.metrics import hdr_flip, mulaw, psnr

    peak = float(np.percentile(reference, 99.99))
    goal = np.clip(reference / peak, 0, 1)
    return {
        "rmse_display": float(display_rmse(images, reference).mean()),
        "hdr_flip": float(np.mean([hdr_flip(each, reference, peak) for each in images])),
        "psnr_mulaw": float(
            np.mean([psnr(mulaw(np.clip(each / peak, 0, 1)), mulaw(goal)) for each in images])
        ),
    }


def table(rows: list[dict]) -> Table:
    """A line for each luminaire and method."""
    heads = ["luminaire", "shown by", "spp", "rmse_display", "of the reference", "hdr_flip"]
    heads += ["psnr_mulaw", "mean", "z", "field / this"]
    lines = []
    for row in rows:
        base = row["methods"][BASELINE]["rmse_display"]
        for name, found in row["methods"].items():
            z = (found["mean"] - 1) / found["mean_error"]
            lines.append(
                [
                    row["luminaire"],
                    name,
                    str(found["samples"]),
                    f"{found['rmse_display']:.1f}",
                    f"{row['reference']:.1f}",
                    f"{found['hdr_flip']:.3f}",
                    f"{found['psnr_mulaw']:.1f} dB",
                    f"{found['mean']:.3f} ± {found['mean_error']:.3f}",
                    "-" if name == "explicit" else f"{z:.1f}",
                    f"{base / found['rmse_display']:.2f}",
                ]
            )
    return Table(heads, lines, left=2)


def add_options(parser: argparse.ArgumentParser) -> None:
    add_luminaires(parser)
    parser.add_argument(
        "--assets", type=Path, metavar="FOLDER", help="where assets are kept (default: nowhere)"
    )
    parser.add_argument("--bake-seconds", type=float, default=60.0, help="of the fields")
    parser.add_argument("--seconds", type=float, default=10.0, help="CPU time to compare at")
    parser.add_argument(
        "--reference", type=float, default=150.0, help="CPU seconds of the reference"
    )
    parser.add_argument(
        "--path-depth", type=int, default=16, help="longest path; opal glass needs 128"
    )
    add_pixels(parser, "--width", 480, 8)
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    results = Results(options, path_depth=options.path_depth, baseline=BASELINE, clock="cpu")
    rows: list[dict] = results.stored({"luminaires": []})["luminaires"]
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.assets or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for source, _ in sources(options.luminaires, options.data):
            name = file_name(source)
            row = measure(source, folder / f"{name}.lumitree", options)
            rows = [each for each in rows if each["luminaire"] != row["luminaire"]] + [row]
            # After every row: all of them take minutes.
            facts = results.setting()
            text = f"# Image of a lamp at equal time\n\n{table(rows).markdown()}\n{notes(facts)}"
            results.write({"setting": facts, "luminaires": rows}, text)
            print(f"measured {name}", file=sys.stderr)
    print(table(rows).text())
