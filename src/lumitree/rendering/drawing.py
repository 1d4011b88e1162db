"""Layout of all figures, and figures of images: grids, strips, luminance; files of them."""

import contextlib
import dataclasses
import io
import os
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter
from numpy.typing import NDArray

from lumitree.core.files import write_bytes
from lumitree.rendering.photograph import Highlights, PhotoSettings

_DPI = 100
# Pixels: margin, gap between images, height of a colour bar with its numbers.
_MARGIN, _GAP, _BAR = 16, 6, 54
# Least width of an image of a strip, and width of a luminance image, pixels.
_STRIP, _LUMINANCE = 480, 900
# Decades of luminance that are shown, and part of the pixels that may be beyond each end of the
# scale: single ones are noise.
_DECADES, _BEYOND = 4, 1e-3
_PAGE = (8.27, 11.69)  # A4, inches


class Sheet(Figure):
    """A figure that becomes a PNG file."""

    def png(self, settings: str = "") -> bytes:
        """The PNG file; the same figure gives the same bytes.

        Args:
            settings: what made the figure, stored as the comment of the file; may be empty.
        """
        stream = io.BytesIO()
        # Not `savefig`: its result depends on the user's matplotlibrc.
        with any_characters():
            FigureCanvasAgg(self).print_png(
                stream, metadata={"Software": None, "Comment": settings or None}
            )
        return stream.getvalue()


