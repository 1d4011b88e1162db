"""Runs parts one after the other, each in a process of its own, until the time is spent.

A process that crashes, hangs, or hangs at its end costs its own part only. Each part leaves a
record in the folder of the results, and its log in the work folder.
"""

import contextlib
import os
import platform
import resource
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
from benchmarks.paper_tables.work import plain
from lumitree.core.files import write_json

# Seconds between looks at a process, between looks at the GPU's memory, that a process gets to end
# once it has done, and to write where it is before it is killed.
_INTERVAL, _MEMORY_INTERVAL, _TO_END, _TO_DUMP = 0.25, 2.0, 10.0, 3.0
# Whose versions are recorded.
_PACKAGES = ("mitsuba", "drjit", "karellen-llvm-core", "jax", "jaxlib", "numpy")
# What is not measured again by itself.
_FINAL: tuple[Outcome, ...] = ("done", "skipped", "failed", "timed out")
# Those that are measured again when asked.
_AGAIN: tuple[Outcome, ...] = ("failed", "timed out")


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

    def path(self, part: Part) -> Path:
        """File of a part's record."""
        return self.folder / f"{part.name}.json"

    def record(self, part: Part) -> dict[str, Any] | None:
        """Record of a part; None if there is none, or one with other parameters."""
        found = read_json(self.path(part))
        return found if found and found["parameters"] == self._parameters(part) else None

    def is_due(self, part: Part, again: bool = False) -> bool:
        """Whether a part has to be measured.

        Args:
            again: also if it failed.
        """
        record = self.record(part)
        if record is None or record["outcome"] not in _FINAL:
            return True
        return again and record["outcome"] in _AGAIN

    def measure(self, part: Part, seconds: float, command: Sequence[str] | None = None) -> Outcome:
        """Run a part in a process of its own for at most so many seconds, and write its record.

        Args:
            command: of the process, to which the file of its job is added.
        """
        start = time.time()
        self.work.mkdir(parents=True, exist_ok=True)
        state, job = (self.work / f"{part.name}.{kind}.json" for kind in ("state", "job"))
        log = self.work / "logs" / f"{part.name}.log"
        log.parent.mkdir(exist_ok=True)
        state.unlink(missing_ok=True)
        described = {"part": part.name, "size": self.size, "variant": self.variant}
        described |= {"work": str(self.work), "folder": str(self.folder), "state": str(state)}
        write_json(job, described | {"end": start + seconds})
        process = command or [sys.executable, "-m", "benchmarks.gpu_parts"]
        ended = run_process([*process, str(job)], state, log, start + seconds)
        found = read_json(state)
        outcome, reason = _outcome(found, ended, seconds < part.seconds, log)
        record = {
            "part": part.name,
            "parameters": self._parameters(part),
            "outcome": outcome,
            "reason": reason,
            "values": found.get("values", {}),
            "setting": machine(self.command, self.variant),
            "seconds": round(time.time() - start, 1),
            **ended["memory"],
            "end_of_process": ended["how"],
        }
        write_json(self.path(part), plain(record))
        for path in (state, job):
            path.unlink(missing_ok=True)
        return outcome

    def _parameters(self, part: Part) -> Any:
        return plain({**part.parameters, "size": self.size, "variant": self.variant})


def run_parts(
    parts: Sequence[Part],
    run: Run,
    seconds: float,
    again: bool = False,
    after: Callable[[], None] = lambda: None,
) -> None:
    """Measure the parts that are due, in their order, until the time is spent.

    A part is begun if enough time is left for it, and ended when the time is spent.

    Args:
        seconds: of all parts together.
        again: also those that failed.
        after: is called after each part.
    """
    end = time.time() + seconds
    for part in parts:
        if not run.is_due(part, again):
            continue
        left = end - time.time()
        if left < min(part.least, part.seconds):
            print(f"{part.name}: {max(left, 0):.0f} s are left, too few", file=sys.stderr)
            continue
        start = time.time()
        outcome = run.measure(part, min(part.seconds, left))
        print(f"{part.name}: {outcome}, {time.time() - start:.0f} s", file=sys.stderr)
        after()


def run_process(command: Sequence[str], state: Path, log: Path, end: float) -> dict[str, Any]:
    """Run a process, and end it and all that it has started at a time.

    Args:
        state: file of its values; it gets some seconds to end once this holds an outcome.
        log: file of what it prints.
        end: `time.time()` at which it is ended.

    Returns:
        `how` it ended: "by itself", "killed at its end", "killed" or how it crashed; and `memory`:
        `peak_memory_bytes` of the process, and `peak_gpu_bytes` in use on the GPUs, by all.
    """
    environment = {
        **os.environ,
        # JAX takes three quarters of a GPU's memory otherwise.
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
    peak, looked, done = 0, 0.0, None
    usage: resource.struct_rusage | None = None
    how = ""
    try:
        while True:
            if (usage := _ended(process)) is not None:
                how = _how(process.returncode)
                break
            now = time.time()
            if now - looked > _MEMORY_INTERVAL:
                looked, peak = now, max(peak, _gpu_bytes())
            if done is None and read_json(state).get("outcome"):
                done = now
            if now > end or (done is not None and now - done > _TO_END):
                how = "killed" if done is None else "killed at its end"
                usage = _stop(process)
                break
            time.sleep(_INTERVAL)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    memory = {
        "peak_memory_bytes": None if usage is None else usage.ru_maxrss * 1024,
        "peak_gpu_bytes": peak,
    }
    return {"how": how, "memory": memory}


def _ended(process: subprocess.Popen[bytes]) -> resource.struct_rusage | None:
    """What a process has used, if it has ended."""
    found, status, usage = os.wait4(process.pid, os.WNOHANG)
    if not found:
        return None
    process.returncode = os.waitstatus_to_exitcode(status)
    return usage


def _stop(process: subprocess.Popen[bytes]) -> resource.struct_rusage | None:
    """End a process; its fault handler writes where each thread is."""
    usage, end = None, time.time() + _TO_DUMP
    os.kill(process.pid, signal.SIGABRT)
    while usage is None and time.time() < end:
        time.sleep(_INTERVAL)
        usage = _ended(process)
    if usage is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    return usage


def _how(code: int) -> str:
    if code == 0:
        return "by itself"
    return f"by {signal.Signals(-code).name}" if code < 0 else f"with exit status {code}"


def _gpu_bytes() -> int:
    """Memory in use on all NVIDIA GPUs."""
    used = [text for text in nvidia("memory.used") if text.strip().isdigit()]
    return sum(map(int, used)) << 20


def _outcome(
    found: dict[str, Any], ended: dict[str, Any], is_cut: bool, log: Path
) -> tuple[Outcome, str]:
    """Outcome of a part, and the reason in one line.

    Args:
        is_cut: whether the process had less time than the part may take.
    """
    if found.get("outcome"):
        return found["outcome"], found["reason"]
    if ended["how"] == "killed":
        return ("unfinished", "") if is_cut else ("timed out", "")
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
    last = lines[-1].replace(str(ROOT), "").strip()[:300] if lines else ""
    return "failed", f"{ended['how']}: {last}"


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
