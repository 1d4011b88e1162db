"""What has been measured at one scale, and how the page writes it."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.common.tables import Table
from benchmarks.paper_tables.cells import Store
from benchmarks.paper_tables.scales import Scale


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
        """What stands in place of a value that has not been measured."""
        return "not measured on GPU" if self.scale.name in ("gpu", "paper") else "not measured yet"

    def values(self, cell: str) -> dict[str, Any]:
        """Values of a cell; empty if it has not been measured."""
        record = self.record(cell)
        return {} if record is None else record["values"]

    def record(self, cell: str) -> dict[str, Any] | None:
        """What a cell's file holds; None if it has not been measured."""
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
