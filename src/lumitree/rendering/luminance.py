"""Luminance of images in false colours."""

import io

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter
from numpy.typing import NDArray

# Inches and dots per inch of the picture, and decades of luminance that it shows.
_WIDTH, _DPI, _DECADES = 8.0, 130, 4
# Part of the pixels that may be beyond each end of the scale: single ones are noise.
_BEYOND = 1e-3


def luminance_png(luminance: NDArray[np.floating]) -> bytes:
    """PNG file of a luminance [H, W], cd/m², in false colours with a legend.

    The scale is logarithmic. A thousandth of the pixels is brighter than it, and as many are darker
    unless it would then go over more than four decades.
    """
    luminance = np.nan_to_num(luminance, nan=0.0, posinf=0.0, neginf=0.0)
    height, width = luminance.shape
    low, top = np.quantile(luminance, (_BEYOND, 1 - _BEYOND)).tolist()
    top = top or float(luminance.max()) or 1.0
    low = min(max(low, top / 10**_DECADES), top / 2)
    figure = Figure(figsize=(_WIDTH, _WIDTH * 0.86 * height / width + 0.3), layout="constrained")
    axes = figure.add_subplot()
    axes.set_axis_off()
    scale = LogNorm(low, top, clip=True)
    colours = axes.imshow(
        np.maximum(luminance, low), norm=scale, cmap="turbo", interpolation="nearest"
    )
    bar = figure.colorbar(colours, ax=axes, extend="both", fraction=0.05, pad=0.01)
    plain = LogFormatter(labelOnlyBase=False, minor_thresholds=(2, 0.5))
    bar.ax.yaxis.set_major_formatter(plain)
    bar.ax.yaxis.set_minor_formatter(plain)
    bar.set_label("luminance, cd/m²")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI)
    return stream.getvalue()
