"""Tables for the terminal and for Markdown files."""

import dataclasses
from collections.abc import Sequence


@dataclasses.dataclass(frozen=True)
class Table:
    """Cells as text, under heads.

    Attributes:
        heads: one for each column.
        rows: cells, as many in each row as there are heads.
        left: number of columns, from the first, that are aligned left; the others are aligned
            right.

    Raises:
        ValueError: a row has another number of cells than there are heads.
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: int = 1

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.heads):
                raise ValueError(f"{len(row)} cells under {len(self.heads)} heads: {row}")

    def markdown(self) -> str:
        """The table in Markdown, with a newline at its end."""
        rule = "|---" * self.left + "|---:" * (len(self.heads) - self.left) + "|"
        lines = ["| " + " | ".join(row) + " |" for row in (self.heads, *self.rows)]
        return "\n".join([lines[0], rule, *lines[1:]]) + "\n"

    def text(self) -> str:
        """The table with aligned columns, two spaces apart, and a newline at its end."""
        rows = [list(self.heads), *map(list, self.rows)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = []
        for row in rows:
            cells = (
                cell.ljust(width) if index < self.left else cell.rjust(width)
                for index, (cell, width) in enumerate(zip(row, widths, strict=True))
            )
            lines.append("  ".join(cells).rstrip())
        return "\n".join(lines) + "\n"
