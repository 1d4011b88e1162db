"""One process of the runner: reads inputs one after the other, and prints a line of JSON for each.

A process that takes more than 5 s of CPU time for one input is ended by the system, and one that
reserves more memory than its reader may gets a `MemoryError`.
"""

import contextlib
import faulthandler
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
from pathlib import Path
from typing import IO

from fuzz.reader import Reader, outcome_of
from fuzz.registry import reader

# CPU time of all threads for one input; and for one that is rendered or baked, whose kernels have
# to be compiled.
_SECONDS, _SECONDS_IN_FULL = 5.0, 60.0
_PAGE = resource.getpagesize()
# Failures whose inputs are kept, per process.
_MAX_KEPT = 20


def main() -> None:
    """Arguments: name of the reader, seed, first number, number after the last, folder to keep."""
    name, seed, start, stop, kept = sys.argv[1:]
    # Libraries print too.
    results = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    found = reader(name)
    with tempfile.TemporaryDirectory(dir=_memory_disk()) as folder:
        faulthandler.enable()
        faulthandler.register(signal.SIGPROF, chain=True)
        # Imports, and whatever else happens once, do not count.
        _more_time()
        outcome_of(found, int(seed), int(start), Path(folder))
        _limit(found)
        _run(found, int(seed), range(int(start), int(stop)), Path(folder), Path(kept), results)


def _run(
    found: Reader, seed: int, numbers: range, folder: Path, kept: Path, results: IO[str]
) -> None:
    failures = 0
    for number in numbers:
        _empty(folder)
        signal.setitimer(signal.ITIMER_PROF, _SECONDS)
        outcome = outcome_of(found, seed, number, folder, _more_time)
        signal.setitimer(signal.ITIMER_PROF, 0)
        if outcome.kind == "failed" and failures < _MAX_KEPT:
            failures += 1
            with contextlib.suppress(OSError):
                shutil.copytree(folder, kept / f"{found.name}-{seed}-{number}", dirs_exist_ok=True)
        message = outcome.message.replace(str(folder), "FOLDER")
        line = {"number": number, "kind": outcome.kind, "message": message}
        print(
            json.dumps(line | ({"detail": outcome.detail} if outcome.detail else {})),
            file=results,
            flush=True,
        )


def _more_time() -> None:
    signal.setitimer(signal.ITIMER_PROF, _SECONDS_IN_FULL)


def _limit(found: Reader) -> None:
    """Limit the address space to what it is now and what the reader may take."""
    with open("/proc/self/statm", encoding="ascii") as file:
        used = int(file.read().split()[0]) * _PAGE
    resource.setrlimit(resource.RLIMIT_AS, (used + found.memory,) * 2)


def _memory_disk() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def _empty(folder: Path) -> None:
    for each in folder.iterdir():
        if each.is_dir():
            shutil.rmtree(each)
        else:
            each.unlink()


if __name__ == "__main__":
    main()
