"""Error metrics of a baked luminaire on held-out views.

Symbols
    b, r       baked and reference radiance, in the asset's radiance unit
    L_max      radiance that is mapped to 1: the 99.99th percentile over the reference views
    x          clip(radiance / L_max, 0, 1)

A PSNR is at most `MAX_PSNR`, because JSON has no infinity and means over views need finite numbers.
"""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from skimage.metrics import structural_similarity

from lumitree.errors import LumitreeError

try:
    import flip_evaluator
except ImportError:  # it has no wheels for Python 3.14, and for Linux on ARM
    flip_evaluator = None

VIEW_METRICS = (
    "psnr_linear",
    "ssim_linear",
    "psnr_mulaw",
    "ssim_mulaw",
    "psnr_pu21",
    "hdr_flip",
    "rel_mse",
    "opacity_rmse",
    "psnr_linear_black",
    "psnr_mulaw_black",
)
METRICS = (*VIEW_METRICS, "flux_error", "gain_linear", "gain_mulaw")

MAX_PSNR = 100.0  # dB
MU = 5000.0
REL_MSE_EPSILON = 0.01  # squared radiance
# Wang et al. 2004: Gaussian window with sigma 1.5, truncated at 5 pixels.
SSIM_WINDOW = 11

# Rec. ITU-R BT.709 luminance of linear RGB.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

# gfxdisp/pu21, matlab/pu21_encoder.m, case 'banding_glare' (p(1) to p(7)) and its range, cd/m².
_PU21 = (0.353487901, 0.3734658629, 8.277049286e-05, 0.9062562627, 0.09150303166)
_PU21_OFFSET, _PU21_SCALE = 0.9099517204, 596.3148142
_PU21_RANGE = (0.005, 10000.0)
# matlab/pu21_metric.m: psnr(T, R, 256); 100 cd/m² encodes to about 256.
PU21_PEAK = 256.0
DISPLAY_PEAK = 4000.0  # luminance at which L_max is displayed, cd/m²

# Exposures of HDR-FLIP: coefficients of the ACES curve (x (a x + b)) / (x (c x + d) + e) of FLIP.h,
# the value for which the package solves it, and the smallest luminance, relative to L_max, for
# which an exposure is chosen.
_FLIP_ACES = (0.36 * 2.51, 0.6 * 0.03, 0.36 * 2.43, 0.6 * 0.59, 0.14)
_FLIP_TARGET = 0.85
_FLIP_FLOOR = 1e-3
# Pixels, more than the radii of all filters of HDR-FLIP.
_FLIP_MARGIN = 24


