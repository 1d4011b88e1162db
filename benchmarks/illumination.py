"""Cost of lamps in a room, against an emissive sphere and against the explicit lamps.

    python -m benchmarks illumination [--data FOLDER] [--assets FOLDER] [LUMINAIRE ...]

Each luminaire hangs in the demonstration's room, in turn as an emissive sphere of the same flux
(the baseline), as explicit geometry, as an asset with a light field alone, and as one with
geometry. Writes `illumination.md` and `illumination.json`: the bake (seconds, bytes, irradiance
error); time of a sample over the sphere's and over the explicit lamp's; variance of the pixels
that show diffuse surfaces, relative to their squared mean and without the 0.1 % of largest, over
the sphere's; and the product of time and variance.

Without a name, all built-in luminaires; `--data` adds a folder of luminaires.
"""

import argparse
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.demo_lamps import placed, shows_diffuse, sphere_room
from benchmarks.common.lamps import add_luminaires, file_name, sources
from benchmarks.common.options import add_pixels, add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import Job, device_clock, interleaved, ratios
from benchmarks.equal_error.errors import trimmed_mean
from lumitree.lamp.source import LuminaireSource

PATH_DEPTH = 8
BASELINE = "sphere"
LAMPS = ("explicit", "light", "geometry")


def measure(source: LuminaireSource, path: Path, options: argparse.Namespace) -> dict:
    """A row of the table.

    Args:
        source: the luminaire.
        path: of its asset, which is baked where it is missing.
    """
    import lumitree

    made = None
    if not path.exists():
        made = lumitree.bake(
            source, path, lumitree.BakeConfig(parts=("light", "geometry"), seed=options.seed)
        )
    asset = lumitree.load(path)
    scenes = rooms(source, asset, options.width)
    mask = shows_diffuse(asset, options.width)
    times, variances = render(scenes, mask, options)
    over_sphere, product = ratios(times, BASELINE), {}
    for name in scenes:
        product[name] = over_sphere[name] * variances[name] / variances[BASELINE]
    row = {
        "luminaire": asset.luminaire,
        "bytes": path.stat().st_size,
        "diffuse_share": float(mask.mean()),
        "seconds_per_sample": {name: times[name] / options.spp for name in scenes},
        "relative_variance": variances,
        "time_over_sphere": over_sphere,
        "time_over_explicit": ratios(times, "explicit"),
        "product_over_sphere": product,
    }
    if made is not None:
        row |= {"bake_seconds": made.seconds, "irradiance": made.irradiance}
    return row


def rooms(source: LuminaireSource, asset: Any, width: int) -> dict[str, Any]:
    """Scenes by what hangs in the room."""
    scenes = {
        BASELINE: sphere_room(asset, width),
        "explicit": placed(source, width),
        "light": placed(asset, width),
    }
    if asset.geometry is not None:
        scenes["geometry"] = placed(asset, width, appearance="geometry")
    return scenes


def render(
    scenes: dict[str, Any], mask: NDArray[np.bool_], options: argparse.Namespace
) -> tuple[dict[str, float], dict[str, float]]:
    """Seconds of a pass, and relative variance of a sample in the pixels of the mask."""
    import mitsuba as mi

    from lumitree.rendering.passes import Budget, render_passes

    passes: dict[str, list[Any]] = {name: [] for name in scenes}

    def job(name: str) -> Job:
        integrator = mi.load_dict({"type": "lumitree_path", "max_depth": PATH_DEPTH})

        def take(index: int) -> None:
            seed = options.seed + index
            image = render_passes(scenes[name], integrator, Budget(options.spp), seed=seed).radiance
            passes[name].append(image[mask])

        return lambda index: lambda: take(index)

    times = interleaved({name: job(name) for name in scenes}, options.passes, device_clock())
    variances = {}
    for name, images in passes.items():
        # The first pass compiles kernels, but is an image as any.
        grey = np.mean(images, axis=-1)
        relative = grey.var(axis=0, ddof=1) * options.spp / grey.mean(axis=0) ** 2
        variances[name] = trimmed_mean(relative[None, :, None])
    return times, variances


def table(rows: list[dict]) -> Table:
    """A line for each luminaire, and one of geometric means."""
    heads = ["luminaire", "bake", "MB", "ratio of a face", "RMS, mean", "worst", "touching"]
    heads += [f"time / explicit: {name}" for name in LAMPS[1:]]
    heads += [f"product / sphere: {name}" for name in LAMPS]
    lines = [[row["luminaire"], *_bake_cells(row), *_cells(row)] for row in rows]
    columns = [
        [v for v in column if v is not None] for column in zip(*map(_values, rows), strict=True)
    ]
    means = [f"{math.exp(np.mean(np.log(column))):.2f}" if column else "-" for column in columns]
    return Table(heads, [*lines, ["geometric mean", *[""] * 6, *means]])


def _bake_cells(row: dict) -> list[str]:
    size = f"{row['bytes'] / 1e6:.1f}"
    if row.get("irradiance") is None:
        return ["", size, "", "", "", ""]
    seconds, found = row["bake_seconds"]["light"], row["irradiance"]
    faces = found["faces"].values()
    cube = [face for name, face in found["faces"].items() if name != "touching"]
    # A face that gets no light has none.
    ratio = [face["ratio"] for face in cube if face["ratio"] is not None]
    rms = [face["rms"] for face in faces if face["rms"] is not None]
    return [
        f"{seconds:.0f} s",
        size,
        f"{min(ratio):.3f} to {max(ratio):.3f}",
        f"{found['irradiance_rms']:.1%}",
        f"{max(rms):.1%}",
        f"{found['irradiance_rms_touching']:.1%}",
    ]


def _values(row: dict) -> list[float | None]:
    explicit, product = row["time_over_explicit"], row["product_over_sphere"]
    return [explicit.get(name) for name in LAMPS[1:]] + [product.get(name) for name in LAMPS]


def _cells(row: dict) -> list[str]:
    return ["-" if value is None else f"{value:.2f}" for value in _values(row)]


def add_options(parser: argparse.ArgumentParser) -> None:
    add_luminaires(parser)
    parser.add_argument(
        "--assets", type=Path, metavar="FOLDER", help="where assets are kept (default: nowhere)"
    )
    parser.add_argument("--passes", type=int, default=5, help="of each image, at least 5")
    add_pixels(parser, "--width", 320, 16)
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    results = Results(
        options, path_depth=PATH_DEPTH, baseline="emissive sphere", clock=device_clock()
    )
    rows: list[dict] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.assets or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for source, _ in sources(options.luminaires, options.data):
            name = file_name(source)
            rows.append(measure(source, folder / f"{name}.lumitree", options))
            # After every row: all of them take minutes.
            facts = results.setting()
            text = f"# Illumination of a room\n\n{table(rows).markdown()}\n{notes(facts)}"
            results.write({"setting": facts, "luminaires": rows}, text)
            print(f"measured {name}", file=sys.stderr)
    print(table(rows).text())
