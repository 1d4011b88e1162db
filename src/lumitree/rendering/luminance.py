"""Luminance of images in false colours."""

import io

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

# Inches and dots per inch of the picture, and decades of luminance that it shows.
_WIDTH, _DPI, _DECADES = 8.0, 130, 4
# Part of the pixels that may be brighter than the scale: single ones are noise.
_BRIGHTER = 1e-3


def luminance_png(luminance: NDArray[np.floating]) -> bytes:
    """PNG file of a luminance [H, W], cd/m², in false colours with a legend.

    The scale is logarithmic and goes over four decades, up to the luminance that a thousandth of
    the pixels exceeds.
    """
    height, width = luminance.shape
    top = float(np.quantile(luminance, 1 - _BRIGHTER)) or float(luminance.max()) or 1.0
    figure = Figure(figsize=(_WIDTH, _WIDTH * 0.86 * height / width + 0.3), layout="constrained")
    axes = figure.add_subplot()
    axes.set_axis_off()
    scale = LogNorm(top / 10**_DECADES, top, clip=True)
    colours = axes.imshow(
        np.maximum(luminance, scale.vmin), norm=scale, cmap="turbo", interpolation="nearest"
    )
    bar = figure.colorbar(colours, ax=axes, extend="both", fraction=0.05, pad=0.01)
    bar.set_label("luminance, cd/m²")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI)
    return stream.getvalue()
