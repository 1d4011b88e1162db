"""Cells: the units of work of the paper's tables, and the files that keep what they measured.

A cell is a pure function of its name, its parameters and the scale. Its result is a file of
`<output>/paper/<scale>/`. A cell whose file has the same parameters is not measured again.
"""

import dataclasses
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.setting import setting
from benchmarks.paper_tables.work import Work, plain
from lumitree.core.files import write_json
from lumitree.core.system import peak_memory_bytes

State = Literal["done", "missing", "outdated"]


@dataclasses.dataclass(frozen=True)
class Measured:
    """What a cell measured.

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
        table: number of the paper's table; 0 for what has none.
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
        """What a cell's file holds, whatever its parameters; None if there is none."""
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
