"""Images of the page: strips of tiles as JPEG."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lumitree.core.files import write_bytes
from lumitree.core.images import auto_exposure, tonemap

_QUALITY = 84
_GAP = 4


def write_jpeg(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write an image [H, W, 3] of bytes."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "jpeg", quality=_QUALITY, optimize=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, stream.getvalue())


def strip(tiles: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Tiles [H, W, 3] of equal height side by side, with white gaps."""
    gap = np.full((tiles[0].shape[0], _GAP, 3), 255, np.uint8)
    parts = [part for tile in tiles for part in (tile, gap)]
    return np.concatenate(parts[:-1], axis=1)


def stack(rows: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Rows [H, W, 3] of equal width above each other, with white gaps."""
    gap = np.full((_GAP, rows[0].shape[1], 3), 255, np.uint8)
    parts = [part for row in rows for part in (row, gap)]
    return np.concatenate(parts[:-1], axis=0)


def views(
    radiances: list[NDArray[np.floating]], opacities: list[NDArray[np.floating]]
) -> NDArray[np.uint8]:
    """Radiances above opacities; all radiances at the exposure of the first, the reference."""
    exposure = auto_exposure(radiances[0])
    colours = strip([tonemap(radiance, exposure) for radiance in radiances])
    return stack([colours, strip([_grey(opacity) for opacity in opacities])])


def _grey(opacity: NDArray[np.floating]) -> NDArray[np.uint8]:
    value = np.round(255 * np.clip(opacity, 0, 1)).astype(np.uint8)
    return np.repeat(value[..., None], 3, axis=-1)
