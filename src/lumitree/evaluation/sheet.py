"""Contact sheet: baked views beside their references, for the eye (decision D9)."""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lumitree.core.files import atomic_path
from lumitree.core.images import auto_exposure, tonemap
from lumitree.errors import LumitreeError

MAX_ROWS = 6
COLUMNS = ("Reference", "Baked", "Error", "Reference opacity", "Baked opacity")
# Smallest relative error that the colours resolve; below it is black.
MIN_ERROR = 1e-4

# Layout, pixels.
_CELL = 320
_GAP = 6
_MARGIN = 16
_TITLE = 38
_HEADER = 26
_CAPTION = 30
_BARS = 54
_BAR_HEIGHT = 12
# Bars are shorter than their cell, so that the numbers at their ends do not meet.
_BAR_INSET = 20
_DPI = 100

_INK, _FAINT = "#1a1a1a", "#808080"


@dataclasses.dataclass(frozen=True)
class SheetRow:
    """One view of a sheet.

    Attributes:
        name: what the view is called, e.g. "view 100001".
        reference: [H, W, 3] radiance of the luminaire.
        baked: [H, W, 3] radiance of the asset, same unit.
        reference_opacity: [H, W] in [0, 1].
        baked_opacity: [H, W] in [0, 1].
        metrics: at least `psnr_linear` (dB) and `opacity_rmse` of this view.
    """

    name: str
    reference: NDArray[np.floating]
    baked: NDArray[np.floating]
    reference_opacity: NDArray[np.floating]
    baked_opacity: NDArray[np.floating]
    metrics: Mapping[str, float]


def write_sheet(
    path: str | os.PathLike[str], rows: Sequence[SheetRow], max_radiance: float, title: str
) -> None:
    """Write a contact sheet of up to six views as PNG, atomically.

    Columns: reference and baked radiance (sRGB, both at the reference's `auto_exposure`), their
    `relative_error` in false colour, reference and baked opacity in grey.

    Args:
        path: the PNG to write.
        rows: 1 to 6 views, shown in this order.
        max_radiance: L_max, radiance unit, positive.
        title: one line above the sheet, e.g. luminaire and asset.

    Raises:
        LumitreeError: no or too many rows, images whose shapes do not belong together or that
            are not finite, a missing metric, or a path that is no PNG or cannot be written.
    """
    if Path(path).suffix.lower() != ".png":
        raise LumitreeError(f"sheet name {str(path)!r} does not end in .png")
    if not 1 <= len(rows) <= MAX_ROWS:
        raise LumitreeError(f"a sheet holds 1 to {MAX_ROWS} views, not {len(rows)}; choose some")
    if not (np.isfinite(max_radiance) and max_radiance > 0):
        raise LumitreeError(f"L_max is {max_radiance}; expected a positive radiance")
    for row in rows:
        _check_row(row)
    figure = _draw(rows, max_radiance, title)
    with atomic_path(path) as temporary:
        # Not `savefig`: its result depends on the user's matplotlibrc.
        FigureCanvasAgg(figure).print_png(temporary, metadata={"Software": None})


def sheet_size(num_rows: int) -> tuple[int, int]:
    """Width and height in pixels of a sheet of `num_rows` views."""
    width = 2 * _MARGIN + len(COLUMNS) * _CELL + (len(COLUMNS) - 1) * _GAP
    height = _MARGIN + _TITLE + _HEADER + num_rows * (_CELL + _CAPTION) + _BARS + _MARGIN
    return width, height


def relative_error(
    baked: NDArray[np.floating], reference: NDArray[np.floating], max_radiance: float
) -> NDArray[np.float64]:
    """|baked - reference| / L_max [H, W] of images [H, W, 3], mean over the channels."""
    difference = np.asarray(baked, np.float64) - np.asarray(reference, np.float64)
    return np.abs(difference).mean(axis=-1) / max_radiance


