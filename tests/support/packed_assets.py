"""Reader of what the viewer's page reads."""

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.array_stream import Layout, decompressed
from lumitree.asset.field_file import coefficients_of, densities
from lumitree.viewer.packing import PackedAsset


def unpack_asset(packed: PackedAsset) -> dict[str, NDArray[Any]]:
    """Arrays by name; of a field the densities [M] and coefficients [M, 3, K] of the page."""
    stream = np.frombuffer(base64.b64decode(packed.block), np.uint8)
    layouts = [
        Layout(name, np.dtype(kind), (rows, columns), planes)
        for name, kind, rows, columns, planes in packed.description["arrays"]
    ]
    arrays = decompressed(stream, layouts, "the page")
    arrays = {name: each[:, 0] if each.shape[1] == 1 else each for name, each in arrays.items()}
    if packed.description["field"] is None:
        return arrays
    codes = arrays["coefficients"].reshape(packed.description["field"]["leaves"], -1, 3)
    return arrays | {
        "density": densities(arrays["density"]),
        "coefficients": coefficients_of(codes),
    }
