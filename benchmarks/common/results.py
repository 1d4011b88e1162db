"""Result files of a benchmark: figures as JSON, tables as Markdown."""

import argparse
import json
import time
from pathlib import Path
from typing import Any

from benchmarks.common.setting import setting
from lumitree.core.files import write_bytes, write_json

RESULTS = Path(__file__).parents[1] / "results"


class Results:
    """The files NAME.json and NAME.md of one run.

    Attributes:
        folder: of the files; made when it is missing.
        json_path: the JSON file.
    """

    def __init__(self, options: argparse.Namespace, **details: object) -> None:
        """Begin a run; its seconds count from here.

        Args:
            options: with `benchmark` (the name), `output` (the folder) and `command`.
            details: of the setting, JSON values by name.
        """
        self.folder = Path(options.output)
        self.json_path = self.folder / f"{options.benchmark}.json"
        self._setting = setting(options.command, **details)
        self._start = time.perf_counter()

    def setting(self) -> dict[str, Any]:
        """Where and with what the benchmark runs, and the `seconds` it has taken so far."""
        return {**self._setting, "seconds": round(time.perf_counter() - self._start, 3)}

    def stored(self, default: Any) -> Any:
        """Content of the JSON file, or `default` where there is none."""
        if not self.json_path.is_file():
            return default
        return json.loads(self.json_path.read_text(encoding="utf-8"))

    def write(self, report: Any, markdown: str | None = None) -> None:
        """Write both files under temporary names and rename them.

        Args:
            report: JSON values.
            markdown: text of NAME.md; None writes no such file.
        """
        write_json(self.json_path, report)
        if markdown is not None:
            write_bytes(self.json_path.with_suffix(".md"), markdown.encode())


def notes(facts: dict[str, Any]) -> str:
    """Markdown list of the facts, a line each."""
    return "".join(f"* {name}: {value}\n" for name, value in facts.items())
