"""Pictures side by side under one exposure, each with a caption."""

import os

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lumitree.core.files import atomic_path
from lumitree.core.images import tonemap

_WIDTH = 480  # pixels a picture
_CAPTION = 56


def write_strip(
    path: str | os.PathLike[str],
    pictures: list[tuple[str, NDArray[np.floating]]],
    exposure: float,
) -> None:
    """Write pictures [H, W, 3] of equal size (linear radiance) beside each other as PNG.

    Args:
        pictures: caption (a line or two) and radiance of each.
        exposure: factor before the sRGB curve, the same for all.
    """
    height, width = pictures[0][1].shape[:2]
    panel = _WIDTH * height // width
    dpi = 100
    size = (_WIDTH * len(pictures) / dpi, (panel + _CAPTION) / dpi)
    figure = Figure(figsize=size, dpi=dpi, facecolor="white")
    share = panel / (panel + _CAPTION)
    for index, (caption, radiance) in enumerate(pictures):
        box = (index / len(pictures), 0.0, 0.995 / len(pictures), share)
        axes = figure.add_axes(box)
        axes.imshow(tonemap(radiance, exposure), interpolation="nearest", aspect="auto")
        axes.set_axis_off()
        figure.text(box[0] + 0.004, share + (1 - share) / 2, caption, va="center", fontsize=11)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=dpi)
