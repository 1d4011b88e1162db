"""Frames, directions and similarity transforms (decisions D4, D8 and D11).

Symbols
    world       the frame of the luminaire's own file, or of the scene it is placed in
    proxy       the luminaire's local frame: its bounding box is centred at the origin and the
                box's longest half-side is 1; the field's unit of length
    direction   the direction of travel, camera to scene, unit length, everywhere
"""

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.errors import LumitreeError

Vector = TypeVar("Vector")

# A box this thin (local units) still has an inside that a ray can cross.
MIN_HALF_EXTENT = 1e-3
# Scales, sizes and coordinates whose squares and cubes are finite in float32.
MIN_SCALE, MAX_SCALE = 1e-12, 1e12


def towards_viewer(direction: Vector) -> Vector:
    """Direction at which spherical harmonics are evaluated, for a ray travelling along `direction`.

    Every spherical-harmonics evaluation of the project goes through this function (D4).
    """
    return -direction  # type: ignore[operator]


def proxy_box(
    box_min: ArrayLike, box_max: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Local frame of a luminaire with the given world bounding box (D8).

    Args:
        box_min: [3] smallest corner, world units.
        box_max: [3] largest corner, world units.

    Returns:
        `world_from_proxy` [4, 4], a translation and uniform scale, and the box's half extents
        [3] in local units, the longest of which is 1.
    """
    box_min = np.asarray(box_min, np.float64)
    box_max = np.asarray(box_max, np.float64)
    half = (box_max - box_min) / 2
    scale = half.max()
    if not np.isfinite(half).all() or scale <= 0:
        raise LumitreeError(
            f"the luminaire's bounding box {box_min.tolist()} .. {box_max.tolist()} is empty or "
            "not finite; expected shapes of positive size"
        )
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = (box_min + box_max) / 2
    return matrix, np.maximum(half / scale, MIN_HALF_EXTENT)


def rotation(axis: ArrayLike, degrees: float) -> NDArray[np.float64]:
    """Rotation matrix [3, 3] about `axis` [3] by `degrees`, right-handed (Rodrigues' formula)."""
    axis = np.asarray(axis, np.float64)
    length = np.linalg.norm(axis)
    if not np.isfinite(length) or length == 0:
        raise LumitreeError(
            f"rotation axis {axis.tolist()} has no direction; give a non-zero vector"
        )
    x, y, z = axis / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.deg2rad(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def similarity(
    rotation: ArrayLike, scale: float = 1.0, translation: ArrayLike = (0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """Matrix [4, 4] that rotates [3, 3], scales uniformly, then translates [3]."""
    matrix = np.eye(4)
    matrix[:3, :3] = scale * np.asarray(rotation)
    matrix[:3, 3] = translation
    return matrix


def similarity_scale(matrix: ArrayLike, what: str = "transform") -> float:
    """Uniform scale of a similarity transform [4, 4]; everything else is refused (D11).

    Raises:
        LumitreeError: the matrix is not finite, mirrors, shears or scales non-uniformly.
    """
    matrix = np.asarray(matrix, np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise LumitreeError(f"{what} is not a finite 4 x 4 matrix")
    linear = matrix[:3, :3]
    determinant = np.linalg.det(linear)
    if determinant <= 0:
        raise LumitreeError(
            f"{what} mirrors or flattens (determinant {determinant:.3g}); "
            "use rotation, translation and uniform scale only"
        )
    scale = float(np.cbrt(determinant))
    error = np.abs(linear.T @ linear / scale**2 - np.eye(3)).max()
    affine = np.abs(matrix[3] - [0, 0, 0, 1]).max()
    if error > 1e-4 or affine > 1e-6:
        raise LumitreeError(
            f"{what} shears or scales non-uniformly (by {error:.2g}); "
            "use rotation, translation and uniform scale only"
        )
    return scale


def check_placement(
    at: ArrayLike | None = None, size: float | None = None, rotate: ArrayLike = (0, 1, 0, 0)
) -> None:
    """Refuse a placement, as for `placement`, whose numbers are out of range."""
    if size is not None and not MIN_SCALE <= size <= MAX_SCALE:
        raise LumitreeError(
            f"size {size} is not a length of {MIN_SCALE:g} to {MAX_SCALE:g} scene units"
        )
    for name, values, count in (("at", at, 3), ("rotate", rotate, 4)):
        numbers = np.asarray([0.0] * count if values is None else values, np.float64)
        if numbers.shape != (count,) or not (np.abs(numbers) <= MAX_SCALE).all():
            raise LumitreeError(
                f"{name} {numbers.tolist()} is not {count} numbers of up to {MAX_SCALE:g}"
            )
    rotation(np.asarray(rotate, np.float64)[:3], 0)


def check_local_frame(half_extents: ArrayLike, world_from_proxy: ArrayLike) -> None:
    """Refuse what is no local frame (D8), or none that single precision can hold.

    Args:
        half_extents: [3] the proxy box in local units: at least 1e-3, and the longest 1.
        world_from_proxy: [4, 4] a similarity with a scale of 1e-12 to 1e12, which moves the box
            by at most as much along each axis.
    """
    half = np.asarray(half_extents, np.float64)
    if half.shape != (3,) or not (half >= MIN_HALF_EXTENT).all() or not abs(half.max() - 1) < 1e-6:
        raise LumitreeError(
            f"half_extents are {half.tolist()}; expected 3 lengths of {MIN_HALF_EXTENT} or more, "
            "the longest 1"
        )
    matrix = np.asarray(world_from_proxy, np.float64)
    # Before the determinant is taken, which might overflow.
    if matrix.shape != (4, 4) or not (np.abs(matrix) <= MAX_SCALE).all():
        raise LumitreeError(f"world_from_proxy is not 4 x 4 numbers of at most {MAX_SCALE:g}")
    scale = similarity_scale(matrix, "world_from_proxy")
    if scale < MIN_SCALE:
        raise LumitreeError(f"world_from_proxy has the scale {scale:g}; expected {MIN_SCALE:g} up")


def placement(
    world_from_proxy: ArrayLike,
    *,
    at: ArrayLike | None = None,
    size: float | None = None,
    rotate: ArrayLike = (0.0, 1.0, 0.0, 0.0),
) -> NDArray[np.float64]:
    """`scene_from_proxy` [4, 4] that puts a luminaire into a scene.

    Args:
        world_from_proxy: [4, 4] the luminaire's own frame; used for what is left out.
        at: [3] where the centre of the bounding box goes, scene units.
        size: largest side of the bounding box, scene units.
        rotate: [4] axis x, y, z and angle in degrees, about the centre.
    """
    check_placement(at, size, rotate)
    own = np.asarray(world_from_proxy, np.float64)
    rotate = np.asarray(rotate, np.float64)
    scale = similarity_scale(own) if size is None else size / 2
    turn = rotation(rotate[:3], rotate[3]) @ (own[:3, :3] / similarity_scale(own))
    return similarity(turn, scale, own[:3, 3] if at is None else at)
