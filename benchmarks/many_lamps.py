"""Folders of many lamps: time, memory and bytes of their bakes.

    python -m benchmarks many_lamps --work FOLDER [--lamps 20] [--workers 1 2] [--rounds 1]

Writes small lamps of three kinds into FOLDER, and bakes them by `lumitree bake --workers`, each
worker with a core of its own; then the same command again, which keeps all of them, and `lumitree
collect`. The baseline is one worker. Several rounds, each of lamps of its own, bake by the numbers
of workers in turn, so that a machine that becomes slower does so for all. The same command
continues a run that was interrupted. Writes `many_lamps.json` and `many_lamps.md`.
"""

import argparse
import contextlib
import json
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import lumitree
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from lumitree.core.files import write_bytes, write_json
from lumitree.errors import LumitreeError

# Largest load, as `os.getloadavg` states it, of a machine that does nothing else.
_IDLE_LOAD = 0.5
_SAMPLE_SECONDS = 1.0
SCENE = '<scene version="3.0.0">\n{}\n</scene>\n'
LIGHT = '<emitter type="area"><rgb name="radiance" value="{}"/></emitter>'
GLASS = '<bsdf type="dielectric"/>'
METAL = (
    '<bsdf type="twosided"><bsdf type="roughconductor"><string name="material" value="{}"/>'
    '<float name="alpha" value="{:.3f}"/></bsdf></bsdf>'
)
WHITE = (
    '<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf></bsdf>'
)


def lamp(index: int, seed: int) -> str:
    """Scene of a pendant, a table lamp or a panel, with random sizes and materials."""
    random = np.random.default_rng([seed, index])
    size, radius = random.uniform(0.8, 1.2), random.uniform(0.03, 0.05)
    metal = METAL.format(random.choice(["Al", "Cu", "Au", "Cr"]), random.uniform(0.05, 0.3))
    light = LIGHT.format(f"{random.uniform(2e3, 2e4):.1f}")
    bulb = [
        _shape("sphere", (radius,) * 3, (0, 0, 0), GLASS),
        _shape("sphere", (0.3 * radius,) * 3, (0, 0, 0), light),
    ]
    match index % 3:
        case 0:
            shapes = [*bulb, _shape("cylinder", (0.1 * size, 0.1 * size, 0.2), (0, 0, -0.1), metal)]
        case 1:
            shapes = [
                *bulb,
                _shape("cylinder", (0.12 * size, 0.12 * size, 0.15), (0, 0, -0.05), WHITE),
                _shape("cylinder", (0.01, 0.01, 0.3), (0, 0, -0.37), metal),
                _shape("disk", (0.08 * size,) * 3, (0, 0, -0.37), metal),
            ]
        case _:
            shapes = [
                _shape("rectangle", (0.3 * size, 0.05, 1), (0, 0, 0), light),
                _shape("cube", (0.32 * size, 0.07, 0.02), (0, 0, -0.03), WHITE),
            ]
    return SCENE.format("\n".join(shapes))


def _shape(kind: str, scale: Sequence[float], at: Sequence[float], inside: str) -> str:
    """An analytic shape, scaled and moved."""
    sides = " ".join(f'{axis}="{value:.5f}"' for axis, value in zip("xyz", scale, strict=True))
    place = " ".join(f'{axis}="{value:.5f}"' for axis, value in zip("xyz", at, strict=True))
    return (
        f'<shape type="{kind}"><transform name="to_world"><scale {sides}/><translate {place}/>'
        f"</transform>{inside}</shape>"
    )


def write_lamps(work: Path, count: int, seed: int) -> None:
    """Write the scenes and their list; refuses a folder of another number or seed."""
    settings = {"lamps": count, "seed": seed}
    path = work / "settings.json"
    if path.is_file():
        if json.loads(path.read_text(encoding="utf-8")) != settings:
            raise LumitreeError(f"{work.name} has other lamps; choose another folder with --work")
        return
    (work / "lamps").mkdir(parents=True, exist_ok=True)
    names = [f"lamps/lamp-{index:05d}.xml" for index in range(count)]
    for index, name in enumerate(names):
        (work / name).write_text(lamp(index, seed), encoding="utf-8")
    write_bytes(work / "lamps.txt", "".join(f"{name}\n" for name in names).encode())
    write_json(path, settings)


