"""A part of the benchmark, what its process knows, and how its record is shown."""

import dataclasses
import json
import runpy
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from benchmarks.common.setting import command_line
from benchmarks.gpu_parts.sizes import Sizes
from benchmarks.paper_tables.work import plain
from lumitree.core.files import write_json
from lumitree.errors import LumitreeError

ROOT = Path(__file__).parents[2]
Outcome = Literal["done", "skipped", "unfinished", "failed", "timed out"]


class SkippedError(Exception):
    """A part cannot be measured here; the message is the reason in one line."""


@dataclasses.dataclass(frozen=True)
class Context:
    """The setting of the process of a part.

    Attributes:
        sizes: how large everything is.
        variant: of Mitsuba.
        work: folder of intermediate data, which parts share.
        folder: of the results.
        state: file of the values so far.
        end: `time.time()` at which the process is ended.
    """

    sizes: Sizes
    variant: str
    work: Path
    folder: Path
    state: Path
    end: float

    @property
    def seconds_left(self) -> float:
        """Until the process is ended."""
        return self.end - time.time()

    def report(
        self, values: Mapping[str, Any], outcome: Outcome | None = None, reason: str = ""
    ) -> None:
        """Keep values; the last ones count if the process is ended before the part is done."""
        write_json(self.state, plain({"values": values, "outcome": outcome, "reason": reason}))

    def benchmark(self, name: str, *arguments: object) -> dict[str, Any]:
        """Run another benchmark in this process, as `python -m benchmarks NAME ARGUMENTS`.

        Returns:
            `command`, and `tables` of its page.

        Raises:
            LumitreeError: it failed.
        """
        folder = self.folder / "benchmarks"
        argv = [name, *map(str, arguments), "-o", str(folder), "--variant", self.variant]
        sys.argv = ["benchmarks", *argv]
        try:
            # The list of benchmarks is above this package.
            runpy.run_module("benchmarks", run_name="__main__")
        except SystemExit as ended:
            if ended.code:
                raise LumitreeError(f"the benchmark {name} failed; see its log") from ended
        lines = (folder / f"{name}.md").read_text(encoding="utf-8").splitlines()
        table = [line for line in lines if line.startswith("|") or not line]
        return {"command": command_line(argv), "tables": "\n".join(table).strip()}


@dataclasses.dataclass(frozen=True)
class Part:
    """One part.

    Attributes:
        name: of its file, without the suffix.
        title: of its section of the page.
        seconds: after which its process is ended.
        measure: does the work, in a process of its own; returns JSON values.
        show: Markdown of these values.
    """

    name: str
    title: str
    seconds: float
    measure: Callable[[Context], dict[str, Any]]
    show: Callable[[dict[str, Any]], str]


def read_json(path: Path) -> Any:
    """Content of a file; an empty object if there is none."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def show_tables(values: dict[str, Any]) -> str:
    """The values of `Context.benchmark`."""
    return f"`{values['command']}`\n\n{values['tables']}\n"
