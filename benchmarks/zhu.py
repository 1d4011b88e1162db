"""The networks of Zhu et al. 2021 against the paper's network and the octree fit (Table 6).

    python -m benchmarks zhu [LUMINAIRE ...] [--views N --resolution R --seconds S] [--converge]

Captures views of a luminaire and gives each method the same time for them:

* Zhu et al.: their three networks, rebuilt (`baselines.zhu_networks` says what was guessed), on the
  rays of the views; and with `--converge` until they improve no more;
* network, octree: the paper's network at the preset `preview`, with as many steps as the time
  allows, and the octree that is extracted from it (depth 7);
* direct, views: the octree fit of the views (depth 7);
* direct: the octree fit, which traces rays of its own (depth 7).

The seconds of the table are those of the whole fit, with compilation, which does not count for the
time that the networks are given, and without the capture. Metrics are those of `evaluate`, on test
views; milliseconds are those of an image with one ray a pixel. The variance of one direction of
the sampling network is given over that of uniform directions towards the sphere. The baseline is
the network with its octree. Writes `zhu.md`, `zhu.json` and a contact sheet for each luminaire.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.from_views import BASELINE, fits
from benchmarks.common.options import add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import Job, interleaved, kernel
from lumitree.core.extras import check_network

COLUMNS = {
    "psnr_linear": 2,
    "gain_linear": 2,
    "ssim_linear": 3,
    "psnr_mulaw": 2,
    "gain_mulaw": 2,
    "ssim_mulaw": 3,
    "opacity_rmse": 3,
    "flux_error": 3,
}
# Receivers: directions from the lamp's centre, and distances in radii of its bounding sphere.
RECEIVERS = {
    "below": ((0, -1, 0), 4.0),
    "beside": ((1, 0.1, 0.2), 3.0),
    "near": ((0.2, -1, 0.1), 1.2),
}
_DIRECTIONS = 1 << 16


def measure(
    name: str, options: argparse.Namespace, sheet: Path
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """A row for each method, and what the views are; writes a contact sheet."""
    import lumitree
    from lumitree.core.dataset import Dataset
    from lumitree.measure.view_errors import compare_views, evaluate_views

    rows, jobs, evaluations = [], {}, {}
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        _capture(name, options, folder)
        test = Dataset.open(folder / "test")
        pixels = _pixel_rays(test)
        for label, fit in fits(
            name, folder, options.seconds, options.seed, options.converge
        ).items():
            start = time.perf_counter()
            result = fit()
            row = {"luminaire": name, "method": label, "seconds": time.perf_counter() - start}
            if isinstance(result, Path):
                asset = lumitree.load(result)
                evaluation = evaluate_views(asset, test)
                jobs[label] = _look_job(asset, pixels)
                row["bytes"] = result.stat().st_size
            else:
                evaluation = compare_views(_zhu_image(result, test), test)
                jobs[label] = _eval_job(result, pixels)
                row |= {"bytes": result.num_bytes, "steps": result.steps}
                row["variance"] = variances(result, options.seed)
            evaluations[label] = evaluation
            rows.append(row | {"metrics": evaluation.metrics})
            print(f"{name}, {label}: {row['seconds']:.0f} s", file=sys.stderr)
        draw(name, evaluations, sheet)
        facts = {"pixels": len(pixels[0]), "max_radiance": evaluations[BASELINE].max_radiance}
    for label, seconds in interleaved(jobs).items():
        next(row for row in rows if row["method"] == label)["milliseconds"] = 1e3 * seconds
    return rows, facts


def _capture(name: str, options: argparse.Namespace, folder: Path) -> None:
    import lumitree
    from lumitree.core.dataset import Split

    captures: list[tuple[Split, int, int]] = [
        ("train", options.views, options.spp),
        ("test", options.test_views, options.test_spp),
    ]
    for split, count, samples in captures:
        lumitree.capture(
            name,
            folder / split,
            num_views=count,
            resolution=options.resolution,
            samples_per_pixel=samples,
            split=split,
            progress=None,
        )


def _pixel_rays(dataset: Any, index: int = 0) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Origins and directions [H · W, 3] of the rays through the pixels' centres of a view."""
    from lumitree.core.directions import orthographic_rays

    manifest = dataset.manifest
    pose = manifest.frames[index].pose
    origins, direction = orthographic_rays(pose, manifest.half_width, manifest.resolution)
    origins = origins.reshape(-1, 3)
    return origins, np.broadcast_to(direction, origins.shape)


def _zhu_image(luminaire: Any, dataset: Any) -> Callable[[Any], Any]:
    """Radiance [H, W, 3] and opacity [H, W] of a view, one ray a pixel.

    The networks learn the means of pixels, so more rays would blur them a second time.
    """
    side, frames = dataset.manifest.resolution, dataset.manifest.frames

    def image(frame: Any) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        radiance, opacity = luminaire.eval(*_pixel_rays(dataset, frames.index(frame)))
        return radiance.reshape(side, side, 3), opacity.reshape(side, side)

    return image


def _eval_job(luminaire: Any, pixels: tuple[NDArray[np.float32], NDArray[np.float32]]) -> Job:
    return lambda _: lambda: luminaire.eval(*pixels)


