"""Reader of what the viewer's page reads."""

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.output.viewer.packing import PackedAsset


def unpack_asset(packed: PackedAsset) -> dict[str, NDArray[Any]]:
    """Arrays by name, as the page reads them."""
    content = zlib.decompress(base64.b64decode(packed.block))
    return {
        name: np.frombuffer(content, np.dtype(kind), count, start)
        for name, (kind, start, count) in packed.description["arrays"].items()
    }
