"""Reflectance of measured metals."""

import numpy as np

from lumitree.asset.textures import Json
from lumitree.core.backend import load_mitsuba


def normal_reflectance(material: Json) -> list[float]:
    """Reflectance [3] of a conductor at normal incidence, by Fresnel's equations."""
    mi = load_mitsuba()
    given = {name: material[name] for name in ("material", "eta", "k") if name in material}
    if any(isinstance(value, dict) for value in given.values()):
        return [1.0, 1.0, 1.0]
    colours = {
        name: {"type": "rgb", "value": value} if isinstance(value, list) else value
        for name, value in given.items()
    }
    parameters = mi.traverse(mi.load_dict({"type": "conductor", **colours}))
    eta, k = (
        np.broadcast_to(np.array(parameters[f"{name}.value"], np.float64).ravel(), 3)
        for name in ("eta", "k")
    )
    return (((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)).tolist()
