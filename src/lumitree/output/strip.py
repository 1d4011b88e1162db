"""Images side by side at one exposure, each with a caption."""

import os

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lumitree.core.files import atomic_path
from lumitree.core.images import tonemap

_WIDTH = 480  # width of an image in pixels
_CAPTION = 56


def write_strip(
    path: str | os.PathLike[str],
    images: list[tuple[str, NDArray[np.floating]]],
    exposure: float,
    settings: str = "",
) -> None:
    """Write images [H, W, 3] of linear radiance and equal size side by side as one PNG.

    Args:
        images: caption (one or two lines) and radiance of each image.
        exposure: factor before the sRGB curve, the same for all.
        settings: what made the images, stored as the comment of the file; may be empty.
    """
    height, width = images[0][1].shape[:2]
    panel = _WIDTH * height // width
    dpi = 100
    size = (_WIDTH * len(images) / dpi, (panel + _CAPTION) / dpi)
    figure = Figure(figsize=size, dpi=dpi, facecolor="white")
    share = panel / (panel + _CAPTION)
    for index, (caption, radiance) in enumerate(images):
        box = (index / len(images), 0.0, 0.995 / len(images), share)
        axes = figure.add_axes(box)
        axes.imshow(tonemap(radiance, exposure), interpolation="nearest", aspect="auto")
        axes.set_axis_off()
        figure.text(box[0] + 0.004, share + (1 - share) / 2, caption, va="center", fontsize=11)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=dpi, metadata={"Comment": settings or None})
