"""Noise taken out of images by Intel Open Image Denoise.

Emitters that are seen directly, or by mirrors and glass, have little noise, and the filter would
blur filaments and highlights: they are not filtered. Light that a lamp shows on its own rough glass
and shades is found by few, bright samples, which the filter takes for outliers: after 2 samples it
leaves 0.6 to 0.9 of the light. So this light is filtered apart, and keeps its local means.
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lumitree.errors import LumitreeError
from lumitree.rendering.layers import Recorded

# Standard deviation of the window in which filtered self-emission keeps its mean, pixels.
_WINDOW = 8.0


def check_denoiser() -> None:
    """Refuse to denoise without the package, before any work is done."""
    _open_image_denoise()


def denoised(recorded: Recorded) -> Recorded:
    """The recorded buffers, with illumination and self-emission that have less noise.

    The image has to be rendered with a box filter: the noise of pixels that share samples is taken
    for a texture.

    Raises:
        LumitreeError: the package is not installed.
    """
    lit = np.stack([_filter(image, recorded) for image in recorded.lit])
    shown = [_with_means(_filter(image, recorded), image) for image in recorded.self_emission]
    return dataclasses.replace(recorded, lit=lit, self_emission=np.stack(shown))


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


def _with_means(filtered: NDArray[np.float32], noisy: NDArray[np.float32]) -> NDArray[np.float32]:
    """A filtered image [H, W, 3], scaled to the local means of the noisy one."""
    means = [
        gaussian_filter(each.mean(axis=-1), _WINDOW, mode="constant") for each in (noisy, filtered)
    ]
    scale = np.divide(*means, out=np.zeros_like(means[0]), where=means[1] > 0)
    return filtered * scale[..., None]


def _open_image_denoise() -> Any:
    try:
        import mitsuba_oidn
    except ImportError as error:
        raise LumitreeError(
            f"denoising needs the package mitsuba-oidn ({error}); install it with "
            "`pip install 'lumitree[denoise]'`, or render without --denoise"
        ) from None
    return mitsuba_oidn
