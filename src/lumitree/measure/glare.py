"""Glare of a view, by evalglare (J. Wienold), which comes with the package pyradiance."""

import dataclasses
import importlib.util
import math

import numpy as np
from numpy.typing import NDArray

from lumitree.core.photometry import luminance
from lumitree.errors import LumitreeError, explained, shown
from lumitree.rendering.camera_view import CameraView
from lumitree.rendering.render import RenderResult

# Radiance takes the luminance of (v, v, v) for 179 v cd/m².
_RADIANCE_EFFICACY = 179.0
# The background luminance is the mean of the image without its sources. The standard's comes from
# the illuminance of a whole hemisphere, which a perspective image does not show.
_BACKGROUND = 1
# An RGBE pixel holds mantissas of 8 bits and an exponent, 128 for numbers from 0.5 to 1.
_MANTISSA, _EXPONENT = 256, 128
# Times the mean luminance of the image: what is brighter is a source of the UGR. evalglare's own
# threshold, 2,000 cd/m², is that of daylight, and of the DGP.
_BRIGHT = 5
# Images with dark corners too, below 7 cd/m²: evalglare takes them for those of a fisheye.
_DARK_CORNERS = "-f"


@dataclasses.dataclass(frozen=True)
class Glare:
    """Glare of a view.

    Attributes:
        ugr: Unified Glare Rating (CIE 117), of the sources in the image: from 10, not perceptible,
            to 28, intolerable. A source is what is brighter than 5 times the mean luminance of the
            image. NaN without a source, and before a background that is black.
        dgp: Daylight Glare Probability, 0 to 1, of sources above 2,000 cd/m²; it holds for
            daylight, and for a vertical illuminance above 380 lx.
        vertical_illuminance: at the eye, lx.
        background: luminance of the image without its sources, cd/m².
        source_luminance: mean luminance of the sources, cd/m²; NaN without a source.
        source_solid_angle: their solid angle, sr.
    """

    ugr: float
    dgp: float
    vertical_illuminance: float
    background: float
    source_luminance: float
    source_solid_angle: float


def check_evalglare() -> None:
    """Refuse to compute glare without pyradiance, before any work is done.

    Raises:
        LumitreeError: it is not installed.
    """
    if importlib.util.find_spec("pyradiance") is None:
        raise LumitreeError(
            "glare needs the package pyradiance; install it with `pip install 'lumitree[radiance]'`"
        )


@explained
def glare(image: RenderResult, vertical_illuminance: float) -> Glare:
    """Glare of a rendered view.

    The image is taken for all that the eye sees, apart from the vertical illuminance. So let it be
    wide: what glares is no source if it is not in the image. Noise of single pixels is; render long
    enough, or denoise.

    Args:
        image: of a perspective camera, 64 pixels wide and high or more.
        vertical_illuminance: illuminance at the camera, with its direction of view as normal, lx:
            as `illuminance` finds it. Where it is not known, NaN, or not positive, neither is DGP.

    Raises:
        LumitreeError: pyradiance is not installed, the camera has no `CameraView`, the image is too
            small, or evalglare fails.
    """
    check_evalglare()
    import pyradiance

    if image.camera is None:
        raise LumitreeError(
            "the camera is not a perspective one, or its axis is not at the centre of the image; "
            "glare needs both"
        )
    height, width = image.pixels.shape[:2]
    if min(height, width) < 64:
        raise LumitreeError(f"the image has {width} x {height} pixels; glare needs 64 x 64 or more")
    picture = _picture(luminance(image.pixels), image.camera)
    known = math.isfinite(vertical_illuminance) and vertical_illuminance > 0

    def figures(threshold: float | None = None) -> dict[str, float]:
        """What evalglare prints: names, a colon, numbers."""
        try:
            output = pyradiance.evalglare(
                picture,
                view=[_DARK_CORNERS],
                detailed=True,
                ev=vertical_illuminance if known else 1.0,
                bg_lum_mode=_BACKGROUND,
                threshold=threshold,
            )
        except RuntimeError as error:
            reason = shown(" ".join(str(error).split()), 300)
            raise LumitreeError(f"evalglare failed: {reason}") from None
        last = output.decode(errors="replace").strip().splitlines()[-1]
        names, _, numbers = last.partition(":")
        return dict(zip(names.split(","), map(float, numbers.split()), strict=False))

    values = figures(_BRIGHT)
    solid_angle, background = values["omega_sources"], max(values["lum_backg"], 0.0)
    return Glare(
        ugr=values["ugr"] if solid_angle and background else math.nan,
        dgp=figures()["dgp"] if known else math.nan,
        vertical_illuminance=vertical_illuminance,
        background=background,
        source_luminance=values["lum_sources"] if solid_angle else math.nan,
        source_solid_angle=solid_angle,
    )


def _picture(values: NDArray[np.float64], camera: CameraView) -> bytes:
    """A Radiance picture of luminances [H, W], cd/m², in grey."""
    height, width = values.shape
    grey = np.maximum(np.nan_to_num(values, posinf=0.0), 0) / _RADIANCE_EFFICACY
    mantissa, exponent = np.frexp(grey)
    pixels = np.empty((height, width, 4), np.uint8)
    pixels[..., :3] = np.minimum(mantissa * _MANTISSA, _MANTISSA - 1)[..., None]
    pixels[..., 3] = np.where(grey > 0, np.clip(exponent + _EXPONENT, 0, 255), 0)
    vectors = {"vp": camera.origin, "vd": camera.direction, "vu": camera.up}
    view = " ".join(f"-{name} {' '.join(f'{x:.6g}' for x in v)}" for name, v in vectors.items())
    angles = f"-vh {camera.horizontal:.6g} -vv {camera.vertical:.6g}"
    lines = ("#?RADIANCE", "FORMAT=32-bit_rle_rgbe", f"VIEW= -vtv {view} {angles}")
    header = "\n".join((*lines, "", f"-Y {height} +X {width}", ""))
    return header.encode() + pixels.tobytes()
