"""Folders of many lamps: time, memory and bytes of their bakes.

    python -m benchmarks many_lamps --work FOLDER [--lamps 20] [--workers 1 2] [--rounds 1]

Writes small lamps of three kinds into FOLDER, and bakes them by `lumitree bake --workers`, each
worker with a core of its own; then the same command again, which keeps all of them, and `lumitree
collect`. The baseline is one worker. Several rounds, each of lamps of its own, bake by the numbers
of workers in turn, so that a machine that becomes slower does so for all. The same command
continues a run that was interrupted. Writes `many_lamps.json` and `many_lamps.md`.
"""

import argparse
import os
import statistics
import subprocess
import time
from pathlib import Path
from typing import Any

import lumitree
from benchmarks.baked_folders.lamps import write_lamps
from benchmarks.baked_folders.runs import bake, bake_command, baked_folder
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from lumitree.errors import LumitreeError

# Largest load, as `os.getloadavg` states it, of a machine that does nothing else.
_IDLE_LOAD = 0.5


def measure_folder(work: Path, workers: int, options: argparse.Namespace) -> dict[str, Any]:
    """Seconds of a call that keeps all lamps and of the page; bytes by kind of file."""
    folder = baked_folder(work, workers)
    command = bake_command(work, workers, options)
    start = time.perf_counter()
    subprocess.run(command, cwd=work, check=True, capture_output=True)
    whole = time.perf_counter() - start
    names = [str(work / line) for line in (work / "lamps.txt").read_text().splitlines()]
    config = {
        "preview": lumitree.BakeConfig.preview,
        "standard": lumitree.BakeConfig.standard,
        "high": lumitree.BakeConfig.high,
    }[options.quality]()
    start = time.perf_counter()
    kept = lumitree.bake_many(names, folder, config, progress=None)
    check = time.perf_counter() - start
    if any(each.state != "kept" for each in kept.lamps):
        raise LumitreeError("a lamp was not kept; remove the folder of --work, and begin again")
    page = lumitree.collect(folder).seconds["collect"]
    files = [path for path in folder.rglob("*") if path.is_file()]
    kinds = {"assets": ".lumitree", "records": ".json", "thumbnails": ".webp", "pages": ".html"}
    sizes = {
        kind: sum(path.stat().st_size for path in files if path.suffix == suffix)
        for kind, suffix in kinds.items()
    }
    return {
        "command_seconds": whole,
        "check_seconds": check,
        "page_seconds": page,
        "bytes": sizes,
        "first_page_bytes": (folder / "index.html").stat().st_size,
        "names_bytes": (folder / "index-files/folder/names.js").stat().st_size,
        "lamp_seconds": [lamp.seconds for lamp in kept.lamps],
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
        ["record, kB a lamp", f"{sizes['records'] / lamps / 1e3:.1f}"],
        [
            "pages and names, kB a lamp",
            f"{(sizes['pages'] + found['names_bytes']) / lamps / 1e3:.2f}",
        ],
        ["first page, kB", f"{found['first_page_bytes'] / 1e3:.0f}"],
        ["all lamps kept: whole command, s", f"{found['command_seconds']:.2f}"],
        ["all lamps kept: check and page, s", f"{found['check_seconds']:.3f}"],
        ["pages alone, s", f"{found['page_seconds']:.3f}"],
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