def _look_job(asset: Any, pixels: tuple[NDArray[np.float32], NDArray[np.float32]]) -> Job:
    import mitsuba as mi

    from lumitree.core.device import on_device
    from lumitree.octree.field import shared_field
    from lumitree.rendering.sampling.divided_sampling import look

    field = shared_field(asset)
    origins, directions = on_device(mi.Point3f, pixels[0]), on_device(mi.Vector3f, pixels[1])
    return kernel(lambda: look(asset, field, origins, directions, True))


def variances(luminaire: Any, seed: int) -> dict[str, float]:
    """Variance of one direction of the sampling network over that of a uniform one, at receivers.

    Of the light that arrives at a receiver by the network of radiance, without the cosine.
    """
    import jax.numpy as jnp

    from benchmarks.baselines.direction_cells import cone_directions, solid_angle

    random, found = np.random.default_rng(seed), {}
    for label, (towards, distance) in RECEIVERS.items():
        place = np.array(towards) / np.linalg.norm(towards) * distance * luminaire.radius
        points = np.repeat(place[None], _DIRECTIONS, axis=0).astype(np.float32)
        directions, density = luminaire.sample(points, seed)
        places = random.random((2, _DIRECTIONS), np.float32)
        uniform = np.asarray(cone_directions(jnp.asarray(points), luminaire.radius, *places))
        angle = np.asarray(solid_angle(jnp.asarray(points), luminaire.radius))
        light = luminaire.eval(points, directions)[0].sum(axis=1) / density
        even = luminaire.eval(points, uniform)[0].sum(axis=1) * angle
        found[label] = float(light.var() / even.var()) if even.any() else 1.0
    return found


def draw(name: str, evaluations: dict[str, Any], path: Path) -> None:
    """Contact sheet of the first test view: radiance and opacity, reference and methods."""
    from lumitree.core.drawing import OPACITY, Tile, image_grid
    from lumitree.core.images import auto_exposure, tonemap

    first = next(iter(evaluations.values())).rows[0]
    exposure = auto_exposure(first.reference)
    radiance = [Tile(tonemap(first.reference, exposure))]
    opacity = [Tile(OPACITY(first.reference_opacity))]
    for evaluation in evaluations.values():
        row = evaluation.rows[0]
        psnr = f"psnr_linear {row.metrics['psnr_linear']:.2f} dB"
        radiance.append(Tile(tonemap(row.baked, exposure), psnr))
        rmse = f"opacity_rmse {row.metrics['opacity_rmse']:.3f}"
        opacity.append(Tile(OPACITY(row.baked_opacity), rmse))
    sheet = image_grid(
        [radiance, opacity],
        240,
        title=f"{name}, {first.name}",
        columns=["Reference", *evaluations],
    )
    path.write_bytes(sheet.png())


def table(rows: list[dict[str, Any]]) -> Table:
    """A line for each luminaire and method."""
    heads = ["luminaire", "method", "s", *COLUMNS, "ms an image", "over network", "kB"]
    heads += [f"variance, {label}" for label in RECEIVERS]
    base = {row["luminaire"]: row["milliseconds"] for row in rows if row["method"] == BASELINE}
    lines = []
    for row in rows:
        variance = row.get("variance", {})
        lines.append(
            [
                row["luminaire"],
                row["method"],
                f"{row['seconds']:.0f}",
                *(f"{row['metrics'][column]:.{digits}f}" for column, digits in COLUMNS.items()),
                f"{row['milliseconds']:.1f}",
                f"{row['milliseconds'] / base[row['luminaire']]:.2f}",
                f"{row['bytes'] / 1e3:.0f}",
                *(f"{variance[label]:.2f}" if variance else "" for label in RECEIVERS),
            ]
        )
    return Table(heads, lines, left=2)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("luminaires", metavar="LUMINAIRE", nargs="*", default=["dallas"])
    parser.add_argument("--views", type=int, metavar="N", default=60, help="that are fitted")
    parser.add_argument("--resolution", type=int, metavar="R", default=192, help="pixels a side")
    parser.add_argument("--spp", type=int, metavar="S", default=48, help="samples a pixel of them")
    parser.add_argument("--test-views", type=int, metavar="N", default=6, help="for the metrics")
    parser.add_argument("--test-spp", type=int, metavar="S", default=512, help="samples a pixel")
    parser.add_argument(
        "--seconds", type=float, metavar="S", default=120.0, help="that each method gets"
    )
    parser.add_argument(
        "--converge",
        action="store_true",
        help="train the networks of Zhu et al. to convergence too, which takes long on a CPU",
    )
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    check_network()
    results = Results(
        options,
        views=f"{options.views} of {options.resolution}², {options.spp} samples a pixel",
        test_views=f"{options.test_views}, {options.test_spp} samples a pixel",
        seconds_each=options.seconds,
        baseline=BASELINE,
    )
    rows: list[dict[str, Any]] = []
    sheets = ""
    for name in options.luminaires:
        sheet = results.folder / f"zhu-{Path(name).stem}.png"
        found, facts = measure(name, options, sheet)
        rows += found
        sheets += f"![{name}]({sheet.name})\n\n"
        text = f"# Zhu et al. 2021\n\n{table(rows).markdown()}\n{sheets}"
        setting = results.setting() | facts
        results.write({"setting": setting, "rows": rows}, text + notes(setting))
    print(table(rows).text())
