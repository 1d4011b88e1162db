"""Errors of pictures that are only known with noise, and the time that a method needs for one.

Symbols
    x, r    a picture and the reference, [H, W, 3]
    w       weights of the squared error, [H, W, 3]: 1 for the RMSE
    K       independent pictures (batches) of equally many samples
"""

import dataclasses
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from lumitree.core.images import srgb_from_linear
from lumitree.core.photometry import LUMENS_PER_WATT, luminance
from lumitree.measure.batches import jackknife_error

Floats = NDArray[np.floating]
Kind = Literal["measured", "extrapolated"]

TRIMMED_SHARE = 0.001
# relMSE divides by r² plus this share of the picture's squared mean, so that the unit of radiance
# does not matter.
RELATIVE_FLOOR = 0.01
WINDOW = 9


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A mean squared error and its standard error (one sigma)."""

    value: float
    error: float

    def __mul__(self, factor: float) -> "Estimate":
        return Estimate(self.value * factor, self.error * abs(factor))


def relative_weights(reference: Floats) -> Floats:
    """w of the relMSE: 1 / (r² + 0.01 mean(r)²), where r is averaged over 9 x 9 pixels.

    A noisy reference has pixels that no light has reached yet. Their own values would give the
    errors there a hundred times the weight, and make the weights depend on the noise.
    """
    size: Any = (WINDOW, WINDOW, 0)  # SciPy's annotation knows one number only
    local = uniform_filter(reference, size=size, mode="nearest")
    return 1 / (local**2 + RELATIVE_FLOOR * reference.mean() ** 2)


def trimming(*squares: Floats, share: float = TRIMMED_SHARE) -> Floats:
    """Mask [H, W, 1] of the pixels that stay without the worst of each picture of squares."""
    kept = np.ones((*squares[0].shape[:2], 1))
    for each in squares:
        pixels = each.mean(axis=-1)
        worst = np.argsort(pixels, axis=None)[pixels.size - round(share * pixels.size) :]
        kept.reshape(-1)[worst] = 0
    return kept


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


def noise(batches: Floats, weights: Floats | float = 1.0) -> Estimate:
    """Mean squared error of the mean of K batches [K, H, W, 3] by their noise, from their spread.

    Unbiased. The standard error is the jackknife's, so rare bright samples that no batch
    has met are missing from both numbers.
    """
    count = len(batches)
    deviations = ((batches - batches.mean(0)) ** 2 * weights).reshape(count, -1).mean(1)
    value = deviations.sum() / (count - 1) / count
    # Without batch i, whose deviation from the others' mean is K / (K - 1) times that from all's.
    without = deviations.sum() - deviations * count / (count - 1)
    without /= (count - 2) * (count - 1)
    return Estimate(float(value), float(jackknife_error(without)))


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
    """Mean of the pictures of one series of batches over that of another."""
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


@dataclasses.dataclass(frozen=True)
class Pace:
    """A method's mean squared error with n samples a pixel, bias + variance / n, and its speed.

    Attributes:
        variance: mean squared error by noise of one sample a pixel.
        seconds: that one sample a pixel takes.
        bias: mean squared error that no time removes.
    """

    variance: Estimate
    seconds: float
    bias: float = 0.0
