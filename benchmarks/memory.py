"""Memory of one process that opens many assets, and of one that bakes again and again.

    python -m benchmarks memory [--assets 1000] [--bakes 100 | --hours H] [--luminaire NAME ...]

*opened*: so many assets, each a file of its own, are loaded, placed in a room, rendered with one
sample a pixel, and dropped. *loaded*: they are only loaded and dropped. *baked*: luminaires are
baked in turn, without files, for a number of bakes or of hours. *read*: as many luminaires are
loaded from dictionaries, each of another size, and dropped.

After each step: resident memory, open files, and bytes in the folder for temporary files. The first
fifth of the steps is the warm-up, in which kernels are compiled. The growth is the slope of a line
that is fitted to the others, ± its standard error, for which neighbouring steps are joined in 16
groups; the baseline is the memory at the end of the warm-up. Writes `memory.md` and `memory.json`.
"""

import argparse
import gc
import os
import resource
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import lumitree
from benchmarks.common.options import add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from lumitree.core.files import SCRATCH
from lumitree.errors import LumitreeError
from lumitree.trace.light_field_config import LightFieldConfig

ROOM = """<scene version="3.0.0"><integrator type="path"/><sensor type="perspective">
<transform name="to_world"><lookat origin="0,0,6" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/></film>
</sensor><shape type="rectangle"><transform name="to_world"><scale value="4"/>
<translate z="-2"/></transform></shape></scene>
"""
# Part of the steps that does not count, and groups of the others.
WARM_UP, GROUPS = 0.2, 16
# Light paths of a bake.
PATHS = 1 << 18


def resident_bytes() -> int:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


def measured(steps: Iterator[None]) -> list[dict[str, float]]:
    """What the process holds after each step."""
    start, rows = time.perf_counter(), []
    for _ in steps:
        gc.collect()
        rows.append(
            {
                "seconds": round(time.perf_counter() - start, 3),
                "resident_bytes": resident_bytes(),
                "open_files": len(os.listdir("/proc/self/fd")),
                "temporary_bytes": _temporary_bytes(),
            }
        )
    return rows


def _temporary_bytes() -> int:
    """Bytes of the temporary folders of this process, which `run` gives a folder of its own."""
    folders = Path(tempfile.gettempdir()).glob(f"{SCRATCH}*")
    return sum(path.stat().st_size for folder in folders for path in folder.rglob("*"))


def growth(values: NDArray[np.float64]) -> tuple[float, float]:
    """Slope of a line through values after the warm-up, per step, and its standard error."""
    steady = values[int(WARM_UP * len(values)) :]
    groups = np.array_split(np.arange(len(steady)), min(GROUPS, len(steady)))
    x = np.array([group.mean() for group in groups])
    y = np.array([steady[group].mean() for group in groups])
    if len(x) < 3:
        return float("nan"), float("nan")
    (slope, _), covariance = np.polyfit(x, y, 1, cov=True)
    return float(slope), float(np.sqrt(covariance[0, 0]))


def _assets(folder: Path, count: int) -> list[Path]:
    """Files of one small asset."""
    baked = lumitree.bake(
        "bulbs",
        config=lumitree.BakeConfig(irradiance_paths=0, light_field=LightFieldConfig(paths=PATHS)),
        progress=None,
    )
    first = folder / "lamp0.lumitree"
    lumitree.save(baked.asset, first)
    content = first.read_bytes()
    paths = [folder / f"lamp{index}.lumitree" for index in range(count)]
    for path in paths[1:]:
        path.write_bytes(content)
    return paths


def _opened(paths: list[Path], room: Path) -> Iterator[None]:
    for path in paths:
        lamp = lumitree.Placement(lumitree.load(path), at=(0, 0, 0), size=1.0)
        lumitree.render(room, [lamp], samples_per_pixel=1, progress=None)
        del lamp
        yield


def _loaded(paths: list[Path]) -> Iterator[None]:
    for path in paths:
        lumitree.load(path)
        yield


def _read(count: int) -> Iterator[None]:
    for index in range(count):
        sphere = {"type": "sphere", "radius": 1.0 + index / count}
        lumitree.load_luminaire({**sphere, "emitter": {"type": "area"}})
        yield


def _baked(luminaires: list[str], bakes: int, hours: float | None, seed: int) -> Iterator[None]:
    start, index = time.monotonic(), 0
    while index < bakes if hours is None else time.monotonic() - start < 3600 * hours:
        lumitree.bake(
            luminaires[index % len(luminaires)],
            config=lumitree.BakeConfig(
                irradiance_paths=1 << 16,
                seed=seed + index,
                light_field=LightFieldConfig(paths=PATHS),
            ),
            progress=None,
        )
        index += 1
        yield


def table(report: dict[str, Any]) -> Table:
    """A line for each kind of step."""
    heads = ["steps", "number", "s", "MB after the warm-up", "MB at the end", "MB per 1,000 steps",
             "at the end / after the warm-up", "open files", "temporary kB"]  # fmt: skip
    lines = []
    for name, rows in report.items():
        values = np.array([row["resident_bytes"] for row in rows]) / 1e6
        slope, error = growth(values)
        steady = values[int(WARM_UP * len(values)) :]
        lines.append(
            [
                name,
                f"{len(rows):,}",
                f"{rows[-1]['seconds']:,.0f}",
                f"{steady[0]:.0f}",
                f"{values[-1]:.0f}",
                f"{1000 * slope:.1f} ± {1000 * error:.1f}",
                f"{values[-1] / steady[0]:.3f}",
                f"{rows[-1]['open_files']}",
                f"{rows[-1]['temporary_bytes'] / 1e3:.0f}",
            ]
        )
    return Table(heads, lines, left=1)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--assets", type=int, metavar="N", default=1000, help="that are opened")
    parser.add_argument("--bakes", type=int, metavar="N", default=100, help="number of bakes")
    parser.add_argument("--hours", type=float, metavar="H", help="of bakes, in place of --bakes")
    parser.add_argument(
        "--luminaire",
        metavar="NAME",
        nargs="+",
        default=["bulbs", "neoclassical"],
        help="what is baked, in turn",
    )
    parser.add_argument(
        "--steps",
        metavar="KIND",
        nargs="+",
        choices=KINDS,
        default=list(KINDS),
        help=f"of {', '.join(KINDS)} (default: all)",
    )
    add_seed(parser)


def _steps_of(kind: str, options: argparse.Namespace, folder: Path) -> Iterator[None]:
    if kind in ("opened", "loaded"):
        paths = _assets(folder, options.assets)
        room = folder / "room.xml"
        room.write_text(ROOM)
        return _opened(paths, room) if kind == "opened" else _loaded(paths)
    if kind == "read":
        return _read(options.assets)
    return _baked(options.luminaire, options.bakes, options.hours, options.seed)


KINDS = ("loaded", "read", "opened", "baked")


def run(options: argparse.Namespace) -> None:
    if not Path("/proc/self/statm").exists():
        raise LumitreeError("memory is read from /proc, which this system does not have")
    results = Results(options)
    report: dict[str, Any] = results.stored({"steps": {}})
    for kind in options.steps:
        with tempfile.TemporaryDirectory() as name, patch.object(tempfile, "tempdir", name):
            rows = measured(_steps_of(kind, options, Path(name)))
        report["steps"][kind] = rows
        report["setting"] = facts = results.setting()
        shown = table(report["steps"])
        results.write(report, f"# Memory of one process\n\n{shown.markdown()}\n{notes(facts)}")
        print(shown.text(), flush=True)
