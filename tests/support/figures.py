"""Texts and images of figures."""

import functools
import io

import numpy as np
from matplotlib.text import Text
from PIL import Image


@functools.lru_cache(maxsize=1)
def _drawn(sheet):
    with Image.open(io.BytesIO(sheet.png())) as image:
        return np.asarray(image)[::-1, :, :3]


def tile_pixels(sheet, index):
    """Pixels [H, W, 3] of an image of a grid, counted from the first row on, without its edge."""
    pixels = _drawn(sheet)
    box = sheet.axes[index].get_window_extent()
    rows, columns = slice(round(box.y0), round(box.y1)), slice(round(box.x0), round(box.x1))
    return pixels[rows, columns][-3:1:-1, 2:-2]


def texts(sheet):
    """All texts, without the numbers of scales."""
    return [text for each in sheet.findobj(Text) if (text := each.get_text())]