def view_metrics(
    baked: ArrayLike,
    reference: ArrayLike,
    baked_opacity: ArrayLike,
    reference_opacity: ArrayLike,
    max_radiance: float,
) -> dict[str, float]:
    """All metrics of one view, by the names of `VIEW_METRICS`.

    Args:
        baked: [H, W, 3] radiance of the asset; at least 11 pixels per side.
        reference: [H, W, 3] radiance of the luminaire, same unit.
        baked_opacity: [H, W] in [0, 1].
        reference_opacity: [H, W] in [0, 1]. Its noise counts as error, so it should be converged.
        max_radiance: L_max, radiance unit, positive.

    Returns:
        `psnr_linear`, `ssim_linear` of x (dB; -1 to 1); `psnr_mulaw`, `ssim_mulaw` of `mulaw(x)`;
        `psnr_pu21` (dB) of `pu21(radiance / L_max * 4000 cd/m²)` in each channel with peak 256;
        `hdr_flip` (0 to 1; 0 for equal images), if `flip-evaluator` is installed; `rel_mse`;
        `opacity_rmse` (0 to 1); and the PSNRs of an all-black prediction, `psnr_linear_black` and
        `psnr_mulaw_black` (dB). SSIM is by Wang et al., "Image Quality Assessment: From Error
        Visibility to Structural Similarity", 2004.

    Raises:
        LumitreeError: shapes differ or are too small, values are not finite, or L_max is not
            positive.
    """
    b, r = _image(baked, "baked radiance"), _image(reference, "reference radiance")
    _same_shape(b, r, "radiance")
    b_opacity = _finite(baked_opacity, "baked opacity")
    r_opacity = _finite(reference_opacity, "reference opacity")
    _same_shape(b_opacity, r_opacity, "opacity")
    if r_opacity.shape != r.shape[:2]:
        raise LumitreeError(
            f"opacity has shape {r_opacity.shape}; expected {r.shape[:2]}, as the radiance"
        )
    if not (np.isfinite(max_radiance) and max_radiance > 0):
        raise LumitreeError(f"L_max is {max_radiance}; expected a positive radiance")

    b_linear, r_linear = (np.clip(image / max_radiance, 0, 1) for image in (b, r))
    b_mulaw, r_mulaw = mulaw(b_linear), mulaw(r_linear)
    b_pu21, r_pu21 = (pu21(image / max_radiance * DISPLAY_PEAK) for image in (b, r))
    black = np.zeros_like(r)
    metrics = {
        "psnr_linear": psnr(b_linear, r_linear),
        "ssim_linear": ssim(b_linear, r_linear),
        "psnr_mulaw": psnr(b_mulaw, r_mulaw),
        "ssim_mulaw": ssim(b_mulaw, r_mulaw),
        "psnr_pu21": psnr(b_pu21, r_pu21, PU21_PEAK),
        "hdr_flip": hdr_flip(b, r, max_radiance) if flip_evaluator is not None else None,
        "rel_mse": rel_mse(b, r),
        "opacity_rmse": float(np.sqrt(np.mean((b_opacity - r_opacity) ** 2))),
        "psnr_linear_black": psnr(black, r_linear),
        "psnr_mulaw_black": psnr(black, r_mulaw),
    }
    return {name: value for name, value in metrics.items() if value is not None}