def bake(work: Path, workers: int, options: argparse.Namespace) -> dict[str, float]:
    """Bake all lamps by so many workers; returns seconds and peak memory, of all calls.

    A file has the measurements so far, and the next call adds to it.
    """
    path = work / f"workers-{workers}.json"
    measured = {"seconds": 0.0, "peak_bytes": 0.0, "calls": 0.0, "finished": 0.0}
    if path.is_file():
        measured |= json.loads(path.read_text(encoding="utf-8"))
    if measured["finished"]:
        return measured
    measured["calls"] += 1
    before, start = measured["seconds"], time.perf_counter()
    with _running(bake_command(work, workers, options), work, workers) as process:
        while not _ended(process):
            measured["seconds"] = before + time.perf_counter() - start
            measured["peak_bytes"] = max(measured["peak_bytes"], _session_bytes(process.pid))
            write_json(path, measured)
    measured["seconds"] = before + time.perf_counter() - start
    if process.returncode:
        raise LumitreeError(
            f"the bake by {workers} workers ended with status {process.returncode}; its last lines "
            f"are in {path.stem}.log; the same command continues"
        )
    measured["finished"] = 1.0
    write_json(path, measured)
    return measured


def _ended(process: subprocess.Popen[bytes]) -> bool:
    """Whether a process has ended, after a while at most."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_SAMPLE_SECONDS)
        return True
    return False


@contextlib.contextmanager
def _running(command: list[str], work: Path, workers: int) -> Iterator[subprocess.Popen[bytes]]:
    """Context with a process of a session of its own, on as many cores as workers."""
    cores = sorted(os.sched_getaffinity(0))[:workers]
    with open(work / f"workers-{workers}.log", "ab") as log:
        process = subprocess.Popen(
            command,
            cwd=work,
            stdout=log,
            stderr=log,
            start_new_session=True,
            preexec_fn=lambda: os.sched_setaffinity(0, cores),
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
                process.wait()


def bake_command(work: Path, workers: int, options: argparse.Namespace) -> list[str]:
    command = [sys.executable, "-m", "lumitree", "bake", "@lamps.txt"]
    command += ["-o", f"{baked_folder(work, workers).name}/", "--quality", options.quality]
    return [*command, "--workers", str(workers)]


def baked_folder(work: Path, workers: int) -> Path:
    return work / f"baked-{workers}"


def _session_bytes(session: int) -> float:
    """Memory of all processes of a session; what they share counts once."""
    total = 0.0
    for entry in os.scandir("/proc"):
        with contextlib.suppress(OSError, ValueError):
            if not entry.name.isdecimal() or os.getsid(int(entry.name)) != session:
                continue
            text = Path(entry.path, "smaps_rollup").read_text()
            line = next(line for line in text.splitlines() if line.startswith("Pss:"))
            total += 1024 * float(line.split()[1])
    return total


def measure_folder(work: Path, workers: int, options: argparse.Namespace) -> dict[str, Any]:
    """Seconds of a call that keeps all lamps and of the page; bytes by kind of file."""
    folder = baked_folder(work, workers)
    command = bake_command(work, workers, options)
    start = time.perf_counter()
    subprocess.run(command, cwd=work, check=True, capture_output=True)
    whole = time.perf_counter() - start
    names = [str(work / line) for line in (work / "lamps.txt").read_text().splitlines()]
    config = lumitree.BakeConfig.of(options.quality)
    start = time.perf_counter()
    kept = lumitree.bake_many(names, folder, config, progress=None)
    check = time.perf_counter() - start
    if any(each.state != "kept" for each in kept.lamps):
        raise LumitreeError("a lamp was not kept; remove the folder of --work, and begin again")
    page = lumitree.collect(folder).seconds["collect"]
    files = [path for path in folder.rglob("*") if path.is_file()]
    kinds = {"assets": ".lumitree", "thumbnails": ".jpg", "page": ".html"}
    sizes = {
        kind: sum(path.stat().st_size for path in files if path.suffix == suffix)
        for kind, suffix in kinds.items()
    }
    return {
        "command_seconds": whole,
        "check_seconds": check,
        "page_seconds": page,
        "bytes": sizes,
    }


def bake_table(rows: list[dict[str, Any]], lamps: int) -> Table:
    """A line for each number of workers."""
    heads = ["workers", "s", "s / lamp", "efficiency", "peak memory, MB", "calls"]
    first = rows[0]
    lines = [
        [
            str(row["workers"]),
            f"{row['seconds']:.1f}",
            f"{row['seconds'] / lamps:.2f}",
            f"{_efficiency(first, row):.3f}",
            f"{row['peak_bytes'] / 1e6:.0f}",
            f"{row['calls']:.0f}",
        ]
        for row in rows
    ]
    return Table(heads, lines, left=0)


def _efficiency(first: dict[str, Any], row: dict[str, Any]) -> float:
    """Seconds of workers in the first row over those in another one; the median of rounds."""
    of_rounds = [
        one * first["workers"] / (other * row["workers"])
        for one, other in zip(first["rounds"], row["rounds"], strict=True)
    ]
    return statistics.median(of_rounds)


def _together(workers: int, rounds: list[dict[str, float]]) -> dict[str, Any]:
    """Row of a number of workers: sums over rounds, and the largest memory."""
    return {
        "workers": workers,
        "seconds": sum(each["seconds"] for each in rounds),
        "peak_bytes": max(each["peak_bytes"] for each in rounds),
        "calls": sum(each["calls"] for each in rounds),
        "rounds": [each["seconds"] for each in rounds],
    }


def rounds_table(rows: list[dict[str, Any]]) -> Table:
    """Seconds of each round by the number of workers."""
    heads = ["round", *(f"workers: {row['workers']}, s" for row in rows)]
    lines = [
        [str(number), *(f"{seconds:.1f}" for seconds in each)]
        for number, each in enumerate(zip(*(row["rounds"] for row in rows), strict=True), 1)
    ]
    return Table(heads, lines, left=0)


def folder_table(found: dict[str, Any], lamps: int) -> Table:
    """Bytes of a lamp, and seconds of a folder in which all is done."""
    sizes = found["bytes"]
    rows = [
        ["asset, kB a lamp", f"{sizes['assets'] / lamps / 1e3:.1f}"],
        ["thumbnail, kB a lamp", f"{sizes['thumbnails'] / lamps / 1e3:.1f}"],
        ["page, kB a lamp", f"{sizes['page'] / lamps / 1e3:.2f}"],
        ["all lamps kept: whole command, s", f"{found['command_seconds']:.2f}"],
        ["all lamps kept: check and page, s", f"{found['check_seconds']:.3f}"],
        ["page alone, s", f"{found['page_seconds']:.3f}"],
    ]
    return Table(["figure", "value"], rows)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--work", metavar="FOLDER", type=Path, required=True, help="lamps and assets; it is kept"
    )
    parser.add_argument("--lamps", type=int, metavar="N", default=20, help="to bake in a round")
    parser.add_argument("--rounds", type=int, metavar="N", default=1, help="each of other lamps")
    parser.add_argument("--workers", type=int, nargs="+", metavar="N", default=[1, 2])
    parser.add_argument("--quality", default="preview", choices=("preview", "standard", "high"))
    parser.add_argument("--seed", type=int, metavar="S", default=0, help="of the lamps")


def run(options: argparse.Namespace) -> None:
    works = [options.work.resolve()]
    if options.rounds > 1:
        works = [works[0] / f"round-{number}" for number in range(1, options.rounds + 1)]
    for number, work in enumerate(works):
        write_lamps(work, options.lamps, options.seed + number)
    load = round(os.getloadavg()[0], 1)
    results = Results(options, lamps=options.lamps, quality=options.quality, load_at_start=load)
    measured: dict[int, list[dict[str, float]]] = {workers: [] for workers in options.workers}
    for work in works:
        for workers in options.workers:
            measured[workers].append(bake(work, workers, options))
            print(f"{work.name}: {measured[workers][-1]['seconds']:.1f} s", flush=True)
    rows = [_together(workers, rounds) for workers, rounds in measured.items()]
    print(bake_table(rows, options.lamps * options.rounds).text(), flush=True)
    found = measure_folder(works[0], options.workers[0], options)
    print(folder_table(found, options.lamps).text(), flush=True)
    facts = results.setting()
    busy = f"Measured while the machine did other work (load {load}): the times are too long.\n"
    sections = [
        f"# Folders of many lamps{', in rounds' if options.rounds > 1 else ''}\n",
        *([busy] if load > _IDLE_LOAD else []),
        bake_table(rows, options.lamps * options.rounds).markdown(),
        "Efficiency: seconds of workers in the first row over those in each; the median of rounds. "
        "Each worker has one core. Peak memory: of all processes together.\n",
        *([rounds_table(rows).markdown()] if options.rounds > 1 else []),
        folder_table(found, options.lamps).markdown(),
        notes(facts),
    ]
    report = {"setting": facts, "bakes": rows, "folder": found}
    results.write(report, "\n".join(sections))
