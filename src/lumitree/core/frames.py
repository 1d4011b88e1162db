"""Frames, directions, similarity transforms, and orthographic views from quasi-random directions.

Symbols
    world       the frame of the luminaire's file
    local       the luminaire's local frame: its bounding box is centred at the origin and the
                box's longest half-side is 1; the field's unit of length
    scene       the frame of the scene that the luminaire is placed in
    direction   direction of travel, unit length: of a camera ray from the camera to the scene, of
                light from the lamp
"""

import dataclasses
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.tables import Table, check_table, converted
from lumitree.errors import LumitreeError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Vector = TypeVar("Vector")
Row = tuple[float, float, float, float]
Matrix = tuple[Row, Row, Row, Row]

# Half extent of the thinnest box, local units: rays still cross its interior.
MIN_HALF_EXTENT = 1e-3
# Range of scales, sizes and coordinates. Their squares and cubes are finite in float32.
MIN_SCALE, MAX_SCALE = 1e-12, 1e12
# Coordinates are far from the origin where float32 numbers are farther apart than this part of a
# lamp's size.
_COARSE = 1e-4
# Keys of `half_extents` and `world_from_local` in assets, datasets and runs.
FRAME_KEYS = ("half_extents", "world_from_proxy")


def towards_viewer(direction: Vector) -> Vector:
    """Direction at which spherical harmonics are evaluated, for a ray travelling along `direction`.

    All code that evaluates spherical harmonics calls this function.
    """
    return -direction  # type: ignore[operator]


def from_viewer(direction: Vector) -> Vector:
    """Direction of the camera ray that meets light which travels along `direction`.

    The inverse of `towards_viewer`.
    """
    return -direction  # type: ignore[operator]


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


def rows_of(matrix: ArrayLike) -> Matrix:
    """The rows of a matrix [4, 4], for files."""
    first, second, third, fourth = (
        (x, y, z, w) for x, y, z, w in np.asarray(matrix, np.float64).reshape(4, 4).tolist()
    )
    return first, second, third, fourth


