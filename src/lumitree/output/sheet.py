"""Contact sheet of baked views and their references, for visual comparison."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm, Normalize
from numpy.typing import NDArray

from lumitree.core.images import auto_exposure, tonemap
from lumitree.errors import LumitreeError
from lumitree.output.tiles import Layout, TileSheet, grey

MAX_ROWS = 6
COLUMNS = ("Reference", "Baked", "Error", "Reference opacity", "Baked opacity")
# Smallest relative error on the colour scale; smaller ones are black.
MIN_ERROR = 1e-4


@dataclasses.dataclass(frozen=True)
class SheetRow:
    """One view of a sheet.

    Attributes:
        name: name of the view, e.g. "view 100001".
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


def draw_sheet(rows: Sequence[SheetRow], max_radiance: float, title: str) -> TileSheet:
    """Contact sheet of up to six views.

    Columns: reference and baked radiance (sRGB, both at the reference's `auto_exposure`), their
    `relative_error` in false colour, reference and baked opacity in grey.

    Args:
        rows: 1 to 6 views, shown in this order.
        max_radiance: L_max, radiance unit, positive.
        title: one line above the sheet, e.g. luminaire and asset.

    Raises:
        LumitreeError: the number of rows is out of range, shapes of images do not match, values
            are not finite, or a metric is missing.
    """
    if not 1 <= len(rows) <= MAX_ROWS:
        raise LumitreeError(f"a sheet holds 1 to {MAX_ROWS} views, not {len(rows)}; choose some")
    if not (np.isfinite(max_radiance) and max_radiance > 0):
        raise LumitreeError(f"L_max is {max_radiance}; expected a positive radiance")
    for row in rows:
        _check_row(row)
    return _draw(rows, max_radiance, title)


def sheet_layout(num_rows: int) -> Layout:
    """Layout of a sheet of `num_rows` views."""
    return Layout(columns=len(COLUMNS), rows=num_rows, tile=320, footer=54)


def relative_error(
    baked: NDArray[np.floating], reference: NDArray[np.floating], max_radiance: float
) -> NDArray[np.float64]:
    """|baked - reference| / L_max [H, W] of images [H, W, 3], mean over the channels."""
    difference = np.asarray(baked, np.float64) - np.asarray(reference, np.float64)
    return np.abs(difference).mean(axis=-1) / max_radiance


def _draw(rows: Sequence[SheetRow], max_radiance: float, title: str) -> TileSheet:
    sheet = TileSheet(sheet_layout(len(rows)))
    error_norm, error_map = LogNorm(MIN_ERROR, 1, clip=True), colormaps["inferno"]
    sheet.title(title)
    for column, heading in enumerate(COLUMNS):
        sheet.heading(column, heading)
    for index, row in enumerate(rows):
        exposure = auto_exposure(row.reference)
        error = np.maximum(relative_error(row.baked, row.reference, max_radiance), MIN_ERROR)
        tiles = (
            tonemap(row.reference, exposure),
            tonemap(row.baked, exposure),
            error_map(error_norm(error))[..., :3],
            grey(row.reference_opacity),
            grey(row.baked_opacity),
        )
        for column, pixels in enumerate(tiles):
            sheet.image(index, column, pixels)
        sheet.caption(index, 0, f"{row.name} (exposure {exposure:.3g})")
        sheet.caption(index, 1, _psnr_caption(row.metrics))
        sheet.caption(index, 4, f"opacity_rmse {row.metrics['opacity_rmse']:.4f}")
    sheet.colour_bar(2, error_map, error_norm, "|baked - reference| / L_max")
    for column in (3, 4):
        sheet.colour_bar(column, colormaps["gray"], Normalize(0, 1), "opacity")
    return sheet


def _psnr_caption(metrics: Mapping[str, float]) -> str:
    caption = f"psnr_linear {metrics['psnr_linear']:.2f} dB"
    if "psnr_linear_black" in metrics:
        caption += f" (black {metrics['psnr_linear_black']:.2f})"
    return caption


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
