"""Runs of many inputs in child processes, whose deaths are failures of their inputs."""

import collections
import dataclasses
import json
import os
import queue
import re
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from fuzz.reader import Reader
from lumitree.core.files import write_json

_TESTS = Path(__file__).parents[1]
# Seconds without an answer, after which a process that waits rather than computes is ended.
_MAX_WAIT = 120.0
# Failures that are written in full.
_MAX_FAILURES = 200


@dataclasses.dataclass
class Run:
    """What has been found with the inputs of one reader and one seed, kept in a file.

    Attributes:
        path: of the JSON file.
        done: first numbers, and numbers after the last, of parts that are done, in order.
        counts: inputs by kind of outcome.
        refusals: inputs that were refused, by what the message says besides names and numbers.
        failures: number, message and detail of each.
        seconds: of all processes together.
    """

    path: Path
    reader: str
    seed: int
    done: list[list[int]]
    counts: collections.Counter[str]
    refusals: collections.Counter[str]
    failures: list[dict[str, Any]]
    seconds: float
    versions: dict[str, str]

    @staticmethod
    def open(path: Path, reader: str, seed: int, versions: dict[str, str]) -> "Run":
        """The run of a file, or a new one."""
        value = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        return Run(
            path,
            reader,
            seed,
            value.get("done", []),
            collections.Counter(value.get("counts", {})),
            collections.Counter(value.get("refusals", {})),
            value.get("failures", []),
            value.get("seconds", 0.0),
            versions,
        )

    def todo(self, count: int, size: int) -> Iterator[tuple[int, int]]:
        """Parts of the numbers below `count` that are not done, of at most `size` numbers."""
        at = 0
        for start, stop in [*self.done, [count, count]]:
            while at < min(start, count):
                yield at, min(at + size, start, count)
                at = min(at + size, start, count)
            at = max(at, stop)

    def add(self, start: int, stop: int, outcomes: list[dict[str, Any]], seconds: float) -> None:
        """Add a part that is done, and write the file."""
        for outcome in outcomes:
            self.counts[outcome["kind"]] += 1
            if outcome["kind"] == "refused":
                self.refusals[without_values(outcome["message"])] += 1
            elif outcome["kind"] == "failed" and len(self.failures) < _MAX_FAILURES:
                self.failures.append(outcome)
        self.done = _merged([*self.done, [start, stop]])
        self.seconds = round(self.seconds + seconds, 1)
        value = {
            **{"reader": self.reader, "seed": self.seed, "versions": self.versions},
            **{"inputs": sum(self.counts.values()), "seconds": self.seconds, "done": self.done},
            **{"counts": dict(self.counts), "failures": self.failures},
            "refusals": dict(self.refusals.most_common()),
        }
        write_json(self.path, value)


def without_values(message: str) -> str:
    """A message without the names and numbers in it, so that messages of one kind are equal."""
    message = re.sub(r"'[^']*'|\"[^\"]*\"", "''", message)
    message = re.sub(r"[-+]?\b\d[\w.+-]*|\bnan\b|-?\binf\b", "N", message)
    return re.sub(r"N([, ]+(and |x )?N)+", "N, ...", message)[:160]


def run(
    reader: Reader,
    run_: Run,
    count: int,
    workers: int,
    until: float | None = None,
    say: Callable[[str], None] = print,
) -> None:
    """Run all inputs below `count` that are not done.

    Args:
        reader: whose inputs they are.
        run_: to which outcomes are added.
        count: number after the last.
        workers: processes at once.
        until: time of the clock, s, after which no further part is begun.
        say: takes lines about the progress.
    """
    parts: queue.Queue[tuple[int, int]] = queue.Queue()
    for part in run_.todo(count, reader.at_once):
        parts.put(part)
    lock = threading.Lock()

    def work() -> None:
        while until is None or time.time() < until:
            try:
                start, stop = parts.get_nowait()
            except queue.Empty:
                return
            begin = time.perf_counter()
            outcomes = part_of(reader, run_.seed, start, stop, run_.path.parent / "failures")
            with lock:
                run_.add(start, stop, outcomes, time.perf_counter() - begin)
                counts = ", ".join(f"{n} {kind}" for kind, n in sorted(run_.counts.items()))
                say(f"{reader.name}: {counts}; {run_.seconds:.0f} s")

    threads = [threading.Thread(target=work) for _ in range(workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def part_of(reader: Reader, seed: int, start: int, stop: int, kept: Path) -> list[dict[str, Any]]:
    """Outcomes of some inputs; the input at which a process dies has failed, and is left out."""
    outcomes: list[dict[str, Any]] = []
    while start < stop:
        found, reason = _child(reader, seed, start, stop, kept)
        outcomes += found
        start += len(found)
        if start < stop:
            outcomes.append({"number": start, "kind": "failed", **reason})
            start += 1
    return outcomes


def _child(
    reader: Reader, seed: int, start: int, stop: int, kept: Path
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Outcomes of one process, and why it ended."""
    command = [sys.executable, "-m", "fuzz.child", reader.name]
    command += [str(seed), str(start), str(stop), str(kept)]
    paths = [str(_TESTS), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    child = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        env=environment,
        errors="replace",
    )
    assert child.stdout is not None
    assert child.stderr is not None
    errors: list[str] = []
    # Both are read as they come, so that the process never waits for the other one.
    thread = threading.Thread(target=_last_lines, args=(child.stderr, errors))
    thread.start()
    outcomes, waited = [], False
    while True:
        ready, _, _ = select.select([child.stdout], [], [], _MAX_WAIT)
        if not ready:
            waited = True
            child.kill()
            break
        line = child.stdout.readline()
        if not line:
            break
        if line.startswith("{"):
            outcomes.append(json.loads(line))
    status = child.wait()
    thread.join()
    child.stdout.close()
    message = f"waited for more than {_MAX_WAIT:g} s" if waited else f"the process ended: {status}"
    return outcomes, {"message": message, "detail": "".join(errors)[-4000:]}


def _last_lines(stream: Any, lines: list[str]) -> None:
    with stream:
        for line in stream:
            # faulthandler lists all modules after the traceback.
            if not line.startswith("Extension modules:"):
                lines.append(line)
                del lines[:-80]


def _merged(parts: list[list[int]]) -> list[list[int]]:
    result: list[list[int]] = []
    for start, stop in sorted(parts):
        if result and start <= result[-1][1]:
            result[-1][1] = max(result[-1][1], stop)
        else:
            result.append([start, stop])
    return result