def similarity_scale(matrix: ArrayLike, what: str = "transform") -> float:
    """Uniform scale of a similarity transform [4, 4]; everything else is refused.

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


def float32_step(coordinates: ArrayLike) -> float:
    """Distance of neighbouring float32 numbers at the largest of some coordinates."""
    largest = np.abs(np.asarray(coordinates, np.float64)).max(initial=0.0)
    return float(np.spacing(np.float32(min(largest, np.finfo(np.float32).max / 2))))


def is_far(coordinates: ArrayLike, size: float) -> bool:
    """Whether float32 coordinates are too coarse for a lamp of this size.

    Args:
        coordinates: of any shape, the lamp's unit of length.
        size: longest side of its bounding box.
    """
    return float32_step(coordinates) > _COARSE * size


def check_placement(
    at: ArrayLike | None = None, size: float | None = None, rotate: ArrayLike = (0, 1, 0, 0)
) -> None:
    """Refuse numbers that are out of range; arguments as for `LocalFrame.placed`."""
    number = isinstance(size, int | float | np.number)
    if size is not None and not (number and MIN_SCALE <= size <= MAX_SCALE):
        raise LumitreeError(
            f"size {size if number else repr(size)} is not a length of {MIN_SCALE:g} to "
            f"{MAX_SCALE:g} scene units"
        )
    for name, values, count in (("at", at, 3), ("rotate", rotate, 4)):
        try:
            numbers = np.asarray([0.0] * count if values is None else values, np.float64)
        except (TypeError, ValueError):
            numbers = np.asarray(repr(values))
        if numbers.shape != (count,) or not (np.abs(numbers) <= MAX_SCALE).all():
            raise LumitreeError(
                f"{name} {numbers.tolist()} is not {count} numbers of up to {MAX_SCALE:g}"
            )
    rotation(np.asarray(rotate, np.float64)[:3], 0)


@dataclasses.dataclass(frozen=True, eq=False)
class LocalFrame:
    """Local frame of a luminaire: a frame centred on its bounding box, scaled to the box.

    The unit of length is half the longest side of the box. "World" is the frame of the luminaire's
    file. The arrays are copied, and cannot be written to.

    Attributes:
        half_extents: [3] half the sides of the bounding box in local units: 1e-3 or more, the
            longest 1.
        world_from_local: [4, 4] similarity transform. Its scale is 1e-12 to 1e12; no entry is
            above 1e12 in absolute value.

    Raises:
        LumitreeError: an array has another shape, or a number is out of range.
    """

    half_extents: NDArray[np.float64]
    world_from_local: NDArray[np.float64]

    def __post_init__(self) -> None:
        half = np.array(self.half_extents, np.float64)
        matrix = np.array(self.world_from_local, np.float64)
        half.flags.writeable = matrix.flags.writeable = False
        object.__setattr__(self, "half_extents", half)
        object.__setattr__(self, "world_from_local", matrix)
        thick = half.shape == (3,) and (half >= MIN_HALF_EXTENT).all()
        if not thick or not abs(half.max() - 1) < 1e-6:
            raise LumitreeError(
                f"half_extents are {half.tolist()}; expected 3 lengths of {MIN_HALF_EXTENT} or "
                "more, the longest 1"
            )
        what = "the matrix of the local frame"
        # Before the determinant is taken, which might overflow.
        if matrix.shape != (4, 4) or not (np.abs(matrix) <= MAX_SCALE).all():
            raise LumitreeError(f"{what} is not 4 x 4 numbers of at most {MAX_SCALE:g}")
        scale = similarity_scale(matrix, what)
        if scale < MIN_SCALE:
            raise LumitreeError(f"{what} has the scale {scale:g}; expected {MIN_SCALE:g} or more")

    @staticmethod
    def of_box(box_min: ArrayLike, box_max: ArrayLike) -> "LocalFrame":
        """Local frame of a luminaire with the given bounding box.

        Args:
            box_min: [3] smallest corner, world units.
            box_max: [3] largest corner, world units.

        Raises:
            LumitreeError: the box is empty or not finite.
        """
        box_min = np.asarray(box_min, np.float64)
        box_max = np.asarray(box_max, np.float64)
        half = (box_max - box_min) / 2
        scale = half.max()
        if not np.isfinite(half).all() or scale <= 0:
            raise LumitreeError(
                f"the luminaire's bounding box {box_min.tolist()} .. {box_max.tolist()} is empty "
                "or not finite; expected shapes of positive size"
            )
        matrix = similarity(np.eye(3), scale, (box_min + box_max) / 2)
        return LocalFrame(np.maximum(half / scale, MIN_HALF_EXTENT), matrix)

    def members(self) -> Table:
        """The frame as members of a file, by `FRAME_KEYS`."""
        arrays = (self.half_extents, self.world_from_local)
        return {key: array.tolist() for key, array in zip(FRAME_KEYS, arrays, strict=True)}

    @property
    def scale(self) -> np.float64:
        """Length of a local unit in world units."""
        # Unlike a cube root of the determinant, this is exact for a matrix without rotation.
        return np.float64(np.linalg.norm(self.world_from_local[:3, 0]))

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Rotation [3, 3] of `world_from_local`."""
        return self.world_from_local[:3, :3] / self.scale

    @property
    def centre(self) -> NDArray[np.float64]:
        """[3] centre of the bounding box, world units."""
        return self.world_from_local[:3, 3]

    @property
    def size(self) -> NDArray[np.float64]:
        """[3] sides of the bounding box, world units."""
        return 2 * self.half_extents * self.scale

    @property
    def is_far(self) -> bool:
        """Whether the lamp is too far from the origin of its file for float32 coordinates."""
        return is_far(self.centre, self.size.max())

    def moved(self, offset: ArrayLike) -> "LocalFrame":
        """The local frame of the luminaire moved by [3] `offset`, world units."""
        return LocalFrame(
            self.half_extents,
            similarity(np.eye(3), 1.0, np.asarray(offset, np.float64)) @ self.world_from_local,
        )

    def scaled(self, factor: float) -> "LocalFrame":
        """The local frame of the luminaire with all lengths of its file times a factor."""
        return LocalFrame(self.half_extents, similarity(np.eye(3), factor) @ self.world_from_local)

    @property
    def local_from_world(self) -> NDArray[np.float64]:
        """[4, 4] inverse of `world_from_local`."""
        return np.asarray(np.linalg.inv(self.world_from_local), np.float64)

    def placed(
        self,
        *,
        at: ArrayLike | None = None,
        size: float | None = None,
        rotate: ArrayLike = (0.0, 1.0, 0.0, 0.0),
    ) -> NDArray[np.float64]:
        """`scene_from_local` [4, 4] that places the luminaire in a scene.

        Args:
            at: [3] where the centre of the bounding box goes, scene units; default: its centre.
            size: largest side of the bounding box, scene units; default: its own size.
            rotate: [4] axis x, y, z and angle in degrees, about the centre.

        Raises:
            LumitreeError: a number is out of range, see `check_placement`.
        """
        check_placement(at, size, rotate)
        rotate = np.asarray(rotate, np.float64)
        return similarity(
            rotation(rotate[:3], rotate[3]) @ self.rotation,
            self.scale if size is None else size / 2,
            self.centre if at is None else at,
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LocalFrame) and self.members() == other.members()

    def __hash__(self) -> int:
        return hash((self.half_extents.tobytes(), self.world_from_local.tobytes()))


@dataclasses.dataclass(frozen=True)
class _Members:
    half_extents: tuple[float, float, float]
    world_from_proxy: Matrix


def with_frame(table: object, name: str) -> Table:
    """The table of a file with its local frame as one member, in place of `FRAME_KEYS`."""
    table = check_table(table)
    given = converted({key: table[key] for key in FRAME_KEYS if key in table}, _Members)
    frame = LocalFrame(np.array(given.half_extents), np.array(given.world_from_proxy))
    return {key: table[key] for key in table if key not in FRAME_KEYS} | {name: frame}


def file_members(record: "DataclassInstance") -> Table:
    """Members of a dataclass for a JSON file, the inverse of `with_frame`."""
    members: Table = {}
    for name, value in dataclasses.asdict(record).items():
        attribute = getattr(record, name)
        members |= attribute.members() if isinstance(attribute, LocalFrame) else {name: value}
    return members


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
