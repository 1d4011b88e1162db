"""Images side by side at one exposure, each with a caption, in one row or more."""

import os

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lumitree.core.files import atomic_path
from lumitree.core.view_transform import View, displayed

_WIDTH = 480  # least width of an image in pixels
_CAPTION = 56


def write_strip(
    path: str | os.PathLike[str],
    images: list[tuple[str, NDArray[np.floating]]],
    exposure: float,
    settings: str = "",
    *,
    columns: int | None = None,
    view: View = "standard",
) -> None:
    """Write images [H, W, 3] of linear radiance and equal size side by side as one PNG.

    Args:
        images: caption (one or two lines) and radiance of each image.
        exposure: factor before the view transform, the same for all.
        settings: what made the images, stored as the comment of the file; may be empty.
        columns: images in a row. Default: all.
        view: view transform.
    """
    columns = columns or len(images)
    rows = -(-len(images) // columns)
    height, width = images[0][1].shape[:2]
    wide = max(_WIDTH, width)
    panel = wide * height // width
    dpi = 100
    size = (wide * columns / dpi, rows * (panel + _CAPTION) / dpi)
    figure = Figure(figsize=size, dpi=dpi, facecolor="white")
    share = panel / (panel + _CAPTION) / rows
    for index, (caption, radiance) in enumerate(images):
        row, column = divmod(index, columns)
        bottom = 1 - (row + 1) / rows
        axes = figure.add_axes((column / columns, bottom, 0.995 / columns, share))
        shown = displayed(radiance, exposure, view)
        axes.imshow(shown, interpolation="nearest", aspect="auto")
        axes.set_axis_off()
        middle = bottom + share + (1 / rows - share) / 2
        figure.text(column / columns + 0.004, middle, caption, va="center", fontsize=11)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=dpi, metadata={"Comment": settings or None})
