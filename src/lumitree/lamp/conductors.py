"""Reflectance of measured metals."""

import numpy as np

from lumitree.asset.materials import Metal, Texture, VertexColours
from lumitree.core.backend import load_mitsuba


def normal_reflectance(metal: Metal) -> list[float]:
    """Reflectance [3] of a conductor at normal incidence, by Fresnel's equations."""
    mi = load_mitsuba()
    given = {"material": metal.material, "eta": metal.eta, "k": metal.k}
    if any(isinstance(value, Texture | VertexColours) for value in given.values()):
        return [1.0, 1.0, 1.0]
    colours = {
        name: {"type": "rgb", "value": list(value)} if isinstance(value, tuple) else value
        for name, value in given.items()
        if value is not None
    }
    parameters = mi.traverse(mi.load_dict({"type": "conductor", **colours}))
    eta, k = (
        np.broadcast_to(np.array(parameters[f"{name}.value"], np.float64).ravel(), 3)
        for name in ("eta", "k")
    )
    return (((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)).tolist()
