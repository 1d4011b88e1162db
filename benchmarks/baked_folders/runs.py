"""Bakes of a folder by the command, whose time and memory are measured over several calls."""

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from lumitree.core.files import write_json
from lumitree.errors import LumitreeError

_SAMPLE_SECONDS = 1.0


def bake(work: Path, workers: int, options: argparse.Namespace) -> dict[str, float]:
    """Bake all lamps by so many workers; returns seconds and peak memory, of all calls.

    What has been measured so far is in a file, to which the next call adds.
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