def _draw(rows: Sequence[SheetRow], max_radiance: float, title: str) -> Figure:
    width, height = sheet_size(len(rows))
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
    error_norm, error_map = LogNorm(MIN_ERROR, 1, clip=True), colormaps["inferno"]
    _text(figure, _MARGIN, _MARGIN + 8, title, size=15, weight="bold")
    for column, heading in enumerate(COLUMNS):
        _text(figure, _left(column), _MARGIN + _TITLE + _HEADER / 2 - 2, heading, size=12)
    top = _MARGIN + _TITLE + _HEADER
    for row in rows:
        exposure = auto_exposure(row.reference)
        error = np.maximum(relative_error(row.baked, row.reference, max_radiance), MIN_ERROR)
        cells = (
            tonemap(row.reference, exposure),
            tonemap(row.baked, exposure),
            error_map(error_norm(error))[..., :3],
            _grey(row.reference_opacity),
            _grey(row.baked_opacity),
        )
        for column, pixels in enumerate(cells):
            _show(figure, _left(column), top, pixels)
        middle = top + _CELL + _CAPTION / 2 - 2
        _text(figure, _left(0), middle, f"{row.name} (exposure {exposure:.3g})")
        _text(figure, _left(1), middle, _psnr_caption(row.metrics))
        _text(figure, _left(4), middle, f"opacity_rmse {row.metrics['opacity_rmse']:.4f}")
        top += _CELL + _CAPTION
    _bar(figure, 2, top, error_map, error_norm, "|baked - reference| / L_max")
    for column in (3, 4):
        _bar(figure, column, top, colormaps["gray"], Normalize(0, 1), "opacity")
    return figure


def _psnr_caption(metrics: Mapping[str, float]) -> str:
    caption = f"psnr_linear {metrics['psnr_linear']:.2f} dB"
    if "psnr_linear_black" in metrics:
        caption += f" (black {metrics['psnr_linear_black']:.2f})"
    return caption


def _left(column: int) -> float:
    return _MARGIN + column * (_CELL + _GAP)


def _grey(opacity: NDArray[np.floating]) -> NDArray[np.float64]:
    return np.repeat(np.clip(np.asarray(opacity, np.float64), 0, 1)[..., None], 3, axis=-1)


def _box(
    figure: Figure, left: float, top: float, width: float, height: float
) -> tuple[float, float, float, float]:
    """Rectangle in pixels from the top left as matplotlib's fractions from the bottom left."""
    full_width, full_height = figure.get_size_inches() * _DPI
    return (
        left / full_width,
        1 - (top + height) / full_height,
        width / full_width,
        height / full_height,
    )


def _text(
    figure: Figure,
    left: float,
    middle: float,
    text: str,
    *,
    size: float = 11,
    weight: str = "normal",
) -> None:
    x, y, _, _ = _box(figure, left, middle, 0, 0)
    # File names may hold '$', which would start a formula.
    style = {"fontsize": size, "weight": weight, "color": _INK}
    figure.text(x, y, text, va="center", parse_math=False, **style)


def _show(figure: Figure, left: float, top: float, pixels: NDArray) -> None:
    """Image centred in a black square cell, its pixels kept square."""
    axes = figure.add_axes(_box(figure, left, top, _CELL, _CELL), facecolor="black")
    axes.imshow(pixels, interpolation="auto", aspect="equal")
    height, width = pixels.shape[:2]
    side = max(height, width)
    axes.set_xlim(width / 2 - side / 2 - 0.5, width / 2 + side / 2 - 0.5)
    axes.set_ylim(height / 2 + side / 2 - 0.5, height / 2 - side / 2 - 0.5)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def _bar(
    figure: Figure, column: int, top: float, colours: Colormap, norm: Normalize, label: str
) -> None:
    """Horizontal colour bar below a column."""
    left, width = _left(column) + _BAR_INSET, _CELL - 2 * _BAR_INSET
    axes = figure.add_axes(_box(figure, left, top + 2, width, _BAR_HEIGHT))
    bar = figure.colorbar(ScalarMappable(norm, colours), cax=axes, orientation="horizontal")
    bar.set_label(label, fontsize=11, color=_INK, labelpad=2)
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=10, colors=_INK, length=3)
    bar.outline.set(linewidth=0.6, edgecolor=_FAINT)


def _check_row(row: SheetRow) -> None:
    shape = np.shape(row.reference)
    if len(shape) != 3 or shape[2] != 3 or 0 in shape:
        raise LumitreeError(f"{row.name}: reference has shape {shape}; expected [height, width, 3]")
    expected = {"baked": shape, "reference_opacity": shape[:2], "baked_opacity": shape[:2]}
    for name, wanted in expected.items():
        if np.shape(getattr(row, name)) != wanted:
            found = np.shape(getattr(row, name))
            raise LumitreeError(f"{row.name}: {name} has shape {found}; expected {wanted}")
    for name in ("reference", *expected):
        if not np.isfinite(getattr(row, name)).all():
            raise LumitreeError(f"{row.name}: {name} holds NaN or infinity; render it again")
    for name in ("psnr_linear", "opacity_rmse"):
        if name not in row.metrics:
            raise LumitreeError(f"{row.name}: its metrics lack {name}")
