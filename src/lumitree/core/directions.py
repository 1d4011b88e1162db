"""Quasi-random directions and the orthographic views taken along them."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Test views start at this Halton index, so that no training view is among them.
FIRST_TEST_INDEX = 100_001


def radical_inverse(index: int, base: int) -> float:
    """Van der Corput radical inverse of `index` >= 0 in `base`, in [0, 1)."""
    result, digit = 0.0, 1.0 / base
    while index > 0:
        index, remainder = divmod(index, base)
        result += remainder * digit
        digit /= base
    return result


def halton_direction(index: int) -> NDArray[np.float64]:
    """Unit direction [3] of the Halton(2, 3) point `index`, uniform on the sphere."""
    z = 1 - 2 * radical_inverse(index, 2)
    azimuth = 2 * np.pi * radical_inverse(index, 3)
    radius = np.sqrt(max(0.0, 1 - z * z))
    return np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), z])


def view_pose(index: int, distance: float) -> NDArray[np.float64]:
    """Pose of Halton view `index`, see `pose_towards`; up is y, or z if the view is along y."""
    backward = halton_direction(index)
    up = [0.0, 1.0, 0.0] if abs(backward[1]) < 0.99 else [0.0, 0.0, 1.0]
    return pose_towards(backward, up, distance)


def pose_towards(backward: ArrayLike, up: ArrayLike, distance: float) -> NDArray[np.float64]:
    """Pose of a camera at `distance` in the direction `backward`, looking at the origin.

    Args:
        backward: [3] unit vector from the origin to the camera.
        up: [3] direction that is upwards in the image; not parallel to `backward`.
        distance: local units.

    Returns:
        `local_from_camera` [4, 4] in the convention of NeRF: x right, y up, the camera looks
        along its own -z.
    """
    backward = np.asarray(backward, np.float64)
    right = np.cross(np.asarray(up, np.float64), backward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(backward, right), backward
    pose[:3, 3] = distance * backward
    return pose


def orthographic_rays(
    pose: NDArray[np.float64], half_width: float, resolution: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Rays through the pixel centres of a square orthographic view.

    Args:
        pose: `local_from_camera` [4, 4].
        half_width: half the side of the image, local units.
        resolution: pixels per side; row 0 is the top.

    Returns:
        Origins [resolution, resolution, 3] and the common direction of travel [3].
    """
    offsets = ((np.arange(resolution) + 0.5) / resolution * 2 - 1) * half_width
    right, up, backward, position = (pose[:3, column] for column in range(4))
    origins = position + offsets[None, :, None] * right - offsets[:, None, None] * up
    return origins.astype(np.float32), (-backward).astype(np.float32)
