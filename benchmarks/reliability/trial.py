"""Commands that are killed at some moment and continued, and what must hold at each."""

import contextlib
import dataclasses
import fnmatch
import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.reliability.comparison import equal, is_complete
from benchmarks.reliability.jobs import INPUTS, PREPARATIONS, PROGRAM, Job
from lumitree.core.files import SCRATCH, TEMPORARY
from lumitree.errors import LumitreeError

# Names of temporary files and folders, of lumitree and of Orbax.
_TEMPORARY_PARTS = (TEMPORARY, SCRATCH, "orbax-checkpoint-tmp")
# Assets have the name of the folder of their luminaire, so all commands run in folders of one name.
PLACE = "lamps"
# Interval at which a folder is looked at, and the longest time after which a process is killed that
# is writing, s.
_LOOK_SECONDS, _WRITE_SECONDS = 0.002, 0.02
# What files state of the time in which they were written is the same for all commands.
_DATE = {"SOURCE_DATE_EPOCH": "1767225600"}
# Of a command; long, since other programs may run.
_MOST_SECONDS = 600


@dataclasses.dataclass(frozen=True)
class Reference:
    """A command that was not killed.

    Attributes:
        folder: where it ran.
        seconds: its time.
        writes: number of temporary files and folders that were seen.
        first_write: when the first was seen, s.
        agreement: by file, how a second run agrees with it ("bytes" or "values").
    """

    folder: Path
    seconds: float
    writes: int
    first_write: float
    agreement: dict[str, str]


class Watched:
    """A running command, and the temporary files that it makes."""

    def __init__(self, job: Job, folder: Path, command: tuple[str, ...] | None = None) -> None:
        (folder / "tmp").mkdir(exist_ok=True)
        resumes = job.resume if job.resume and (folder / job.command[-1]).exists() else ()
        whole = (*job.program, *job.command, *resumes) if command is None else command
        self._folder, self._start = folder, time.monotonic()
        self._end: float | None = None
        self._errors = folder / "stderr.txt"
        with open(self._errors, "wb") as errors:
            self._process = subprocess.Popen(
                whole, cwd=folder, stdout=subprocess.DEVNULL, stderr=errors,
                env=os.environ | {"TMPDIR": str(folder / "tmp"), "LUMITREE_DEBUG": "1"} | _DATE,
            )  # fmt: skip
        self._seen: set[str] = set(_temporary(folder))
        self.writes: list[float] = []

    @property
    def seconds(self) -> float:
        """From the start to the end, or so far."""
        return (time.monotonic() if self._end is None else self._end) - self._start

    def run(self, until: float = _MOST_SECONDS, writes: int | None = None) -> bool:
        """Let it run; returns whether it is still running then.

        Args:
            until: seconds after its start.
            writes: number of temporary files after which this returns earlier.
        """
        while self._process.poll() is None:
            new = set(_temporary(self._folder)) - self._seen
            self._seen |= new
            self.writes += [self.seconds] * len(new)
            if self.seconds >= until or (writes is not None and len(self.writes) >= writes):
                return True
            time.sleep(_LOOK_SECONDS)
        if self._end is None:
            self._end = time.monotonic()
        return False

    def kill(self) -> bool:
        """End it by SIGKILL; returns whether it was still running."""
        self._process.kill()
        self._process.wait()
        self._end = time.monotonic()
        return self._process.returncode == -signal.SIGKILL

    def finish(self) -> str:
        """Wait for its end; returns what it printed to standard error.

        Raises:
            LumitreeError: it failed, or took too long.
        """
        if self.run():
            self.kill()
            raise LumitreeError(f"a command took more than {_MOST_SECONDS} s")
        text = self.errors
        if self._process.returncode:
            raise LumitreeError(f"a command ended with {self._process.returncode}: {text[-2000:]}")
        return text

    @property
    def errors(self) -> str:
        """What it has printed to standard error."""
        return self._errors.read_text(encoding="utf-8", errors="replace")


def _temporary(folder: Path) -> Iterator[str]:
    """Temporary files and folders of the output and of the folder for temporary files."""
    for root in ("out", "tmp"):
        for place, folders, files in os.walk(folder / root):
            for name in (*folders, *files):
                if any(part in name for part in _TEMPORARY_PARTS):
                    yield f"{place}/{name}"
            folders[:] = [name for name in folders if not any(p in name for p in _TEMPORARY_PARTS)]


