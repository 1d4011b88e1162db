"""Noise taken out of images by Intel Open Image Denoise.

Only illumination is filtered. Emitters that are seen directly, or by mirrors and glass, have little
noise, and the filter would blur filaments and highlights.
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.errors import LumitreeError
from lumitree.rendering.layers import Recorded


def check_denoiser() -> None:
    """Refuse to denoise without the package, before any work is done."""
    _open_image_denoise()


def denoised(recorded: Recorded) -> Recorded:
    """The recorded buffers, with illumination that has less noise.

    The image has to be rendered with a box filter: the noise of pixels that share samples is taken
    for a texture.

    Raises:
        LumitreeError: the package is not installed.
    """
    lit = np.stack([_filter(image, recorded) for image in recorded.lit])
    return dataclasses.replace(recorded, lit=lit)


def _filter(radiance: NDArray[np.float32], recorded: Recorded) -> NDArray[np.float32]:
    if not radiance.any():
        return radiance
    filtered = _open_image_denoise().denoise(
        np.ascontiguousarray(radiance),
        np.ascontiguousarray(np.clip(recorded.albedo, 0, 1)),
        np.ascontiguousarray(np.clip(recorded.normal, -1, 1)),
        hdr=True,
    )
    return np.maximum(np.array(filtered, np.float32), 0)


def _open_image_denoise() -> Any:
    try:
        import mitsuba_oidn
    except ImportError as error:
        raise LumitreeError(
            f"denoising needs the package mitsuba-oidn ({error}); install it with "
            "`pip install 'lumitree[denoise]'`, or render without --denoise"
        ) from None
    return mitsuba_oidn
