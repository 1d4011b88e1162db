"""A part of the benchmark, and what its process knows."""

import dataclasses
import importlib
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
from lumitree.core.backend import GPU_VARIANT
from lumitree.core.files import write_json
from lumitree.errors import LumitreeError

ROOT = Path(__file__).parents[2]
Outcome = Literal["done", "skipped", "unfinished", "failed", "timed out"]


class SkippedError(Exception):
    """A part cannot be measured here; the message is the reason in one line."""


class UnfinishedError(Exception):
    """The time is spent, or something comes first; the next run goes on."""


@dataclasses.dataclass(frozen=True)
class Part:
    """One part.

    Attributes:
        name: of its file, without the suffix.
        title: of its section of the page.
        seconds: after which its process is ended.
        least: seconds that must be left for it to be begun.
        measure: does the work, in a process of its own; returns JSON values.
        parameters: JSON values that the values depend on, beside the sizes and the variant.
    """

    name: str
    title: str
    seconds: float
    least: float
    measure: "Callable[[Context], dict[str, Any]]"
    parameters: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Context:
    """What the process of a part knows.

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
    def benchmarks(self) -> Path:
        """Folder of the results of other benchmarks, whose files have the names of parts."""
        return self.folder / "benchmarks"

    @property
    def seconds_left(self) -> float:
        """Until the process is ended."""
        return self.end - time.time()

    def report(
        self, values: Mapping[str, Any], outcome: Outcome | None = None, reason: str = ""
    ) -> None:
        """Keep values; those of the last call count if the process is ended before it has done."""
        found = {"values": values, "outcome": outcome, "reason": reason}
        write_json(self.state, plain(found))

    def benchmark(
        self, name: str, *arguments: object, variant: str | None = None
    ) -> dict[str, Any]:
        """Run another benchmark in this process, as `python -m benchmarks NAME ARGUMENTS`.

        Args:
            variant: of Mitsuba; by default that of this benchmark.

        Returns:
            `command`, and `tables`: those of its page, if it writes one.

        Raises:
            LumitreeError: it failed.
        """
        common = ["-o", str(self.benchmarks), "--variant", variant or self.variant]
        argv = [name, *map(str, arguments), *common]
        sys.argv = ["benchmarks", *argv]
        try:
            # The list of benchmarks is above this package.
            runpy.run_module("benchmarks", run_name="__main__")
        except SystemExit as ended:
            if ended.code:
                raise LumitreeError(f"the benchmark {name} failed; see its log") from ended
        page = self.benchmarks / f"{name}.md"
        tables = tables_of(page.read_text(encoding="utf-8")) if page.is_file() else []
        return {"command": command_line(argv), "tables": tables}

    def check_jax(self) -> None:
        """Skip a part of the network where it would be trained on the CPU beside a GPU.

        Raises:
            SkippedError: JAX is missing, or Mitsuba uses a GPU and JAX has none.
        """
        try:
            jax = importlib.import_module("jax")
        except ImportError as error:
            raise SkippedError(f"the network needs JAX: {error}") from error
        if self.variant == GPU_VARIANT and jax.default_backend() != "gpu":
            raise SkippedError("JAX has no GPU; pip install 'lumitree[cuda]' brings what it needs")


def tables_of(text: str) -> list[str]:
    """Tables of a page in Markdown."""
    tables, lines = [], []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            lines.append(line)
        elif lines:
            tables.append("\n".join(lines) + "\n")
            lines = []
    return tables


def read_json(path: Path) -> Any:
    """What a file holds; an empty object if there is none."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
