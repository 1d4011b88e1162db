"""View transforms from the linear radiance of an image to the colours of a display.

"standard" clips at 1 and encodes sRGB. "filmic" is the output transform of ACES 2.0 for displays of
100 cd/m², by OpenColorIO: highlights lose colour and approach white slowly.
"""

import functools
import importlib
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from lumitree.core.arguments import check_choice, check_range
from lumitree.core.images import block_means, tonemap
from lumitree.core.photometry import LUMA
from lumitree.errors import LumitreeError

View = Literal["standard", "filmic"]
VIEWS: tuple[View, ...] = get_args(View)
# Log-average luminance of an image on the display, relative to white; and side in pixels of the
# blocks over which it is averaged: the logarithm of single pixels would measure their noise.
_KEY, _BLOCK = 0.15, 8
# The configuration is part of OpenColorIO 2.5 and later.
_CONFIG = "cg-config-v4.0.0_aces-v2.0_ocio-v2.5"
_LINEAR, _DISPLAY = "Linear Rec.709 (sRGB)", "sRGB - Display"
_FILMIC = "ACES 2.0 - SDR 100 nits (Rec.709)"


# Least and largest exposure.
EXPOSURES = 1e-12, 1e12


def check_view(view: View, exposure: float | None = None) -> None:
    """Refuse a view transform that there is not, or whose package is missing, before any work.

    Raises:
        LumitreeError: there is no such view, OpenColorIO is missing for "filmic", or the
            exposure is out of range.
    """
    check_choice("view", view, VIEWS)
    if exposure is not None:
        check_range("exposure", exposure, *EXPOSURES)
    if view == "filmic":
        _filmic()


def displayed(
    radiance: NDArray[np.floating], exposure: float, view: View = "standard"
) -> NDArray[np.uint8]:
    """sRGB bytes [H, W, 3] of linear radiance [H, W, 3] after `exposure`."""
    if view == "standard":
        return tonemap(radiance, exposure)
    height, width, channels = radiance.shape
    image = np.ascontiguousarray(np.nan_to_num(radiance * exposure), np.float32)
    library, processor = _filmic()
    processor.apply(library.PackedImageDesc(image, width, height, channels))
    return np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)


def room_exposure(radiance: NDArray[np.floating]) -> float:
    """Exposure factor for an image [H, W, 3]: by its log-average luminance.

    A visible lamp is thousands of times brighter than the rest, and covers few pixels: a mean of
    logarithms hardly depends on it. Black blocks do not count.
    """
    finite = np.nan_to_num(np.asarray(radiance, np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    means = block_means(finite @ np.array(LUMA), _BLOCK)
    lit = means[means > 0]
    exposure = _KEY / np.exp(np.log(lit).mean()) if lit.size else 1.0
    return float(np.clip(exposure, *EXPOSURES))


@functools.cache
def _filmic() -> tuple[Any, Any]:
    """OpenColorIO, whose module states no types, and its processor of "filmic"."""
    try:
        library: Any = importlib.import_module("PyOpenColorIO")
        config = library.Config.CreateFromBuiltinConfig(_CONFIG)
    except Exception as error:
        # Older versions raise their own exception: they do not have the configuration.
        raise LumitreeError(
            f"the filmic view needs the package opencolorio, 2.5 or newer ({error}); install it "
            "with `pip install 'lumitree[filmic]'`, or use the standard view"
        ) from None
    processor = config.getProcessor(_LINEAR, _DISPLAY, _FILMIC, library.TRANSFORM_DIR_FORWARD)
    return library, processor.getDefaultCPUProcessor()
