"""From radiometric to photometric quantities."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Luminous efficacy of light that is as visible as light can be, lm/W (the SI's K_cd).
LUMENS_PER_WATT = 683.0
# Relative luminance of linear sRGB primaries (ITU-R BT.709).
_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])


def luminance(rgb: ArrayLike) -> NDArray[np.float64]:
    """Photometric [...] of a radiometric quantity [..., 3] in R, G and B: W becomes lm."""
    return LUMENS_PER_WATT * (np.asarray(rgb, np.float64) @ _WEIGHTS)
