"""Noise that is left in images after Intel Open Image Denoise."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.equal_error.batches import LongRun
from lumitree.core.backend import load_mitsuba

_GUIDE_SAMPLES = 64


@dataclasses.dataclass(frozen=True)
class Guides:
    """Images that guide the filter, the same for all methods.

    Attributes:
        albedo: float32 [H, W, 3], diffuse reflectance.
        normal: float32 [H, W, 3], shading normal.
    """

    albedo: NDArray[np.float32]
    normal: NDArray[np.float32]

    @staticmethod
    def of(scene: Any) -> "Guides":
        """Guides of a scene (mi.Scene) with the explicit lamp."""
        mi = load_mitsuba()
        aov = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
        image = np.array(mi.render(scene, integrator=aov, spp=_GUIDE_SAMPLES, seed=0))
        return Guides(image[..., -6:-3], image[..., -3:])


def denoised_noise(
    run: LongRun,
    guides: Guides,
    diffuse: NDArray[np.bool_],
    scale: NDArray[np.floating],
    seconds: float,
) -> dict[str, float]:
    """Noise on diffuse surfaces of denoised images that cost about so much.

    Two disjoint groups of images are averaged and filtered; the squared noise is half the squared
    difference. It leaves out changes by the filter that both have in common.

    Args:
        run: images of a method, 2 at least.
        guides: of the filter.
        diffuse: [H, W] pixels that show diffuse surfaces alone.
        scale: [H, W, 3] image with little noise, by whose filtered brightness noise is divided.
        seconds: CPU seconds of a group; a group has no more than half the images.

    Returns:
        `seconds`, CPU seconds of an image without the filter's; and `error`, the root of the mean
        squared error by noise, relative to the brightness of a pixel.
    """
    cost = run.seconds["cpu"] / len(run.batches)
    count = max(1, min(len(run.batches) // 2, round(seconds / cost)))
    groups = [run.batches[start : start + count].mean(0) for start in (0, count)]
    first, second, mean = (_grey(each, guides)[diffuse] for each in (*groups, scale))
    error = float(np.sqrt((((first - second) / mean) ** 2).mean() / 2))
    return {"seconds": count * cost, "error": error}


def _grey(image: NDArray[np.floating], guides: Guides) -> NDArray[np.float64]:
    """Mean of R, G and B [H, W] of the denoised image."""
    filtered = denoised_image(image, guides.albedo, guides.normal)
    return filtered.mean(axis=-1, dtype=np.float64)


def denoised_image(
    image: NDArray[np.floating], albedo: NDArray[np.float32], normal: NDArray[np.float32]
) -> NDArray[np.float32]:
    """An image [H, W, 3] filtered as a whole."""
    from lumitree.rendering.layers import Recorded, denoised

    lit = np.ascontiguousarray(image, np.float32)[None]
    none = np.zeros_like(lit)
    return denoised(Recorded(none, none, lit, none[..., 0], albedo, normal)).lit[0]
