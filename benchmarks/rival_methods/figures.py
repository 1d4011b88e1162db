"""Cost, noise and brightness of a method, from its independent images."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.equal_error.batches import LongRun
from benchmarks.equal_error.errors import (
    DISPLAY_LEVELS,
    Estimate,
    Kind,
    display_exposure,
    display_rmse,
    ratio_of_means,
    squared_difference,
    time_to_reach,
    trimmed_mean,
)
from lumitree.core.images import srgb_from_linear

# Largest relative difference of the mean brightness of two renderers that agree.
TOLERANCE = 0.02
# Standard errors that a difference has to exceed to be one.
_SIGMAS = 2.0


@dataclasses.dataclass(frozen=True)
class Reached:
    """CPU seconds of an image with a given error.

    Attributes:
        level: `rmse_display`.
        seconds: CPU time.
        kind: "measured" between images that were made; "extrapolated" beyond them, by the variance;
            "below" where the cheapest image already has less error.
    """

    level: float
    seconds: float
    kind: Kind | Literal["below"]


@dataclasses.dataclass(frozen=True)
class Figures:
    """Figures of a method.

    Attributes:
        milliseconds: CPU time of a sample of all pixels, ms.
        variance: of a sample, relative to the squared mean, in the mean over diffuse surfaces
            without the 0.1 % of the pixels with the largest.
        mean: mean brightness of diffuse surfaces over the reference's.
        display: time of whole images; empty for a method that does not show the lamp.
        display_bias: square of the `rmse_display` of whole images against the reference's, both
            without noise; None for the reference, and for a method that does not show the lamp.
        samples: per pixel, of all images.
        images: number of images.
        seconds: CPU seconds of all images.
    """

    milliseconds: float
    variance: float
    mean: Estimate
    display: tuple[Reached, ...]
    display_bias: Estimate | None
    samples: int
    images: int
    seconds: float

    @property
    def product(self) -> float:
        """CPU time of a sample times its variance, ms: the time of an image is as this."""
        return self.milliseconds * self.variance

    @property
    def verdict(self) -> str:
        """Whether the mean brightness "agrees" with the reference's, is "biased" or "unknown"."""
        off, doubt = abs(self.mean.value - 1), _SIGMAS * self.mean.error
        if off + doubt <= TOLERANCE or (off <= TOLERANCE and self.mean.error <= TOLERANCE / 2):
            return "agrees"
        return "biased" if off > max(TOLERANCE, doubt) else "unknown"


def figures(
    run: LongRun,
    diffuse: NDArray[np.bool_],
    reference: LongRun,
    whole: NDArray[np.floating] | None,
    scale: NDArray[np.floating],
) -> Figures:
    """Figures of a method's images.

    Args:
        run: the images.
        diffuse: [H, W] pixels that show diffuse surfaces alone.
        reference: images that are right, but for their noise.
        whole: [H, W, 3] image with little noise, whose exposure and tones `rmse_display` is
            measured with; None for a method without whole images.
        scale: [H, W, 3] image with little noise on diffuse surfaces, by which noise is divided.
    """
    weights = diffuse[..., None]
    return Figures(
        milliseconds=1e3 * run.seconds["cpu"] / run.spp,
        variance=relative_variance(run.batches, scale, diffuse) * run.samples,
        mean=ratio_of_means(run.batches * weights, reference.batches * weights),
        display=() if whole is None else display_times(run, whole),
        display_bias=None
        if whole is None or run is reference
        else display_bias(run, reference, whole),
        samples=run.spp,
        images=len(run.batches),
        seconds=run.seconds["cpu"],
    )


def relative_variance(
    batches: NDArray[np.floating], scale: NDArray[np.floating], diffuse: NDArray[np.bool_]
) -> float:
    """Variance of an image over the squared mean, in the mean over pixels.

    Args:
        batches: [K, H, W, 3] independent images; the mean of R, G and B counts.
        scale: [H, W, 3] image with little noise.
        diffuse: [H, W] pixels that count; the 0.1 % with the largest variance are left out.
    """
    grey = batches[:, diffuse].mean(axis=-1, dtype=np.float64)
    mean = scale[diffuse].mean(axis=-1, dtype=np.float64)
    return trimmed_mean((grey.var(axis=0, ddof=1) / mean**2)[None, :, None])


