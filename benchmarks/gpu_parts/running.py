"""Runs parts one after the other, each in a process of its own, until the time is spent.

A process that crashes or hangs costs its own part only. Each part leaves a record in the folder of
the results, and its log in the work folder.
"""

import contextlib
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import lumitree
from benchmarks.common.setting import commit, nvidia, processor, version
from benchmarks.gpu_parts.part import ROOT, Outcome, Part, read_json
from benchmarks.gpu_parts.sizes import SizeName
from lumitree.core.files import write_json

# Seconds between looks at a process, and for it to end by itself once it has its values.
_INTERVAL, _TO_END = 0.25, 10.0
# Least seconds with which a part is begun.
_LEAST = 30.0
# Whose versions are recorded.
_PACKAGES = ("mitsuba", "drjit", "karellen-llvm-core", "jax", "jaxlib", "numpy")


class Run:
    """Folders and settings of a run.

    Args:
        size: name of the sizes.
        variant: of Mitsuba.
        folder: of the records.
        work: of intermediate data and logs.
        command: that repeats the run.
    """

    def __init__(
        self, size: SizeName, variant: str, folder: Path, work: Path, command: str
    ) -> None:
        self.size, self.variant, self.command = size, variant, command
        self.folder, self.work = folder.resolve(), work.resolve()

    def record(self, part: Part) -> dict[str, Any]:
        """Record of a part; empty if there is none."""
        return read_json(self.folder / f"{part.name}.json")

    def is_due(self, part: Part, again: bool = False) -> bool:
        """Whether a part has to be measured.

        Args:
            again: also if it failed.
        """
        outcome = self.record(part).get("outcome", "unfinished")
        return outcome == "unfinished" or (again and outcome in ("failed", "timed out"))

    def measure(self, part: Part, seconds: float, command: Sequence[str] | None = None) -> Outcome:
        """Run a part in a process of its own for at most so many seconds, and write its record.

        Args:
            command: of the process, to which the file of its job is added.
        """
        start = time.time()
        end = start + min(seconds, part.seconds)
        self.work.mkdir(parents=True, exist_ok=True)
        state, job, log = (self.work / f"{part.name}.{kind}" for kind in ("state", "job", "log"))
        state.unlink(missing_ok=True)
        described = {"part": part.name, "size": self.size, "variant": self.variant, "end": end}
        described |= {"work": str(self.work), "folder": str(self.folder), "state": str(state)}
        write_json(job, described)
        process = command or [sys.executable, "-m", "benchmarks.gpu_parts"]
        how = _run_process([*process, str(job)], state, log, end)
        found = read_json(state)
        outcome: Outcome = found.get("outcome") or "failed"
        reason = found.get("reason", "")
        if not found.get("outcome") and how == "killed":
            outcome = "timed out" if seconds >= part.seconds else "unfinished"
        elif not found.get("outcome"):
            lines = [each for each in log.read_text(errors="replace").splitlines() if each.strip()]
            last = lines[-1].replace(str(ROOT), "").strip()[:300] if lines else ""
            reason = f"{how}: {last}"
        record = {
            "part": part.name,
            "size": self.size,
            "outcome": outcome,
            "reason": reason,
            "values": found.get("values", {}),
            "setting": machine(self.command, self.variant),
            "seconds": round(time.time() - start, 1),
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        write_json(self.folder / f"{part.name}.json", record)
        return outcome


def run_parts(
    parts: Sequence[Part],
    run: Run,
    seconds: float,
    again: bool = False,
    after: Callable[[], None] = lambda: None,
) -> None:
    """Measure the parts that are due, in their order, until the time is spent.

    Args:
        seconds: of all parts together.
        again: also those that failed.
        after: is called after each part.
    """
    end = time.time() + seconds
    for part in parts:
        left = end - time.time()
        if not run.is_due(part, again) or left < _LEAST:
            continue
        start = time.time()
        outcome = run.measure(part, left)
        print(f"{part.name}: {outcome}, {time.time() - start:.0f} s", file=sys.stderr, flush=True)
        after()


def _run_process(command: Sequence[str], state: Path, log: Path, end: float) -> str:
    """Run a process, and end it and all that it has started at a time; returns how it ended.

    Args:
        state: file of its values; it gets some seconds to end once this holds an outcome.
        log: file of what it prints.
        end: `time.time()` at which it is ended.
    """
    environment = os.environ | {
        # JAX takes three quarters of the GPU's memory otherwise.
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
        "PYTHONFAULTHANDLER": "1",
        "PYTHONUNBUFFERED": "1",
    }
    with open(log, "ab") as output:
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=environment,
            stdout=output,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
    try:
        while process.poll() is None:
            if read_json(state).get("outcome"):
                end = min(end, time.time() + _TO_END)
            if time.time() > end:
                return "killed"
            time.sleep(_INTERVAL)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    code = process.returncode
    return f"by {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"


def machine(command: str, variant: str) -> dict[str, Any]:
    """Where and with what a part ran, without loading Mitsuba."""
    return {
        "command": command,
        "commit": commit(),
        "device": processor(),
        "accelerator": ", ".join(nvidia("name")) or "none",
        "driver": ", ".join(nvidia("driver_version")) or "none",
        "variant": variant,
        "lumitree": lumitree.__version__,
        **{name: version(name) for name in _PACKAGES},
        "python": platform.python_version(),
    }
