"""Plugin of pytest that writes the result of each test to a file as soon as it is known.

The file is that of the environment variable LUMITREE_TEST_REPORTS, a JSON object a line. Tests
whose result it holds are not run again. So nothing is lost if the process crashes or hangs.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # Benchmarks can be listed without it.
    import pytest

VARIABLE = "LUMITREE_TEST_REPORTS"


class Reports:
    """The file, and the test that runs."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._results: dict[str, Any] = {}

    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[Any]) -> None:
        done = {line["end"] for line in read_lines(self._path) if "end" in line}
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid in done])
        items[:] = [item for item in items if item.nodeid not in done]
        self._write({"collected": len(items)})

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self._write(_result(report.nodeid, "failed", str(report.longrepr)))

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._results = _result(nodeid, "passed")
        self._write({"start": nodeid, "time": time.time()})

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        result = self._results
        result["seconds"] = round(result["seconds"] + report.duration, 3)
        if report.outcome == "passed" or result["outcome"] == "failed":
            return
        result["outcome"] = report.outcome
        crash = getattr(report.longrepr, "reprcrash", None)
        message = crash.message if crash is not None else str(report.longrepr)
        result["message"] = _one_line(message)

    def pytest_runtest_logfinish(self) -> None:
        self._write(self._results)

    def pytest_sessionfinish(self, exitstatus: int) -> None:
        self._write({"finished": int(exitstatus)})

    def _write(self, line: dict[str, Any]) -> None:
        append_line(self._path, line)


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
    found = []
    for text in path.read_text(encoding="utf-8").splitlines():
        try:
            found.append(json.loads(text))
        except ValueError:
            continue
    return found
