"""Exported lamps in Blender's Cycles, against the explicit lamps at equal time.

    python -m benchmarks blender [--blender PROGRAM] [--assets FOLDER] [LUMINAIRE ...]

Writes `blender.md` and `blender.json`. First the error of the irradiance of clusters
of point lights, against light paths of the luminaire, by number of lights, without Blender. Then a
diffuse room that the lamp alone illuminates: rendered by Cycles with the exported lamp, by Cycles
with the same lamp as explicit geometry in about the same CPU time, and by Mitsuba with the asset.
Noise is the standard deviation of a pixel over images of different seeds, relative to the mean of
its wall. `--blender` names Blender, or a Python with the module bpy; without either only the first
table is made. `--image` writes the three images of the first luminaire side by side.
"""

import argparse
import importlib.metadata
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.options import add_pixels, add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.cycles.room import (
    LAMP_CENTRE,
    PATH_DEPTH,
    CyclesJob,
    Images,
    mitsuba_room,
    region_masks,
    render_cycles,
)
from lumitree.errors import LumitreeError

LIGHTS = (1, 4, 8, 16, 32, 64)
REFERENCE_PATHS = 1 << 21
RAYS = 1 << 20
# Samples of the image that tells how long a sample of the explicit lamp takes.
_TRIAL_SAMPLES = 8
METHODS = ("exported", "explicit", "mitsuba")


def irradiance_rows(name: str, asset: Any, seed: int) -> list[dict]:
    """Irradiance error of the field itself and of clusters of it."""
    from benchmarks.cycles.table_rays import TableRays
    from lumitree.lamp.loading import load_luminaire
    from lumitree.measure.irradiance import (
        asset_irradiance,
        irradiance_error,
        luminaire_irradiance,
        rays_irradiance,
    )
    from lumitree.output.point_lights import cluster_lights

    half = asset.frame.half_extents
    reference = luminaire_irradiance(load_luminaire(name), REFERENCE_PATHS, seed=seed)
    estimates = {"field": asset_irradiance(asset, RAYS, seed=seed)}
    for count in LIGHTS:
        rays = TableRays(cluster_lights(asset.light_field, half, count, seed))
        estimates[str(count)] = rays_irradiance(rays, half, RAYS, draw=2, seed=seed)
    rows = []
    for lights, estimate in estimates.items():
        error = irradiance_error(estimate, reference)
        rows.append(
            {
                "luminaire": name,
                "lights": lights,
                "smallest_ratio": float(error.ratio[:6].min()),
                "largest_ratio": float(error.ratio[:6].max()),
                "rms": error.mean_rms,
                "rms_touching": float(error.rms[6]),
                "rms_touching_error": float(error.rms_error[6]),
            }
        )
    return rows


def render_room(asset: Any, program: str, options: argparse.Namespace) -> dict[str, Images]:
    """Images of the room by method."""
    import lumitree

    width, height = options.width, options.width * 3 // 4
    at = (np.array(LAMP_CENTRE) - asset.frame.centre).tolist()
    seeds = [options.seed + index for index in range(options.images)]
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "lamp.py"
        lumitree.export(asset, script)

        def cycles(explicit: bool, samples: int, seeds: list[int]) -> Images:
            job = CyclesJob(str(script), explicit, at, width, height, samples, seeds)
            return render_cycles(program, job)

        exported = cycles(False, options.spp, seeds)
        trial = cycles(True, _TRIAL_SAMPLES, seeds[:1])
        share = exported.cpu_seconds.mean() / trial.cpu_seconds.mean()
        samples = max(1, round(_TRIAL_SAMPLES * float(share)))
        explicit = cycles(True, samples, seeds)
    return {
        "exported": exported,
        "explicit": explicit,
        "mitsuba": _render_mitsuba(asset, width, height, options.spp, seeds),
    }


def _render_mitsuba(asset: Any, width: int, height: int, samples: int, seeds: list[int]) -> Images:
    import mitsuba as mi

    from lumitree.rendering.passes import Budget, render_passes
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire, place_luminaires

    lamp = PlacedLuminaire(Placement(asset, at=LAMP_CENTRE))
    scene = place_luminaires(mitsuba_room(width, height), [lamp], appearance="geometry")
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": PATH_DEPTH})
    images, wall, cpu = [], [], []
    # Kernels are compiled first.
    render_passes(scene, integrator, Budget(1))
    for seed in seeds:
        start, start_cpu = time.perf_counter(), time.process_time()
        images.append(render_passes(scene, integrator, Budget(samples), seed=seed).radiance)
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - start_cpu)
    return Images(
        np.array(images),
        np.array(wall),
        np.array(cpu),
        samples,
        f"Mitsuba {importlib.metadata.version('mitsuba')}",
    )


def room_rows(name: str, asset: Any, rendered: dict[str, Images]) -> list[dict]:
    """Luminance, noise and seconds by wall and method."""
    height, width = rendered["exported"].images.shape[1:3]
    masks = region_masks(width, height, asset.frame.size / 2)
    rows = []
    for method in METHODS:
        found = rendered[method]
        grey = found.images @ np.array([0.2126, 0.7152, 0.0722])
        rows.append(
            {
                "luminaire": name,
                "method": method,
                "version": found.version,
                "samples": found.samples,
                "seconds": float(found.seconds.mean()),
                "cpu_seconds": float(found.cpu_seconds.mean()),
                "walls": {wall: _statistics(grey[:, mask]) for wall, mask in masks.items()},
            }
        )
    return rows


