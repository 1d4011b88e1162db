"""`python -m tests.fuzz`: inputs of one or all readers, in child processes."""

import argparse
import importlib.metadata
import platform
import shutil
import sys
import time
from pathlib import Path

# Tests import their packages by themselves.
sys.path.insert(0, str(Path(__file__).parents[1]))

from fuzz.reader import outcome_of
from fuzz.registry import NAMES, reader
from fuzz.runner import Run, run

_LIBRARIES = ("mitsuba", "drjit", "numpy", "safetensors", "pillow", "OpenEXR")


def main() -> int:
    """Exit status 1 if an input has failed."""
    options = _parser().parse_args()
    names = options.reader or NAMES
    if options.number is not None:
        return _one(names[0], options)
    failed = False
    versions = {"python": platform.python_version()}
    versions |= {name: importlib.metadata.version(name) for name in _LIBRARIES}
    until = None if options.minutes is None else time.time() + 60 * options.minutes
    for name in names:
        path = options.output / f"{name}-{options.seed}.json"
        found = Run.open(path, name, options.seed, versions)
        run(reader(name), found, options.count, options.workers, until)
        for failure in found.failures:
            print(f"{name} {failure['number']}: {failure['message']}", file=sys.stderr)
        failed = failed or bool(found.failures)
    return int(failed)


def _one(name: str, options: argparse.Namespace) -> int:
    """Write the files of one input into a folder, read it, and print what comes of it."""
    folder = options.output / f"{name}-{options.seed}-{options.number}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    outcome = outcome_of(reader(name), options.seed, options.number, folder)
    print(f"{folder}: {outcome.kind} {outcome.message}\n{outcome.detail}".rstrip())
    return int(outcome.kind == "failed")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument(
        "--reader", action="append", choices=NAMES, help="may be repeated; default: all"
    )
    parser.add_argument(
        "--count", type=int, default=10_000, help="inputs of each reader (default: 10000)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of all inputs (default: 0)")
    parser.add_argument("--workers", type=int, default=1, help="processes at once (default: 1)")
    parser.add_argument("--minutes", type=float, help="after which no further part is begun")
    parser.add_argument("--number", type=int, help="repeat this input alone, and keep its files")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("fuzz-results"),
        help="folder of the results, from which the next call continues (default: fuzz-results)",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
