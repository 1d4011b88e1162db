"""Cells: the units of work of the paper's tables, and the files that keep what they measured.

A cell is a pure function of its name, its parameters and the scale. Its result is a file of
`<output>/paper/<scale>/`. A cell whose file has the same parameters is not measured again.
"""

import dataclasses
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.setting import setting
from benchmarks.common.tables import Table
from benchmarks.paper_tables.scales import Scale
from benchmarks.paper_tables.work import Work, plain
from lumitree.core.files import write_json
from lumitree.core.results import peak_memory_bytes

State = Literal["done", "missing", "outdated"]


@dataclasses.dataclass(frozen=True)
class Measured:
    """Results of a cell.

    Attributes:
        values: JSON values by name.
        images: bytes [H, W, 3] by name, for the page.
    """

    values: dict[str, Any]
    images: Mapping[str, NDArray[np.uint8]] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Cell:
    """One cell.

    Attributes:
        name: of its file, without the suffix.
        table: number of the paper's table.
        parameters: JSON values; everything that the values depend on.
        minutes: estimate on an idle machine, if nothing is cached.
        measure: does the work.
    """

    name: str
    table: int
    parameters: Mapping[str, Any]
    minutes: float
    measure: "Callable[[Work], Measured]"


class Store:
    """The files of one scale's cells.

    Args:
        results: folder of the benchmarks' results.
        images: folder of the page's images.
        scale: name of the scale.
    """

    def __init__(self, results: Path, images: Path, scale: str) -> None:
        self.folder, self.images, self._scale = results / "paper" / scale, images, scale

    def path(self, name: str) -> Path:
        """File of a cell."""
        return self.folder / f"{name}.json"

    def record(self, name: str) -> dict[str, Any] | None:
        """Content of a cell's file, whatever its parameters; None if there is none."""
        path = self.path(name)
        return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None

    def state(self, cell: Cell) -> State:
        """Whether a cell has to be measured; "outdated": with other parameters than its file's."""
        record = self.record(cell.name)
        if record is None:
            return "missing"
        return "done" if record["parameters"] == plain(cell.parameters) else "outdated"

    def image(self, cell: str, name: str) -> Path:
        """File of one of a cell's images."""
        return self.images / f"{self._scale}-{cell}-{name}.jpg"

    def measure(self, cell: Cell, work: "Work", command: str) -> None:
        """Run a cell and write its files, the record last."""
        from benchmarks.paper_tables.pictures import write_jpeg

        start = time.perf_counter()
        measured = cell.measure(work)
        for name, pixels in measured.images.items():
            write_jpeg(self.image(cell.name, name), pixels)
        seconds = round(time.perf_counter() - start, 1)
        self.folder.mkdir(parents=True, exist_ok=True)
        record = {
            "cell": cell.name,
            "table": cell.table,
            "parameters": plain(cell.parameters),
            "values": measured.values,
            "images": sorted(measured.images),
            "setting": setting(command, accelerator=accelerator(), scale=self._scale),
            "seconds": seconds,
            "peak_memory_bytes": peak_memory_bytes(),
        }
        write_json(self.path(cell.name), plain(record))


def accelerator() -> str:
    """The GPU that JAX uses, or "none"."""
    import jax

    device = jax.devices()[0]
    return "none" if device.platform == "cpu" else device.device_kind


class Found:
    """Values of the cells of a scale.

    Args:
        store: of the scale.
        scale: its sizes.
        page: file of the page, from which links to images are relative.
    """

    def __init__(self, store: Store, scale: Scale, page: Path) -> None:
        self.scale, self._store, self._page = scale, store, page

    @property
    def missing(self) -> str:
        """Stands in place of a value that has not been measured."""
        return "not measured on GPU" if self.scale.name in ("gpu", "paper") else "not measured yet"

    def values(self, cell: str) -> dict[str, Any]:
        """Values of a cell; empty if it has not been measured."""
        record = self.record(cell)
        return {} if record is None else record["values"]

    def record(self, cell: str) -> dict[str, Any] | None:
        """Content of a cell's file; None if it has not been measured."""
        return self._store.record(cell)

    def has(self, *cells: str) -> bool:
        """Whether any of the cells has been measured."""
        return any(self.record(cell) is not None for cell in cells)

    def records(self, table: int) -> list[dict[str, Any]]:
        """All records of a table, by name."""
        found = []
        for path in sorted(self._store.folder.glob("*.json")):
            record = self.record(path.stem)
            if record is not None and record["table"] == table:
                found.append(record)
        return found

    def number(self, value: float | None, digits: int) -> str:
        """A number, or `missing`."""
        return self.missing if value is None else f"{value:.{digits}f}"

    def table(self, heads: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
        """A Markdown table; empty where all rows are."""
        return Table(heads, rows, left).markdown()

    def image(self, cell: str, name: str, title: str) -> str:
        """Markdown of an image of a cell; empty if there is none."""
        path = self._store.image(cell, name)
        if not path.is_file():
            return ""
        return f"{title}:\n\n![{title}]({os.path.relpath(path, self._page.parent)})\n\n"

    def image_path(self, name: str) -> Path:
        """File of an image that the page itself draws."""
        return self._store.image("page", name)
