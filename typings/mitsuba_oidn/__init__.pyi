"""The one function of mitsuba-oidn that lumitree calls (the package is optional)."""

import numpy as np
from numpy.typing import NDArray

def denoise(
    color: NDArray[np.float32],
    albedo: NDArray[np.float32] | None = None,
    normal: NDArray[np.float32] | None = None,
    *,
    hdr: bool = False,
) -> NDArray[np.float32]: ...