def _statistics(pixels: NDArray[np.floating]) -> dict[str, float]:
    """Mean of a wall with its standard error, and noise, of images [N, P]."""
    means = pixels.mean(axis=1)
    mean = float(means.mean())
    return {
        "mean": mean,
        "mean_error": float(means.std(ddof=1) / np.sqrt(len(means))),
        "noise": float(np.sqrt(pixels.var(axis=0, ddof=1).mean()) / mean),
    }


def irradiance_table(rows: list[dict]) -> Table:
    """Irradiance error by number of lights."""
    heads = ["luminaire", "lights", "ratio of a face", "RMS, mean", "RMS, touching"]
    lines = [
        [
            row["luminaire"],
            row["lights"],
            f"{row['smallest_ratio']:.3f} to {row['largest_ratio']:.3f}",
            f"{row['rms']:.1%}",
            f"{row['rms_touching']:.1%} ± {row['rms_touching_error']:.1%}",
        ]
        for row in rows
    ]
    return Table(heads, lines, left=2)


def room_table(rows: list[dict]) -> Table:
    """Seconds, noise, and luminance of each wall over that of the asset in Mitsuba."""
    walls = list(rows[0]["walls"])
    heads = ["luminaire", "lamp", "samples", "s", "CPU s", "noise"]
    lines = []
    for row in rows:
        base = next(
            each["walls"]
            for each in rows
            if (each["luminaire"], each["method"]) == (row["luminaire"], "mitsuba")
        )
        noise = [row["walls"][wall]["noise"] for wall in walls]
        cells = [f"{row['seconds']:.1f}", f"{row['cpu_seconds']:.1f}"]
        cells.append(f"{min(noise):.2f} to {max(noise):.2f}")
        for wall in walls:
            mean, error = (row["walls"][wall][key] / base[wall]["mean"] for key in _MEAN)
            cells.append(f"{mean:.3f} ± {error:.3f}")
        lines.append([row["luminaire"], _NAMES[row["method"]], str(row["samples"]), *cells])
    return Table([*heads, *walls], lines, left=2)


_MEAN = "mean", "mean_error"
_NAMES = {
    "exported": "Cycles, exported",
    "explicit": "Cycles, explicit",
    "mitsuba": "Mitsuba, asset",
}


def write_image(path: Path, rendered: dict[str, Images]) -> None:
    """The first image of each method side by side, as JPEG."""
    from PIL import Image

    from lumitree.core.drawing import write_strip
    from lumitree.core.files import atomic_path

    exposure = 0.5 / float(np.median(rendered["mitsuba"].images[0]))
    panels = []
    for method in ("explicit", "exported", "mitsuba"):
        found = rendered[method]
        caption = f"{_NAMES[method]}\n{found.samples} samples, {found.cpu_seconds[0]:.0f} CPU s"
        panels.append((caption, found.images[0]))
    with tempfile.TemporaryDirectory() as folder, atomic_path(path) as temporary:
        strip = Path(folder) / "strip.png"
        write_strip(strip, panels, exposure)
        Image.open(strip).convert("RGB").save(temporary, "JPEG", quality=88)


def report(irradiance: list[dict], rooms: list[dict], facts: dict[str, Any]) -> str:
    """Text of the Markdown file."""
    text = f"# Blender\n\n{irradiance_table(irradiance).markdown()}\n"
    if rooms:
        text += "Walls: mean luminance over that of the asset in Mitsuba ± standard error.\n\n"
        text += f"{room_table(rooms).markdown()}\n"
    return text + notes(facts)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("luminaires", metavar="LUMINAIRE", nargs="*", default=["dallas", "bulbs"])
    parser.add_argument("--blender", metavar="PROGRAM", help="Blender, or a Python with bpy")
    parser.add_argument(
        "--assets", type=Path, metavar="FOLDER", help="where assets are kept (default: nowhere)"
    )
    parser.add_argument("--image", type=Path, metavar="FILE", help="JPEG file to write")
    parser.add_argument("--images", type=int, default=3, help="of different seeds, at least 2")
    add_pixels(parser, "--width", 320, 24)
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    import lumitree
    from lumitree.output.blender.blender import find_blender

    if options.images < 2:
        raise LumitreeError(f"--images is {options.images}; noise needs 2 images at least")
    program = None if options.blender is None else find_blender(options.blender)
    results = Results(options, path_depth=PATH_DEPTH, clock="wall and CPU time of an image")
    irradiance: list[dict] = []
    rooms: list[dict] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.assets or Path(scratch)
        for name in options.luminaires:
            path = folder / f"{name}.lumitree"
            if not path.exists():
                lumitree.bake(
                    name, path, lumitree.BakeConfig(parts=("light", "geometry"), irradiance_paths=0)
                )
            asset = lumitree.load(path)
            irradiance += irradiance_rows(name, asset, options.seed)
            if program is not None:
                rendered = render_room(asset, program, options)
                if options.image is not None and not rooms:
                    write_image(options.image, rendered)
                rooms += room_rows(name, asset, rendered)
            facts = results.setting()
            found = {"setting": facts, "irradiance": irradiance, "rooms": rooms}
            results.write(found, report(irradiance, rooms, facts))
            print(f"measured {name}", file=sys.stderr)
    print(irradiance_table(irradiance).text())
    if rooms:
        print(room_table(rooms).text())