def prepare(folder: Path) -> None:
    """Make the inputs of all jobs in a folder of the name `PLACE`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in INPUTS.items():
        (folder / name).write_text(text)
    for command in PREPARATIONS:
        subprocess.run((*PROGRAM, *command), cwd=folder, check=True, capture_output=True)


def measure(job: Job, inputs: Path, folder: Path) -> Reference:
    """Run a command twice without a kill: its files, and how well they repeat."""
    runs = []
    for number in range(2):
        place = folder / str(number) / PLACE
        shutil.copytree(inputs, place)
        command = Watched(job, place)
        command.finish()
        runs.append((place, command.seconds, command.writes))
        _run_after(job, place)
    (first, _, _), (second, seconds, writes) = runs
    agreement = {}
    for name in _files(first / "out"):
        if not _matches(name, job.varying):
            found = equal(first / "out" / name, second / "out" / name)
            if found is None:
                raise LumitreeError(f"{job.name}: {name} differs between equal commands")
            agreement[name] = found
    return Reference(second, seconds, len(writes), min(writes, default=seconds / 2), agreement)


def run_trial(
    job: Job, reference: Reference, inputs: Path, folder: Path, seed: str, kills: int
) -> dict[str, Any]:
    """Kill a command several times, let it finish, and check it at each stage.

    Args:
        folder: where it runs, of the name `PLACE`.
        seed: of the moments.
        kills: number of kills; fewer if the command ends before.

    Returns:
        Kills (`mode`, `seconds` after the start, `left` temporary files), the `seconds` of all
        processes, and the `faults`: one line each.
    """
    choice, trial = random.Random(seed), Trial(job, reference, inputs, folder)
    shutil.copytree(inputs, folder)
    report: list[dict[str, Any]] = []
    running, seconds = Watched(job, folder), 0.0
    for _ in range(kills):
        in_write = reference.writes > 0 and choice.random() < 0.6
        if in_write:
            running.run(writes=choice.randint(1, reference.writes))
            time.sleep(choice.uniform(0, _WRITE_SECONDS) if choice.random() < 0.5 else 0)
        else:
            first = 0.5 * reference.first_write
            running.run(until=choice.uniform(first, reference.seconds))
        if not running.kill():
            break
        seconds += running.seconds
        mode = "in a write" if in_write else "at a moment"
        left = len(list(_temporary(folder)))
        report.append({"mode": mode, "seconds": round(running.seconds, 3), "left": left})
        trial.check_killed(running.errors)
        running = Watched(job, folder)
    trial.check_finished(running)
    seconds += running.seconds
    return {"kills": report, "seconds": round(seconds, 3), "faults": trial.faults}


class Trial:
    """Checks of one trial.

    Attributes:
        faults: what was wrong, a line each.
    """

    def __init__(self, job: Job, reference: Reference, inputs: Path, folder: Path) -> None:
        self._job, self._reference, self._inputs = job, reference, inputs
        self._folder, self._out = folder, folder / "out"
        self.faults: list[str] = []
        self._done, self._kept = 0, dict[str, int]()

    def check_killed(self, errors: str) -> None:
        """What must hold once a process was killed."""
        self._check_errors(errors)
        for name in _files(self._out):
            if not _is_temporary(name) and not _matches(name, self._job.state):
                self._check_file(name)
        self._check_progress()

    def check_finished(self, running: Watched) -> None:
        """What must hold once the command has ended."""
        try:
            self._check_errors(running.finish())
            _run_after(self._job, self._folder)
        except LumitreeError as error:
            self.faults.append(str(error))
            return
        found, expected = (set(_files(each / "out")) for each in self._folders)
        # Names of checkpoints depend on the machine's speed.
        sets = [
            {name for name in names if not _matches(name, self._job.state)}
            for names in (found, expected)
        ]
        if sets[0] != sets[1]:
            self.faults.append(f"other files at the end: {sorted(sets[0] ^ sets[1])}")
        for name in sorted(sets[0] & sets[1]):
            self._check_file(name)
        if left := os.listdir(self._folder / "tmp"):
            self.faults.append(f"temporary files stay: {left}")
        if list(_temporary(self._folder)):
            self.faults.append(f"temporary files stay: {list(_temporary(self._folder))}")
        for path in self._inputs.rglob("*"):
            if path.is_file() and path.read_bytes() != self._other(path).read_bytes():
                self.faults.append(f"the input {path.name} was changed")
        self._check_kept()

    @property
    def _folders(self) -> tuple[Path, Path]:
        return self._folder, self._reference.folder

    def _other(self, path: Path) -> Path:
        return self._folder / path.relative_to(self._inputs)

    def _check_errors(self, errors: str) -> None:
        if "Traceback" in errors or "error:" in errors:
            self.faults.append(f"printed: {errors[-2000:]}")

    def _check_file(self, name: str) -> None:
        path = self._out / name
        if _matches(name, self._job.varying):
            if not is_complete(path):
                self.faults.append(f"{name} is not complete")
            return
        expected = self._reference.agreement.get(name)
        if expected is None:
            self.faults.append(f"{name} is not a file of the output")
            return
        found = equal(path, self._reference.folder / "out" / name)
        if found is None or (expected == "bytes" and found != "bytes"):
            self.faults.append(f"{name} differs from that of an uninterrupted command")

    def _check_progress(self) -> None:
        done = self._job.done(self._out)
        if done < self._done:
            self.faults.append(f"{self._done} were done, and then {done}")
        self._done = done
        self._check_kept()

    def _check_kept(self) -> None:
        """Files that were there must be the same ones."""
        now = {
            name: (self._out / name).stat().st_ino
            for name in _files(self._out)
            if _matches(name, self._job.kept) and not _is_temporary(name)
        }
        again = [name for name, inode in self._kept.items() if now.get(name) != inode]
        if again:
            self.faults.append(f"written again: {again}")
        self._kept = now


def _run_after(job: Job, folder: Path) -> None:
    if job.after:
        Watched(job, folder, (*PROGRAM, *job.after)).finish()


def _files(folder: Path) -> list[str]:
    """Names of all files below a folder."""
    with contextlib.suppress(FileNotFoundError):
        paths = [path for path in folder.rglob("*") if path.is_file()]
        return sorted(str(path.relative_to(folder)) for path in paths)
    return []


def _is_temporary(name: str) -> bool:
    return any(part in name for part in _TEMPORARY_PARTS)


def _matches(name: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)