def mean_metrics(views: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Arithmetic mean of each metric over views, also of metrics in decibels.

    Args:
        views: results of `view_metrics`, one for each view; all with the same names.

    Raises:
        LumitreeError: there is no view, or the names differ.
    """
    if not views:
        raise LumitreeError("there are no views to average; expected at least one")
    names = list(views[0])
    for index, view in enumerate(views):
        if set(view) != set(names):
            raise LumitreeError(f"view {index} has metrics {sorted(view)}; expected {names}")
    return {name: float(np.mean([view[name] for view in views])) for name in names}


def gain_over_black(metrics: Mapping[str, float]) -> dict[str, float]:
    """By how many decibels the PSNRs of an asset exceed an all-black prediction's.

    Where a lamp covers few pixels, even a black prediction has a high PSNR. For a view the result
    is 10 log10(mean squared error of black / mean squared error of the asset). Below 0 dB, black
    has the smaller error.

    Args:
        metrics: result of `view_metrics` for one view, or of `mean_metrics`; other names are
            ignored. The result for means is the mean of the views' results.

    Returns:
        `gain_linear` and `gain_mulaw`, dB: `psnr_linear` minus `psnr_linear_black`, and
        `psnr_mulaw` minus `psnr_mulaw_black`.
    """
    return {
        f"gain_{kind}": metrics[f"psnr_{kind}"] - metrics[f"psnr_{kind}_black"]
        for kind in ("linear", "mulaw")
    }


def flux_error(baked_images: Iterable[ArrayLike], reference_images: Iterable[ArrayLike]) -> float:
    """Relative error |baked / reference - 1| of the total emitted flux.

    The luminance of an orthographic view, integrated over its plane, is the intensity towards the
    camera, so the flux is proportional to the mean of the views' mean luminances, for directions
    that are uniform on the sphere. Both arguments are the same views in the same order, so most of
    the error that a finite number of views causes cancels.

    Args:
        baked_images: [H, W, 3] radiance of each view; read one by one.
        reference_images: the same views of the luminaire, same unit.

    Raises:
        LumitreeError: views are missing, differ in shape, are not finite, or all references are
            black.
    """
    baked_sum = reference_sum = 0.0
    pairs = itertools.zip_longest(baked_images, reference_images)
    for index, (baked, reference) in enumerate(pairs):
        if baked is None or reference is None:
            side = "baked" if baked is None else "reference"
            raise LumitreeError(f"there are only {index} {side} views; expected as many of each")
        b = _image(baked, f"baked view {index}")
        r = _image(reference, f"reference view {index}")
        _same_shape(b, r, f"view {index}")
        baked_sum += _mean_luminance(b)
        reference_sum += _mean_luminance(r)
    if reference_sum <= 0:
        raise LumitreeError("the reference views show no light; the flux has no relative error")
    return abs(baked_sum / reference_sum - 1)


def mulaw(x: NDArray[np.floating]) -> NDArray[np.floating]:
    """log(1 + mu x) / log(1 + mu) with mu = 5000: [0, 1] to [0, 1].

    Kalantari and Ramamoorthi, "Deep High Dynamic Range Imaging of Dynamic Scenes", 2017.
    """
    return np.log1p(MU * x) / np.log1p(MU)


def pu21(luminance: ArrayLike) -> NDArray[np.floating]:
    """Perceptually uniform encoding of absolute luminance, PU21 'banding_glare'.

        Y = clip(luminance, 0.005, 10000)
        V = p7 (((p1 + p2 Y^p4) / (1 + p3 Y^p4))^p5 - p6)

    Mantiuk and Azimi, "PU21: A novel perceptually uniform encoding for adapting existing quality
    metrics for HDR", Picture Coding Symposium 2021; coefficients of their `pu21_encoder.m`.

    Args:
        luminance: cd/m², any shape. For colours, each channel is encoded separately, as for the
            PSNR of the paper.

    Returns:
        V: 0 at 0.005 cd/m², about 256 at 100 cd/m², and about 595 at 10000 cd/m².
    """
    p1, p2, p3, p4, p5 = _PU21
    power = np.clip(np.asarray(luminance, np.float64), *_PU21_RANGE) ** p4
    return _PU21_SCALE * (((p1 + p2 * power) / (1 + p3 * power)) ** p5 - _PU21_OFFSET)


def psnr(image: NDArray[np.floating], reference: NDArray[np.floating], peak: float = 1.0) -> float:
    """10 log10(peak² / mean squared error), dB, at most `MAX_PSNR`."""
    mse = float(np.mean((image - reference) ** 2))
    if mse == 0:
        return MAX_PSNR
    return min(10 * float(np.log10(peak**2 / mse)), MAX_PSNR)


def ssim(image: NDArray[np.floating], reference: NDArray[np.floating]) -> float:
    """Structural similarity (-1 to 1) of two images [H, W, 3] in [0, 1], mean over channels.

    Wang et al. 2004: Gaussian window of 11 pixels and sigma 1.5, population covariance.

    Raises:
        LumitreeError: the images are smaller than the window.
    """
    if min(image.shape[:2]) < SSIM_WINDOW:
        height, width = image.shape[:2]
        raise LumitreeError(
            f"views of {width} x {height} pixels are too small for SSIM; "
            f"expected at least {SSIM_WINDOW} per side"
        )
    similarity = structural_similarity(
        image,
        reference,
        data_range=1,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    return float(cast(float, similarity))  # without the map of local values


def rel_mse(baked: NDArray[np.floating], reference: NDArray[np.floating]) -> float:
    """Relative mean squared error, mean((b - r)² / (r² + 0.01)), over pixels and channels.

    The form is by Rousselle et al., "Adaptive Sampling and Reconstruction using Greedy Error
    Minimization", 2011. The 0.01 is in squared radiance, so the value depends on the unit.
    """
    return float(np.mean((baked - reference) ** 2 / (reference**2 + REL_MSE_EPSILON)))


def hdr_flip(
    baked: NDArray[np.floating], reference: NDArray[np.floating], max_radiance: float
) -> float:
    """Mean HDR-FLIP error, 0 (equal) to 1, of images [H, W, 3] at 67 pixels per degree.

    Andersson et al., "Visualizing Errors in Rendered High Dynamic Range Images", 2021, by NVIDIA's
    `flip-evaluator`; negative radiance counts as black.

    The exposures are from `flip_exposures`; they differ from the package's.

    Raises:
        LumitreeError: `flip-evaluator` is not installed.
    """
    if flip_evaluator is None:
        raise LumitreeError("HDR-FLIP needs the package flip-evaluator, which is not installed")
    r, b = (np.maximum(image / max_radiance, 0).astype(np.float32) for image in (reference, baked))
    # The error is 0 where both images are black, and no filter reaches a lit pixel.
    lit = (r + b).any(axis=-1)
    part = _around(np.any(lit, axis=1)), _around(np.any(lit, axis=0))
    r, b = (np.ascontiguousarray(image[part]) for image in (r, b))
    exposures = flip_exposures(reference / max_radiance)
    _, error, _ = flip_evaluator.evaluate(r, b, "HDR", applyMagma=False, parameters=exposures)
    return float(error) * r.shape[0] * r.shape[1] / lit.size


def _around(lit: NDArray[np.bool_]) -> slice:
    """The rows or columns from the first to the last that are lit, and a margin."""
    (found,) = np.nonzero(lit)
    if not found.size:
        return slice(0, 1)
    return slice(max(0, int(found[0]) - _FLIP_MARGIN), int(found[-1]) + 1 + _FLIP_MARGIN)


def flip_exposures(reference: NDArray[np.floating]) -> dict[str, float]:
    """First and last exposure (stops) for HDR-FLIP with the ACES curve.

    As in Andersson et al. 2021, the first exposure displays the brightest luminance at 0.85, and
    the last one the median luminance. Unlike there, the median is over the *lit* pixels, and
    luminances below 0.001 L_max count as 0.001 L_max. The package takes the median over all
    pixels. It is 0 for a lamp in front of black, which the package replaces by 1e-7, so that it
    compares the images at up to 2^24 times their exposure. A background of 1e-7 instead of 0 then
    changed the error from 0.005 to 0.88. For a black reference the package ends the process.

    Args:
        reference: [H, W, 3] radiance / L_max, not clipped.
    """
    luminance = reference @ _LUMINANCE
    lit = luminance[luminance > 0]
    brightest, median = (lit.max(), np.median(lit)) if lit.size else (0.0, 0.0)
    a, b, c, d, e = _FLIP_ACES
    t = _FLIP_TARGET
    white = max(np.roots([a - t * c, b - t * d, -t * e]).real)
    return {
        "startExposure": float(np.log2(white / max(brightest, _FLIP_FLOOR))),
        "stopExposure": float(np.log2(white / max(median, _FLIP_FLOOR))),
    }


def _mean_luminance(image: NDArray[np.floating]) -> float:
    return float(image.mean(axis=(0, 1)) @ _LUMINANCE)


def _image(value: ArrayLike, what: str) -> NDArray[np.floating]:
    image = _finite(value, what)
    if image.ndim != 3 or image.shape[2] != 3 or not image.size:
        raise LumitreeError(f"{what} has shape {image.shape}; expected [height, width, 3]")
    return image


def _finite(value: ArrayLike, what: str) -> NDArray[np.floating]:
    array = np.asarray(value, np.float64)
    bad = int(array.size - np.isfinite(array).sum())
    if bad:
        raise LumitreeError(f"{what} has {bad} values that are NaN or infinite; render it again")
    return array


def _same_shape(baked: NDArray[np.floating], reference: NDArray[np.floating], what: str) -> None:
    if baked.shape != reference.shape:
        raise LumitreeError(
            f"baked and reference {what} differ in shape: {baked.shape} and {reference.shape}"
        )
