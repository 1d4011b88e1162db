"""Errors of pictures that are only known with noise, and the time that a method needs for one.

`K` is the number of independent pictures (batches) of equally many samples.
"""

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lumitree.core.images import srgb_from_linear
from lumitree.core.photometry import LUMENS_PER_WATT, luminance
from lumitree.measure.batches import jackknife_error

Floats = NDArray[np.floating]
Kind = Literal["measured", "extrapolated"]

TRIMMED_SHARE = 0.001
# `rmse_display` that the paper's equal-quality comparison ends at (its Table 5).
DISPLAY_LEVELS = (8.0, 5.0, 2.7)


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A mean squared error and its standard error (one sigma)."""

    value: float
    error: float


def trimmed_mean(squares: Floats, share: float = TRIMMED_SHARE) -> float:
    """Mean of a picture's squared errors [H, W, 3] without its worst pixels.

    Args:
        share: of the pixels, those with the largest errors (mean over channels), left out.
    """
    pixels = np.sort(squares.mean(axis=-1).ravel())
    return float(pixels[: len(pixels) - round(share * len(pixels))].mean())


def display_rmse(images: Floats, reference: Floats, weights: Floats | float = 1.0) -> Floats:
    """RMSE of images as they are looked at, on the scale of 8 bits, 0 to 255.

    The paper does not state the scale of the RMSE in its Table 5; they are taken to be on this one.
    Both are exposed so that the median luminance of the reference is 0.18, clipped at 1, and
    encoded as sRGB. Pixels that are black in the reference do not count for the median.

    Args:
        images: [R, H, W, 3] linear radiance.
        reference: [H, W, 3].
        weights: [H, W, 1] of the squared errors, of mean 1.

    Returns:
        [R]
    """
    exposure = display_exposure(reference)
    encoded, goal = (srgb_from_linear(exposure * each) for each in (images, reference))
    return 255 * np.sqrt(((encoded - goal) ** 2 * weights).mean(axis=(1, 2, 3)))


def display_exposure(reference: Floats) -> float:
    """Factor on the radiance of a reference [H, W, 3] with which `display_rmse` exposes it."""
    seen = luminance(reference)
    return 0.18 * LUMENS_PER_WATT / float(np.median(seen[seen > 0]))


def squared_difference(first: Floats, second: Floats, weights: Floats | float = 1.0) -> Estimate:
    """Mean squared difference of what two series of batches [K, H, W, 3] converge to.

    The noise of both is subtracted, (a - b)² - var(a) - var(b): unbiased, and so below 0 by chance
    where the truth is near 0. The standard error is the jackknife's over both series, which states
    up to half too much where the truth is 0.
    """
    whole = _difference(first, second, weights)
    errors = []
    for series, other in ((first, second), (second, first)):
        rest = np.arange(len(series))
        without = [_difference(series[rest != i], other, weights) for i in rest]
        errors.append(float(jackknife_error(np.array(without))))
    return Estimate(whole, float(np.hypot(*errors)))


def ratio_of_means(first: Floats, second: Floats) -> Estimate:
    """Mean of the pictures of one series of batches over the mean of another series."""
    means = [batches.mean(axis=(1, 2, 3), dtype=np.float64) for batches in (first, second)]
    relative = [each.std(ddof=1) / np.sqrt(len(each)) / each.mean() for each in means]
    ratio = float(means[0].mean() / means[1].mean())
    return Estimate(ratio, ratio * float(np.hypot(*relative)))


def _difference(first: Floats, second: Floats, weights: Floats | float) -> float:
    square = ((first.mean(0) - second.mean(0)) ** 2 * weights).mean()
    for batches in (first, second):
        square -= (batches.var(0, ddof=1) * weights).mean() / len(batches)
    return float(square)


def time_to_reach(level: float, seconds: Floats, errors: Floats) -> tuple[float, Kind]:
    """Seconds after which a ladder of measured errors stays at or below `level`.

    Between rungs, log error is linear in log time. Beyond the last rung the squared error is
    taken to fall as 1 / time; a level above all errors takes the first rung's time, since no
    picture is cheaper.

    Args:
        level: root of a mean squared error, positive.
        seconds: [R] times, rising.
        errors: [R] roots of mean squared errors.
    """
    above = np.flatnonzero(np.asarray(errors) > level)
    if not len(above):
        return float(seconds[0]), "measured"
    i = int(above[-1])
    if i + 1 == len(errors):
        return float(seconds[i] * (errors[i] / level) ** 2), "extrapolated"
    share = np.log(errors[i] / level) / np.log(errors[i] / errors[i + 1])
    return float(seconds[i] * (seconds[i + 1] / seconds[i]) ** share), "measured"


def display_rows(
    runs: dict[str, tuple[list[dict], Floats, float]],
    clock: str,
    weights: Floats | float = 1.0,
    reference: str = "explicit",
) -> tuple[dict[str, list[dict]], float]:
    """`rmse_display` of the ladders, of the long runs and of the reference.

    The reference is the long run of one of them. Its own error is half the difference between the
    means of its odd and its even batches, and is subtracted from all others. Its last
    image is the mean of every second batch: its error is that difference over √2.

    Args:
        runs: rungs, batches [K, H, W, 3] of the long run, and its seconds, by method.
        clock: that the seconds of rungs are by.
        weights: see `display_rmse`.
        reference: name of the method whose long run is the reference.
    """
    goal = runs[reference][1].mean(0)
    difference = noise_of_mean(runs[reference][1], weights) * 2
    own = difference / 2
    rows = {}
    for name, (rungs, batches, seconds) in runs.items():
        rows[name] = [
            {
                "seconds": float(np.median(rung["seconds"][clock])),
                "rmse": _without(display_rmse(rung["images"], goal, weights), own),
            }
            for rung in rungs
        ]
        last = {
            "seconds": seconds,
            "rmse": _without(display_rmse(batches.mean(0)[None], goal, weights), own),
        }
        if name == reference:
            last = {"seconds": seconds / 2, "rmse": difference / np.sqrt(2)}
        rows[name].append(last)
    return rows, own


def noise_of_mean(batches: Floats, weights: Floats | float = 1.0) -> float:
    """`rmse_display` of the mean of batches [K, H, W, 3] by their noise.

    Half of `rmse_display` of the mean of the even batches against the mean of the odd ones.
    """
    halves = batches[0::2].mean(0), batches[1::2].mean(0)
    return float(display_rmse(halves[0][None], halves[1], weights)[0]) / 2


def _without(errors: Floats, own: float) -> float:
    """Root of the mean of squared errors, without the error of the reference."""
    return float(np.sqrt(max((errors**2).mean() - own**2, 0.0)))