@dataclasses.dataclass(frozen=True)
class ColourScale:
    """Colours of numbers.

    Attributes:
        norm: maps numbers to [0, 1].
        colours: name of the colour map.
        label: what the numbers are, with the unit.
    """

    norm: Normalize
    colours: str
    label: str

    def __call__(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Image [H, W, 4] of values [H, W]; NaN is light grey."""
        return colormaps[self.colours].with_extremes(bad="0.75")(self.norm(values))

    def draw_bar(self, figure: Figure, axes: Axes) -> None:
        """Draw a horizontal colour bar; its ends are pointed if values may be beyond them."""
        numbers = LogFormatter(minor_thresholds=(2, 0.5))
        bar = figure.colorbar(
            ScalarMappable(self.norm, self.colours),
            cax=axes,
            orientation="horizontal",
            extend="both" if self.norm.clip else "neither",
            format=numbers if isinstance(self.norm, LogNorm) else None,
        )
        if isinstance(self.norm, LogNorm):
            bar.minorformatter = numbers
        bar.set_label(self.label, fontsize=11)


OPACITY = ColourScale(Normalize(0, 1), "gray", "opacity")


class Panel(NamedTuple):
    """Caption (one or two lines), radiance [H, W, 3] and highlights of an image of a strip."""

    caption: str
    radiance: NDArray[np.floating]
    highlights: Highlights | None = None


class Tile(NamedTuple):
    """Image [H, W, 3 or 4], bytes or floats in [0, 1], and the text below it."""

    image: NDArray[Any]
    caption: str = ""


def image_grid(
    rows: Sequence[Sequence[Tile]],
    width: int,
    *,
    title: str = "",
    subtitle: str = "",
    columns: Sequence[str] = (),
    names: Sequence[str] = (),
    bars: Mapping[int, ColourScale] | None = None,
) -> Sheet:
    """Images of equal shape in rows and columns.

    Title and captions are not interpreted as formulas: names of files may contain "$".

    Args:
        rows: the images; the last row may be shorter.
        width: pixels of each image.
        title, subtitle: lines above the images.
        columns: texts above the columns.
        names: texts on the left of the rows.
        bars: colour scale below a column.
    """
    bars = bars or {}
    shape = rows[0][0].image.shape
    height = round(width * shape[0] / shape[1])
    captions = [tile.caption for row in rows for tile in row if tile.caption]
    # Pixels beside, above, between and below the images, and of the sheet.
    left = _MARGIN + (30 if names else 0)
    top = _MARGIN + (22 if title else 0) + (22 if subtitle else 0) + (30 if columns else 0)
    between = _GAP + max((20 * len(caption.splitlines()) for caption in captions), default=0)
    bottom = _MARGIN + between + (_BAR if bars else 0)
    across = left + len(rows[0]) * (width + _GAP) - _GAP + _MARGIN
    down = top + len(rows) * (height + between) - between + bottom
    sheet = Sheet(figsize=(across / _DPI, down / _DPI), dpi=_DPI)
    literal: dict[str, Any] = {"parse_math": False, "va": "center"}
    sheet.text(_MARGIN / across, 1 - 24 / down, title, fontsize=15, weight="bold", **literal)
    sheet.text(_MARGIN / across, 1 - 50 / down, subtitle, **literal)
    cells = sheet.add_gridspec(
        len(rows),
        len(rows[0]),
        left=left / across,
        right=1 - _MARGIN / across,
        top=1 - top / down,
        bottom=bottom / down,
        wspace=_GAP / width,
        hspace=between / height,
    )
    smooth = "nearest" if shape[1] <= width else "auto"
    for row, tiles in enumerate(rows):
        for column, tile in enumerate(tiles):
            axes = sheet.add_subplot(cells[row, column], xticks=[], yticks=[])
            axes.imshow(tile.image, aspect="auto", interpolation=smooth)
            axes.spines[:].set_visible(False)
            axes.set_xlabel(tile.caption, loc="left", parse_math=False)
            if columns and row == 0:
                axes.set_title(columns[column], loc="left")
            if names and column == 0:
                axes.set_ylabel(names[row])
            if column in bars and row == len(rows) - 1:
                # Shorter than the image, so that the numbers at the ends do not overlap.
                place = (0.06, -(between + 12) / height, 0.88, 12 / height)
                bars[column].draw_bar(sheet, axes.inset_axes(place))
    return sheet


def write_strip(
    path: str | os.PathLike[str],
    images: Sequence[Panel],
    settings: PhotoSettings,
    comment: str = "",
    *,
    columns: int | None = None,
) -> None:
    """Write images [H, W, 3] of linear radiance and equal size side by side as one PNG.

    Args:
        settings: of all photographs, by the first image where they are automatic.
        comment: what made the images, stored in the file; may be empty.
        columns: images in a row. Default: all.
    """
    first = images[0].radiance
    tiles = [
        Tile(settings.photograph(radiance, metered=first, highlights=highlights).pixels, caption)
        for caption, radiance, highlights in images
    ]
    columns = columns or len(tiles)
    rows = [tiles[at : at + columns] for at in range(0, len(tiles), columns)]
    width = max(_STRIP, first.shape[1])
    write_bytes(path, image_grid(rows, width).png(comment))


def luminance_png(luminance: NDArray[np.floating]) -> bytes:
    """PNG file of a luminance [H, W], cd/m², in false colours with a legend.

    The scale is logarithmic. A thousandth of the pixels is brighter than it, and as many are darker
    unless it would then go over more than four decades.
    """
    luminance = np.nan_to_num(luminance, nan=0.0, posinf=0.0, neginf=0.0)
    low, top = np.quantile(luminance, (_BEYOND, 1 - _BEYOND)).tolist()
    top = top or float(luminance.max()) or 1.0
    low = min(max(low, top / 10**_DECADES), top / 2)
    scale = ColourScale(LogNorm(low, top, clip=True), "turbo", "luminance, cd/m²")
    image = scale(np.maximum(luminance, low))
    return image_grid([[Tile(image)]], _LUMINANCE, bars={0: scale}).png()


def text_page(
    title: str, top: float, tables: Sequence[Sequence[Sequence[str]]], notes: Sequence[str]
) -> Figure:
    """An A4 page of tables and notes below them.

    Args:
        title: line at the upper edge.
        top: where the tables begin, 0 to 1 from the lower edge; plots can be added above.
        tables: rows of cells.
        notes: paragraphs in small letters.
    """
    page = Figure(figsize=_PAGE)
    page.text(0.08, 0.955, title, fontsize=15, parse_math=False)
    for table in tables:
        left = 0.08
        for cells in zip(*table, strict=True):
            for row, cell in enumerate(cells):
                page.text(left, top - 0.015 * row, cell, fontsize=8.5)
            left += 0.0085 * (max(map(len, cells)) + 1)
        top -= 0.015 * len(table) + 0.02
    for note in notes:
        lines = textwrap.wrap(note, 118)
        page.text(0.08, top, "\n".join(lines), fontsize=7.5, va="top", color="#57534e")
        top -= 0.006 + 0.012 * len(lines)
    return page


def pdf_file(pages: Sequence[Figure]) -> bytes:
    """A PDF file of pages."""
    stream = io.BytesIO()
    with any_characters(), PdfPages(stream) as file:
        for page in pages:
            file.savefig(page)
    return stream.getvalue()


@contextlib.contextmanager
def any_characters() -> Iterator[None]:
    """Context in which Matplotlib draws a box for a character that its font lacks, silently.

    Names of files and lamps may be Chinese; the font of figures has Latin, Greek and Cyrillic.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)
        yield
