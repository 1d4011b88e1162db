"""The axis that points up in a luminaire's file, and in another program."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Up = Literal["y", "z"]
_Z_FROM_Y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def turn_up(given: Up, wanted: Up) -> NDArray[np.float64]:
    """Rotation [3, 3] from a frame with one axis up to a frame with another; x stays."""
    if given == wanted:
        return np.eye(3)
    return _Z_FROM_Y if wanted == "z" else _Z_FROM_Y.T
