"""Lamps far from the origin of their file, whose coordinates float32 numbers are too coarse for."""

import warnings

import numpy as np
from numpy.typing import NDArray

from lumitree.core.frames import float32_step, is_far
from lumitree.errors import LumitreeWarning, shown_names


def origin_near(box: NDArray[np.float64], tolerance: float = 1) -> NDArray[np.float64]:
    """[3] an origin near a box [2, 3], if its coordinates are too coarse in float32; else 0.

    They may be `tolerance` times as coarse.
    """
    # Not even the size of a damaged lamp need be finite.
    with np.errstate(over="ignore", invalid="ignore"):
        size = tolerance * np.ptp(box, axis=0).max()
    if not np.isfinite(box).all() or not is_far(box, size):
        return np.zeros(3)
    # Exact in float32, so that vertices of mesh files are moved exactly.
    return box.mean(axis=0).astype(np.float32).astype(np.float64)


def warn_of_far_meshes(
    name: str,
    size: float,
    centre: NDArray[np.float64],
    mesh_files: list[tuple[str, NDArray[np.float64]]],
) -> None:
    """Warn of mesh files with vertices so far from their own origin that float32 rounds them.

    Size and centre are of the lamp's bounding box, in the frame of its scene, where the origins of
    the files are too.
    """
    # A mesh is about where the lamp is.
    reach = {file: place - centre for file, place in mesh_files}
    far = [file for file, offset in reach.items() if is_far(offset, size)]
    if far:
        step = max(float32_step(reach[file]) for file in far)
        warnings.warn(
            f"{name}: vertices of {shown_names(far)} are so far from the origin of their file that "
            f"Mitsuba rounds them to multiples of {step:.2g}, {step / size:.2%} of the lamp's "
            "size; move the mesh to the origin of its file and place it by to_world",
            LumitreeWarning,
            stacklevel=4,
        )
