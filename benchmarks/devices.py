"""Seconds of a bake and of images, and what they show, by each variant of Mitsuba.

    python -m benchmarks devices --variant llvm_ad_rgb
    python -m benchmarks devices --variant cuda_ad_rgb

A run measures one variant and keeps the rows of the others that the files hold. A built-in lamp is
baked twice with equal settings, by numbers of rays and not by time; the first bake compiles the
kernels. The demonstration's room is then rendered with the asset and with the explicit lamp: once
with compilation, then in turns, medians. Two variants agree if the means of an image's tiles differ
by no more than with two seeds. Writes `devices.md` and `devices.json`;
the baseline is `llvm_ad_rgb`, with which the files begin.
"""

import argparse
import dataclasses
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lumitree
from benchmarks.common.demo_lamps import placed
from benchmarks.common.options import add_pixels, add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import interleaved
from lumitree.asset.asset import PARTS
from lumitree.fit.bake import bake
from lumitree.fit.config import BakeConfig

LAMPS = ("baked", "explicit")
# Tiles of an image a side, of which the means are compared.
TILES = 8
# Facts that the rows of all variants share.
SHARED = ("luminaire", "width", "spp", "rays", "seed")


def measure_bake(lamp: str, rays: int, seed: int, path: Path) -> dict[str, Any]:
    """Seconds of two bakes by stage, and the second one's error; writes its asset."""
    config = dataclasses.replace(
        BakeConfig.standard(), parts=("light", "geometry"), irradiance_paths=0, seed=seed
    )
    if rays:
        config = dataclasses.replace(config, parts=PARTS, time=None, rays=rays)
    first, again = (bake(lamp, config=config) for _ in range(2))
    lumitree.save(again.asset, path)
    return {"first": first.seconds, "again": again.seconds, "held_out_psnr": again.held_out_psnr}


def measure_images(lamp: str, asset: Path, width: int, spp: int, seed: int) -> dict[str, Any]:
    """Seconds of the room's images, and the means of their tiles with two seeds."""
    from lumitree.rendering.integrators import default_integrator
    from lumitree.rendering.passes import Budget, render_passes
    from lumitree.rendering.scene import appearance_for

    integrator = default_integrator(12)
    images: dict[tuple[str, int], NDArray[np.float32]] = {}

    def image(name: str, scene: Any, index: int) -> Callable[[], object]:
        def run() -> None:
            budget = Budget(spp)
            found = render_passes(scene, integrator, budget, seed=seed + index, name=name)
            images[name, index] = found.radiance

        return run

    scenes, first = {}, {}
    for name, source in zip(LAMPS, (str(asset), lamp), strict=True):
        scenes[name] = placed(source, width, appearance=appearance_for(integrator))
        start = time.perf_counter()
        image(name, scenes[name], 0)()
        first[name] = time.perf_counter() - start
    jobs = {name: (lambda index, name=name: image(name, scenes[name], index)) for name in LAMPS}
    again = interleaved(jobs)
    return {
        name: {
            "first": first[name],
            "again": again[name],
            "tiles": [tiles(images[name, index]).tolist() for index in (1, 2)],
        }
        for name in LAMPS
    }


def tiles(image: NDArray[np.float32]) -> NDArray[np.float64]:
    """Means [TILES, TILES, 3] of an image whose sides are multiples of TILES."""
    height, width, _ = image.shape
    parts = image.reshape(TILES, height // TILES, TILES, width // TILES, 3)
    return parts.astype(np.float64).mean(axis=(1, 3))


def difference(row: dict[str, Any], other: dict[str, Any], lamp: str) -> tuple[float, float]:
    """RMS of the tiles' relative differences: to the other row, and of two seeds in it."""
    here, there = (np.array(each["images"][lamp]["tiles"]) for each in (row, other))
    scale = there.mean(axis=0)
    between, seeds = here[0] - there[0], there[1] - there[0]
    return _rms(between / scale), _rms(seeds / scale)


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean()))


def table(rows: list[dict[str, Any]]) -> Table:
    """A line for each variant."""
    heads = ["variant", "bake, s", "first", "baseline / it"]
    for lamp in LAMPS:
        heads += [f"room {lamp}, s", "first", "baseline / it", "differs by", "two seeds by"]
    lines = []
    for row in rows:
        seconds = [sum(row["bake"][which].values()) for which in ("again", "first")]
        base = sum(rows[0]["bake"]["again"].values())
        line = [row["setting"]["variant"], *(f"{each:.1f}" for each in seconds)]
        line.append(f"{base / seconds[0]:.1f}")
        for lamp in LAMPS:
            times = row["images"][lamp]
            line += [f"{times['again']:.2f}", f"{times['first']:.1f}"]
            line.append(f"{rows[0]['images'][lamp]['again'] / times['again']:.1f}")
            line += [f"{100 * each:.3f} %" for each in difference(row, rows[0], lamp)]
        lines.append(line)
    return Table(heads, lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("luminaire", metavar="LUMINAIRE", nargs="?", default="bulbs")
    parser.add_argument(
        "--rays",
        type=int,
        metavar="N",
        default=1 << 22,
        help="of the octree fit; 0: assets have no radiance field",
    )
    add_pixels(parser, "--width", 480, 64)
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    results = Results(
        options,
        luminaire=options.luminaire,
        width=options.width,
        spp=options.spp,
        rays=options.rays,
        seed=options.seed,
    )
    with tempfile.TemporaryDirectory() as folder:
        asset = Path(folder) / "lamp.lumitree"
        baked = measure_bake(options.luminaire, options.rays, options.seed, asset)
        images = measure_images(options.luminaire, asset, options.width, options.spp, options.seed)
    facts = results.setting()
    row = {"setting": facts, "bake": baked, "images": images}
    kept = [
        other
        for other in results.stored([])
        if other["setting"]["variant"] != facts["variant"]
        and all(other["setting"][key] == facts[key] for key in SHARED)
    ]
    rows = sorted([*kept, row], key=lambda each: each["setting"]["variant"], reverse=True)
    shown = table(rows)
    print(shown.text())
    settings = "\n".join(notes(each["setting"]) for each in rows)
    results.write(rows, f"# Devices\n\n{shown.markdown()}\n{settings}")
