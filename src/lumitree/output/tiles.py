"""Sheets of square tiles with labels, laid out in pixels and written as PNG."""

import dataclasses
import io
import os
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lumitree.core.arguments import check_sheet_output
from lumitree.core.files import write_bytes
from lumitree.core.text import any_characters

_DPI = 100
_BAR_HEIGHT = 12
# Bars are shorter than their tile, so that the numbers at their ends do not overlap.
_BAR_INSET = 20


@dataclasses.dataclass(frozen=True)
class Style:
    """Colours of the background, of the text, and of less important text."""

    background: str
    text: str
    secondary: str


LIGHT = Style(background="white", text="#1a1a1a", secondary="#808080")
DARK = Style(background="#242424", text="#ececec", secondary="#a0a0a0")


@dataclasses.dataclass(frozen=True)
class Layout:
    """Sizes in pixels; every tile is a square.

    Attributes:
        columns, rows: numbers of columns and rows of tiles.
        tile: side of a tile.
        title: height of the space above the headings of the columns.
        caption: height of the space below each tile.
        footer: height of the space below the last row.
        side: width of the space for the names of the rows.
        heading: height of the headings of the columns.
        margin: width of the margin on each side.
        gap: horizontal distance between tiles.
    """

    columns: int
    rows: int
    tile: int
    title: int = 38
    caption: int = 30
    footer: int = 0
    side: int = 0
    heading: int = 26
    margin: int = 16
    gap: int = 6

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the sheet."""
        width = self.side + self.columns * self.tile + (self.columns - 1) * self.gap
        height = self.title + self.heading + self.rows * (self.tile + self.caption) + self.footer
        return width + 2 * self.margin, height + 2 * self.margin

    def left(self, column: int) -> int:
        """Left edge of a column."""
        return self.margin + self.side + column * (self.tile + self.gap)

    def top(self, row: int) -> int:
        """Upper edge of the tiles of a row; for row `rows`, that of the footer."""
        return self.margin + self.title + self.heading + row * (self.tile + self.caption)


class TileSheet:
    """A sheet to which texts and images are added.

    Texts are not interpreted as formulas. Positions are pixels from the top left corner.
    """

    def __init__(self, layout: Layout, style: Style = LIGHT) -> None:
        self.layout, self._style = layout, style
        width, height = layout.size
        self._figure = Figure(
            figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor=style.background
        )

    def title(self, text: str, subtitle: str = "") -> None:
        """Add a bold line of text at the top, and one in a secondary colour below it."""
        left, top = self.layout.margin, self.layout.margin
        self._text(left, top + 8, text, fontsize=15, weight="bold")
        if subtitle:
            self._text(left, top + 34, subtitle, color=self._style.secondary)

    def heading(self, column: int, text: str) -> None:
        """Add the name of a column."""
        self._text(self.layout.left(column), self.layout.top(0) - 15, text, fontsize=12)

    def row_name(self, row: int, text: str) -> None:
        """Add the name of a row, rotated by 90 degrees, at its left."""
        middle = self.layout.top(row) + self.layout.tile / 2
        centre = self.layout.margin + self.layout.side / 2 - 4
        self._text(centre, middle, text, fontsize=12, rotation=90, ha="center")

    def caption(self, row: int, column: int, text: str) -> None:
        """Add a line of text below a tile."""
        middle = self.layout.top(row) + self.layout.tile + self.layout.caption / 2 - 2
        self._text(self.layout.left(column), middle, text)

    def image(self, row: int, column: int, pixels: NDArray) -> None:
        """Add an image [H, W, 3] (bytes, or floats in [0, 1]), centred in a black tile."""
        tile = self.layout.tile
        box = self._box(self.layout.left(column), self.layout.top(row), tile, tile)
        axes = self._figure.add_axes(box, facecolor="black")
        axes.imshow(pixels, interpolation="auto", aspect="equal")
        height, width = pixels.shape[:2]
        side = max(height, width)
        axes.set_xlim(width / 2 - side / 2 - 0.5, width / 2 + side / 2 - 0.5)
        axes.set_ylim(height / 2 + side / 2 - 0.5, height / 2 - side / 2 - 0.5)
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)

    def colour_bar(self, column: int, colours: Colormap, norm: Normalize, label: str) -> None:
        """Add a horizontal colour bar to the footer, below a column."""
        left, width = self.layout.left(column) + _BAR_INSET, self.layout.tile - 2 * _BAR_INSET
        top = self.layout.top(self.layout.rows) + 2
        axes = self._figure.add_axes(self._box(left, top, width, _BAR_HEIGHT))
        mappable = ScalarMappable(norm, colours)
        bar = self._figure.colorbar(mappable, cax=axes, orientation="horizontal")
        bar.set_label(label, fontsize=11, color=self._style.text, labelpad=2)
        bar.ax.minorticks_off()
        bar.ax.tick_params(labelsize=10, colors=self._style.text, length=3)
        bar.outline.set(linewidth=0.6, edgecolor=self._style.secondary)

    @property
    def texts(self) -> list[str]:
        """All texts on the sheet, without those of the colour bars."""
        return [text.get_text() for text in self._figure.texts]

    @any_characters()
    def png(self, settings: str = "") -> bytes:
        """The sheet as a PNG file; the same sheet gives the same bytes.

        Args:
            settings: what made the sheet, stored as the comment of the file; may be empty.
        """
        stream = io.BytesIO()
        # Not `savefig`: its result depends on the user's matplotlibrc.
        FigureCanvasAgg(self._figure).print_png(
            stream, metadata={"Software": None, "Comment": settings or None}
        )
        return stream.getvalue()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the PNG, atomically."""
        check_sheet_output(path)
        write_bytes(path, self.png())

    def _text(self, left: float, middle: float, text: str, **style: Any) -> None:
        x, y, _, _ = self._box(left, middle, 0, 0)
        style = {"fontsize": 11, "color": self._style.text, "va": "center", **style}
        # File names may contain '$', which would start a formula.
        self._figure.text(x, y, text, parse_math=False, **style)

    def _box(
        self, left: float, top: float, width: float, height: float
    ) -> tuple[float, float, float, float]:
        """Left, bottom, width and height of a rectangle as matplotlib's fractions of the sheet."""
        full_width, full_height = self.layout.size
        return (
            left / full_width,
            1 - (top + height) / full_height,
            width / full_width,
            height / full_height,
        )


def grey(opacity: NDArray[np.floating]) -> NDArray[np.float64]:
    """Image [H, W, 3] of an opacity [H, W]: 0 is black and 1 white."""
    return np.repeat(np.clip(np.asarray(opacity, np.float64), 0, 1)[..., None], 3, axis=-1)
