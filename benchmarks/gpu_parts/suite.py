"""Tests of the project on a device, each with a result: also one that hangs or ends the process.

pytest runs in a process of its own, with this module as its plugin, and begins again after the test
that ended it. The file of the environment variable LUMITREE_TEST_REPORTS has a JSON object for each
begin and end of a test; tests whose end it holds are not run again.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lumitree.errors import LumitreeError

if TYPE_CHECKING:
    import pytest

    from benchmarks.gpu_parts.part import Context

VARIABLE = "LUMITREE_TEST_REPORTS"
ROOT = Path(__file__).parents[2]
# Seconds between looks at the reports, and that pytest gets to end by itself.
_INTERVAL, _TO_END = 0.2, 10.0
_FAILED = ("failed", "timed out", "crashed")


def run_tests(context: Context, paths: Sequence[str]) -> dict[str, Any]:
    """Run the tests of folders and files that have no result yet.

    Returns:
        `counts` of the tests by outcome; `failures`, with the name of each and a message; and the
        `seconds` of all tests.

    Raises:
        LumitreeError: pytest ends before its first test.
    """
    reports = context.work / "reports.jsonl"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", __name__]
    command += ["--continue-on-collection-errors", *paths]
    environment = {"LUMITREE_TEST_VARIANT": context.variant, VARIABLE: str(reports)}
    while True:
        before = len(read_lines(reports))
        process = subprocess.Popen(command, cwd=ROOT, env=os.environ | environment)
        try:
            is_finished = _watch(process, reports, before, paths, context)
        finally:
            process.kill()
            process.wait()
        if is_finished:
            return summary(read_lines(reports), paths)


def _watch(
    process: subprocess.Popen[bytes],
    reports: Path,
    before: int,
    paths: Sequence[str],
    context: Context,
) -> bool:
    """Wait until pytest has finished, or a test has ended it or taken too long: then False.

    Args:
        before: number of lines of the reports when it began.
    """
    while True:
        code, lines = process.poll(), read_lines(reports)
        context.report(summary(lines, paths))
        running = None
        for line in lines[before:]:
            if "finished" in line:
                try:
                    process.wait(_TO_END)
                except subprocess.TimeoutExpired:
                    print("pytest hung after its last test", flush=True)
                return True
            running = line if "start" in line else running
            running = None if "end" in line else running
        if code is not None and running is None:
            raise LumitreeError("pytest ended before its first test; see the log of this part")
        if running is not None:
            seconds = time.time() - running["time"]
            result = {"end": running["start"], "seconds": round(seconds, 3)}
            if code is not None:
                how = signal.Signals(-code).name if code < 0 else f"exit status {code}"
                append_line(reports, result | {"outcome": "crashed", "message": how})
                return False
            if seconds > context.sizes.test_seconds:
                message = f"more than {context.sizes.test_seconds:g} s"
                append_line(reports, result | {"outcome": "timed out", "message": message})
                return False
        time.sleep(_INTERVAL)


def summary(lines: list[dict[str, Any]], paths: Sequence[str]) -> dict[str, Any]:
    """Figures of the tests below some folders or in some files; see `run_tests`."""
    # A file that cannot be imported is reported at each begin of pytest.
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


def show(values: dict[str, Any]) -> str:
    """Markdown of a summary."""
    counts = ", ".join(f"{count} {name}" for name, count in values["counts"].items() if count)
    text = f"{counts or 'none'}; {values['seconds']:.0f} s.\n"
    for failure in values["failures"]:
        text += f"\n* {failure['outcome']}: `{failure['test']}`: {failure['message']}"
    return text + "\n"


class Reports:
    """The plugin.

    Args:
        path: of the file of reports.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._result: dict[str, Any] = {}

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        done = {line["end"] for line in read_lines(self._path) if "end" in line}
        items[:] = [item for item in items if item.nodeid not in done]

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            append_line(self._path, _result(report.nodeid, "failed", str(report.longrepr)))

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._result = _result(nodeid, "passed")
        append_line(self._path, {"start": nodeid, "time": time.time()})

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        result = self._result
        result["seconds"] = round(result["seconds"] + report.duration, 3)
        if report.outcome != "passed" and result["outcome"] != "failed":
            crash = getattr(report.longrepr, "reprcrash", None)
            message = crash.message if crash is not None else str(report.longrepr)
            result |= {"outcome": report.outcome, "message": _one_line(message)}

    def pytest_runtest_logfinish(self) -> None:
        append_line(self._path, self._result)

    def pytest_sessionfinish(self, exitstatus: int) -> None:
        append_line(self._path, {"finished": int(exitstatus)})


def _result(nodeid: str, outcome: str, message: str = "") -> dict[str, Any]:
    return {"end": nodeid, "outcome": outcome, "seconds": 0.0, "message": _one_line(message)}


def _one_line(message: str) -> str:
    """The end of a message says most; without the folder of the machine."""
    return " ".join(message.replace(f"{Path.cwd()}/", "").split())[-300:]


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Reports(Path(os.environ[VARIABLE])))


def append_line(path: Path, line: dict[str, Any]) -> None:
    """Add a line to a file of reports."""
    with open(path, "a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Lines of a file of reports, without one that was not written to its end."""
    if not path.is_file():
        return []
    complete = path.read_text(encoding="utf-8").rpartition("\n")[0]
    return [json.loads(text) for text in complete.splitlines()]