def display_ladder(
    run: LongRun, whole: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`rmse_display` by noise alone against time.

    The deviation of the mean of m of K images from the mean of all has the variance
    σ² (1/m - 1/K), as the error of 1 / (1/m - 1/K) images. It is added to the image `whole`, so
    that methods with other models of materials are compared by their noise.

    Returns:
        CPU seconds [R], rising, and `rmse_display` [R], the root of the mean square over disjoint
        groups of m = 1, 2, 4, ... up to K / 2 images.
    """
    count = len(run.batches)
    mean = run.batches.mean(0, dtype=np.float64)
    seconds, errors = [], []
    size = 1
    while 2 * size <= count:
        groups = run.batches[: count // size * size].reshape(-1, size, *mean.shape)
        noisy = whole + groups.mean(1, dtype=np.float64) - mean
        seconds.append(run.seconds["cpu"] / count / (1 / size - 1 / count))
        errors.append(float(np.sqrt((display_rmse(noisy, whole) ** 2).mean())))
        size *= 2
    return np.array(seconds), np.array(errors)


def display_times(run: LongRun, whole: NDArray[np.floating]) -> tuple[Reached, ...]:
    """CPU seconds of an image at each of `DISPLAY_LEVELS`."""
    seconds, errors = display_ladder(run, whole)
    found = []
    square_seconds = display_variance(run, whole) * run.seconds["cpu"] / run.spp
    for level in DISPLAY_LEVELS:
        if errors[0] <= level:
            # In proportion to the variance: an upper bound, where tones saturate.
            found.append(Reached(level, seconds[0] * (errors[0] / level) ** 2, "below"))
        elif errors[-1] <= level:
            found.append(Reached(level, *time_to_reach(level, seconds, errors)))
        else:
            beyond = max(seconds[-1], square_seconds / level**2)
            found.append(Reached(level, float(beyond), "extrapolated"))
    return tuple(found)


def display_weights(whole: NDArray[np.floating]) -> NDArray[np.float64]:
    """[H, W, 3] factors of small squared errors of radiance to those on the display's scale.

    They are the squared slopes of the exposed and encoded tones at the image `whole` [H, W, 3].
    Clipped pixels have none.
    """
    exposed, step = display_exposure(whole) * whole, 0.01
    upper, lower = (srgb_from_linear(exposed * (1 + sign * step)) for sign in (1, -1))
    slope = 255 * (upper - lower) / (2 * step)
    return (slope / np.maximum(whole, 1e-9)) ** 2


def display_variance(run: LongRun, whole: NDArray[np.floating]) -> float:
    """Variance of a sample on the scale of `rmse_display`, in the mean over pixels.

    It holds for small noise, as images have it at `DISPLAY_LEVELS`, about the image `whole`
    [H, W, 3].
    """
    variance = run.batches.var(0, ddof=1, dtype=np.float64)
    return float((display_weights(whole) * variance).mean() * run.samples)


def display_bias(run: LongRun, reference: LongRun, whole: NDArray[np.floating]) -> Estimate:
    """Mean squared difference of what a method and the reference converge to.

    On the scale of `rmse_display`, for small differences, about the image `whole` [H, W, 3]. The
    noise of both is subtracted.
    """
    return squared_difference(run.batches, reference.batches, display_weights(whole))


def time_text(reached: Mapping[str, Any]) -> str:
    """Seconds with two digits; ~ beyond the images that were made, < below the cheapest of them.

    Args:
        reached: members of a `Reached`, by name.
    """
    sign = {"measured": "", "extrapolated": "~", "below": "<"}[reached["kind"]]
    digits = max(0, 1 - math.floor(math.log10(reached["seconds"])))
    return f"{sign}{reached['seconds']:,.{digits}f}"


def bias_text(bias: Mapping[str, float] | None) -> str:
    """The `rmse_display` of a squared bias, or the largest that two standard errors allow.

    Args:
        bias: members of an `Estimate`, by name; None where there is none.
    """
    if bias is None:
        return "-"
    value, doubt = bias["value"], _SIGMAS * bias["error"]
    if value > doubt:
        return f"{math.sqrt(value):.1f}"
    return f"<{math.sqrt(max(value, 0) + doubt):.1f}"
