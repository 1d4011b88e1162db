"""Tests of the project on a device, each with a result: also one that hangs or ends the process.

pytest runs in a process of its own, and begins again after the test that ended it. It may also hang
when its last test has ended.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.gpu_parts.part import ROOT, Context, UnfinishedError
from benchmarks.gpu_parts.report_plugin import VARIABLE, append_line, read_lines
from lumitree.errors import LumitreeError

# Seconds between looks at the reports, that pytest gets to end by itself, and before the process of
# this part is ended.
_INTERVAL, _TO_END, _MARGIN = 0.1, 10.0, 10.0
_FAILED = ("failed", "timed out", "crashed")


def run_tests(context: Context, group: str) -> dict[str, Any]:
    """Run tests that have no result yet.

    Args:
        group: key of `Sizes.tests`.

    Returns:
        Number of the tests by outcome; `failures`, with the name of each and a message; the
        `seconds` of all tests; `ends`, how processes of pytest ended.

    Raises:
        UnfinishedError: the time is spent; the results so far are kept.
        LumitreeError: pytest ends before its first test.
    """
    paths = context.sizes.tests[group]
    reports = context.work / "tests" / "reports.jsonl"
    reports.parent.mkdir(parents=True, exist_ok=True)
    ends: list[str] = []
    while True:
        before = len(read_lines(reports))
        xml = reports.with_name(f"{group}-{time.time_ns()}.xml")
        process = subprocess.Popen(
            _command(paths, xml),
            cwd=ROOT,
            env={**os.environ, "LUMITREE_TEST_VARIANT": context.variant, VARIABLE: str(reports)},
        )
        end = _watch(process, reports, before, context)
        ends.append(end)
        values = summary(read_lines(reports), paths) | {"ends": ends}
        context.report(values)
        if end == "time is spent":
            raise UnfinishedError
        if end.startswith("finished"):
            return values
        if end == "before its first test":
            raise LumitreeError("pytest ended before its first test; see the log of this part")


def _command(paths: Sequence[str], xml: Path) -> list[str]:
    plugins = ["-p", "no:benchmark", "-p", "no:cacheprovider"]
    plugins += ["-p", "benchmarks.gpu_parts.report_plugin"]
    options = [*plugins, f"--junitxml={xml}", "--continue-on-collection-errors"]
    return [sys.executable, "-m", "pytest", "-q", *options, *paths]


def _watch(process: subprocess.Popen[bytes], reports: Path, before: int, context: Context) -> str:
    """Wait for the end of pytest, and end it if a test or its own end takes too long.

    Args:
        before: number of lines of the reports when it began.

    Returns:
        How it ended.
    """
    try:
        while True:
            lines = read_lines(reports)[before:]
            code = process.poll()
            running = _running(lines)
            if any("finished" in line for line in lines):
                return _wait_for_end(process)
            if code is not None:
                if running is None:
                    return "before its first test"
                how = signal.Signals(-code).name if code < 0 else f"exit status {code}"
                _record(reports, running, "crashed", how)
                return f"crashed in {running['start']}"
            if context.seconds_left < _MARGIN:
                return "time is spent"
            limit = context.sizes.test_seconds
            if running is not None and time.time() - running["time"] > limit:
                # pytest's fault handler writes where each thread is.
                process.send_signal(signal.SIGABRT)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(3)
                _record(reports, running, "timed out", f"more than {limit:g} s")
                return f"timed out in {running['start']}"
            time.sleep(_INTERVAL)
    finally:
        process.kill()
        process.wait()


def _wait_for_end(process: subprocess.Popen[bytes]) -> str:
    try:
        code = process.wait(_TO_END)
    except subprocess.TimeoutExpired:
        return f"finished, and then hung for more than {_TO_END:g} s"
    return "finished" if code >= 0 else f"finished, and then {signal.Signals(-code).name}"


def _running(lines: list[dict[str, Any]]) -> dict[str, Any] | None:
    """The test that has started and not ended."""
    for line in reversed(lines):
        if "end" in line:
            return None
        if "start" in line:
            return line
    return None


def _record(reports: Path, running: dict[str, Any], outcome: str, message: str) -> None:
    seconds = round(time.time() - running["time"], 3)
    result = {"end": running["start"], "outcome": outcome, "seconds": seconds, "message": message}
    append_line(reports, result)


def summary(lines: list[dict[str, Any]], paths: Sequence[str]) -> dict[str, Any]:
    """Figures of the tests below some folders or in some files; see `run_tests`."""
    by_test = {line["end"]: line for line in lines if "end" in line}
    results = [each for test, each in by_test.items() if test.startswith(tuple(paths))]
    outcomes = [result["outcome"] for result in results]
    failures = [
        {"test": result["end"], "outcome": result["outcome"], "message": result["message"]}
        for result in results
        if result["outcome"] in _FAILED
    ]
    return {
        "counts": {name: outcomes.count(name) for name in ("passed", "skipped", *_FAILED)},
        "failures": failures,
        "seconds": round(sum(result["seconds"] for result in results), 1),
    }
