"""Reads the lights of a lamp that was exported to OpenUSD."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.exported_files.lights import ReadLight
from lumitree.core.photometry import LUMA
from lumitree.formats.ies import read_ies
from lumitree.formats.type_c import IntensityDistribution, y_up


def lights_of(pxr: Any, stage: Any) -> list[Any]:
    """Prims of the lights of a stage."""
    return [prim for prim in stage.Traverse() if prim.IsA(pxr.UsdLux.SphereLight)]


def value(prim: Any, name: str) -> Any:
    """Value of an input."""
    return prim.GetAttribute(f"inputs:{name}").Get()


def profile_of(prim: Any) -> IntensityDistribution:
    """Distribution of the profile of a light."""
    return read_ies(prim.GetAttribute("inputs:shaping:ies:file").Get().resolvedPath)


def world_from_light(pxr: Any, prim: Any) -> NDArray[np.float64]:
    """[4, 4], for columns."""
    return np.array(pxr.UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0)).T


def luminous_intensity(prim: Any) -> NDArray[np.float64]:
    """Factor [3] on the profile of a normalised light, cd of R, G and B.

    By the schema of UsdLux: its luminance is intensity over the area of its sphere, which in each
    direction has the projected area π r².
    """
    radius = value(prim, "radius")
    luminance = value(prim, "intensity") / (4 * np.pi * radius**2)
    return luminance * np.pi * radius**2 * np.array(value(prim, "color"))


def read_lights(path: Path) -> list[ReadLight]:
    """The lights of a stage; γ is the angle from a light's -z, and C that from its +x to its +y.

    Raises:
        LumitreeError: the package usd-core is not installed.
    """
    from lumitree.exports.usd import load_usd

    pxr = load_usd()
    stage = pxr.Usd.Stage.Open(str(path))
    lights = []
    for prim in lights_of(pxr, stage):
        place, found = world_from_light(pxr, prim), profile_of(prim)
        factor = float(luminous_intensity(prim) @ LUMA)
        lights.append(
            ReadLight(
                place[:3, 3],
                lambda direction, turn=place[:3, :3], found=found, factor=factor: (
                    factor * found.at(y_up(direction @ turn))
                ),
            )
        )
    return lights
