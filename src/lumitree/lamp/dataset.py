"""A dataset: views of one luminaire as OpenEXR files beside a typed manifest.

    DATASET/manifest.json       settings and poses, see `Manifest`
    DATASET/view_000001.exr     channels R, G, B (radiance), geometric, straight_through (opacity)

Poses follow NeRF's convention (camera x right, y up, looking along -z) in the luminaire's local
frame. Cameras are orthographic; their images are square and have the same width.

The visual hull is the region that the views do not show to be empty. The *footprint* of a cell is
the set of pixels of a view onto which it projects.
"""

import dataclasses
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.arguments import MAX_PIXELS_A_SIDE
from lumitree.core.files import write_json
from lumitree.core.frames import (
    FIRST_TEST_INDEX,
    MAX_SCALE,
    LocalFrame,
    Matrix,
    file_members,
    with_frame,
)
from lumitree.core.images import max_radiance, read_exr, write_exr
from lumitree.core.reading import label, parse_json, read_bytes
from lumitree.core.tables import check_version, converted, object_of
from lumitree.errors import LumitreeError, shown

Split = Literal["train", "test"]
OpacityKind = Literal["straight_through", "geometric"]
OPACITY_KINDS: tuple[OpacityKind, ...] = get_args(OpacityKind)
VERSION = 1
MANIFEST = "manifest.json"
# Patterns of the files in a dataset's folder.
DATASET_FILES = (MANIFEST, "view_*.exr")
# The Halton indices of training views stay below the indices of test views.
MAX_VIEWS = FIRST_TEST_INDEX - 1
# Keys of a `Frame` in the file.
_FRAME_KEYS = ("file", "halton_index", "proxy_from_camera")
# Limit of a file's name in most file systems.
_MAX_NAME_BYTES = 255
# A view takes about 600 bytes.
_MAX_MANIFEST_BYTES = 1 << 28


@dataclasses.dataclass(frozen=True)
class Frame:
    """One view.

    Attributes:
        file: name of its file.
        halton_index: index of its direction, see `core.frames.halton_direction`.
        local_from_camera: 4 rows of 4.
    """

    file: str
    halton_index: int
    local_from_camera: Matrix

    @classmethod
    def of_table(cls, values: object, name: str) -> "Frame":
        """The view of a table of a manifest."""
        keys = dict(zip(_FRAME_KEYS, ("file", "halton_index", "local_from_camera"), strict=True))
        if isinstance(values, dict):
            values = {keys.get(key, key): value for key, value in values.items()}
        return object_of(values, Frame, name)

    @property
    def pose(self) -> NDArray[np.float64]:
        """`local_from_camera` as an array [4, 4]."""
        return np.array(self.local_from_camera)


@dataclasses.dataclass(frozen=True)
class Manifest:
    """Subject of a dataset, and how it was captured.

    Attributes:
        luminaire: name or file name of the luminaire; kept as a `core.reading.label`.
        fingerprint: identifies the luminaire's content; a capture resumes only if it matches.
        split: "train" or "test".
        resolution: pixels per side, at most 16384.
        spp: paths per pixel.
        path_depth: largest number of bounces of a path.
        half_width: half the side of every view, local units.
        local_frame: local frame of the luminaire.
        frames: the views.

    Raises:
        LumitreeError: a number is out of range, or a file name is repeated or not a plain name.
    """

    luminaire: str
    fingerprint: str
    split: Split
    resolution: int
    spp: int
    path_depth: int
    half_width: float
    local_frame: LocalFrame
    frames: tuple[Frame, ...]
    version: int = VERSION

    def __post_init__(self) -> None:
        object.__setattr__(self, "luminaire", label(self.luminaire))
        if not 1 <= self.resolution <= MAX_PIXELS_A_SIDE:
            raise LumitreeError(
                f"resolution is {self.resolution}; expected 1 to {MAX_PIXELS_A_SIDE} pixels per "
                "side"
            )
        if not 0 < self.half_width <= MAX_SCALE:
            raise LumitreeError(f"half_width is {self.half_width}; expected a positive length")
        files = {frame.file for frame in self.frames}
        if not files or len(files) < len(self.frames):
            raise LumitreeError("a dataset needs at least one view, and a file for each")
        for frame in self.frames:
            if frame.file in ("", "..") or Path(frame.file).name != frame.file:
                raise LumitreeError(f"view {shown(frame.file)!r} lies outside the dataset's folder")
            if len(os.fsencode(frame.file)) > _MAX_NAME_BYTES:
                raise LumitreeError(f"view {shown(frame.file)!r} has too long a name for a file")
            if frame.pose.shape != (4, 4) or not (np.abs(frame.pose) <= MAX_SCALE).all():
                raise LumitreeError(
                    f"pose of {frame.file} is not 4 x 4 numbers of at most {MAX_SCALE:g}"
                )


@dataclasses.dataclass(frozen=True)
class View:
    """Pixels of one view: radiance [H, W, 3] and the two opacities [H, W] in [0, 1]."""

    frame: Frame
    radiance: NDArray[np.float32]
    geometric: NDArray[np.float32]
    straight_through: NDArray[np.float32]

    def opacity(self, kind: OpacityKind) -> NDArray[np.float32]:
        """The opacity of the chosen kind."""
        return self.geometric if kind == "geometric" else self.straight_through


@dataclasses.dataclass(frozen=True)
class Dataset:
    """A folder of views; pixels are read only when they are needed."""

    folder: Path
    manifest: Manifest

    @staticmethod
    def open(folder: str | os.PathLike[str]) -> "Dataset":
        """Read a manifest.

        Raises:
            LumitreeError: the manifest is missing or damaged.
        """
        folder = Path(folder)
        path = folder / MANIFEST
        if not os.path.isfile(path):
            raise LumitreeError(
                f"{folder} holds no {MANIFEST}; expected a dataset made by 'lumitree capture'"
            )
        content = read_bytes(path, "a manifest", _MAX_MANIFEST_BYTES)
        try:
            return Dataset(folder, _parse(parse_json(content)))
        except LumitreeError as error:
            raise LumitreeError(
                f"{path} is not a valid manifest: {error}; capture the dataset again"
            ) from None

    def save_manifest(self) -> None:
        """Write the manifest, atomically."""
        members = file_members(self.manifest)
        members["frames"] = [
            dict(zip(_FRAME_KEYS, dataclasses.astuple(frame), strict=True))
            for frame in self.manifest.frames
        ]
        write_json(self.folder / MANIFEST, members)

    def missing(self) -> list[Frame]:
        """Views that have not been captured yet."""
        return [frame for frame in self.manifest.frames if not (self.folder / frame.file).exists()]

    def write(self, view: View) -> None:
        """Write the pixels of one view, atomically."""
        channels = {
            "RGB": view.radiance,
            "geometric": view.geometric,
            "straight_through": view.straight_through,
        }
        write_exr(self.folder / view.frame.file, channels)

    def views(self) -> Iterator[View]:
        """Read the views one by one.

        Raises:
            LumitreeError: views are missing or damaged, or their size is not the manifest's.
        """
        missing = self.missing()
        if missing:
            total = len(self.manifest.frames)
            raise LumitreeError(
                f"{self.folder} is incomplete: {len(missing)} of {total} views are missing; run "
                "the same 'lumitree capture' again to finish it"
            )
        for frame in self.manifest.frames:
            yield self._read(frame)

    def max_radiance(self, views: Iterable[View]) -> float:
        """L_max of views of this dataset.

        Raises:
            LumitreeError: the views are black.
        """
        value = max_radiance(view.radiance for view in views)
        if not value > 0:
            raise LumitreeError(
                f"every view of {self.folder} is black (fewer than one pixel in 10000 is lit); "
                "does the luminaire emit?"
            )
        return value

    def _read(self, frame: Frame) -> View:
        path = self.folder / frame.file
        try:
            planes = read_exr(path)
        except LumitreeError as error:
            raise LumitreeError(
                f"{error}; remove it, and the same capture makes it again"
            ) from None
        size = (self.manifest.resolution, self.manifest.resolution)
        expected = {"RGB": (*size, 3), "geometric": size, "straight_through": size}
        found = {name: plane.shape for name, plane in planes.items()}
        if any(found.get(name) != shape for name, shape in expected.items()):
            raise LumitreeError(f"{path} holds channels {found}; expected {expected}")
        return View(frame, planes["RGB"], planes["geometric"], planes["straight_through"])


def _parse(value: object) -> Manifest:
    # Checked first, because files of other versions may have other members.
    table = check_version(value, VERSION)
    return converted(with_frame(table, "local_frame"), Manifest)


def visual_hull(
    views: Iterable[tuple[NDArray[np.float64], NDArray[np.bool_]]],
    half_width: float,
    half_extents: ArrayLike,
    resolution: int,
) -> NDArray[np.bool_]:
    """Cells [nx, ny, nz] of a box that no view shows to be empty.

    A cell is removed if in some view all pixels of its footprint, and of a margin of one pixel
    around it, are background. No cell that a captured ray hit is removed.

    Args:
        views: pairs of `local_from_camera` [4, 4] and mask [H, H], true where a ray hit anything.
        half_width: half the side of the views, local units.
        half_extents: [3] half the sides of the box, local units.
        resolution: number of cells along 2 local units.
    """
    half = np.asarray(half_extents, np.float64)
    shape = np.maximum(np.ceil(half * resolution), 1).astype(int)
    # Only the remaining cells are projected, so each view costs less than the one before.
    alive = np.stack(np.unravel_index(np.arange(shape.prod()), shape)).astype(np.int16)
    for pose, mask in views:
        size = mask.shape[0]
        # Pixels per local unit; rows are counted downwards, against the camera's y.
        scale = size / (2 * half_width)
        row, row_reach = _footprint(alive, shape, half, -scale * pose[:, 1], pose, size)
        column, column_reach = _footprint(alive, shape, half, scale * pose[:, 0], pose, size)
        near = _max_filter(_max_filter(mask, row_reach).T, column_reach).T
        # A cell outside of the image is kept.
        kept = (row < 0) | (row >= size) | (column < 0) | (column >= size)
        kept[~kept] = near[row[~kept], column[~kept]]
        alive = alive[:, kept]
    cells = np.zeros(shape, bool)
    cells[tuple(alive)] = True
    return cells


def _footprint(
    cells: NDArray[np.int16],
    shape: NDArray[np.int_],
    half: NDArray[np.float64],
    slope: NDArray[np.float64],
    pose: NDArray[np.float64],
    size: int,
) -> tuple[NDArray[np.int32], int]:
    """Projection of cells onto one axis of a view, with the pose `local_from_camera`.

    Args:
        cells: [3, N] indices in a grid of `shape` over the box of half extents `half`.
        slope: [4] pixels per local unit along x, y and z; the last element is not used.

    Returns:
        Pixel [N] of each cell's centre, and half the width of its footprint with the margin, in
        pixels.
    """
    pixel = np.full(cells.shape[1], size / 2 - slope[:3] @ pose[:3, 3], np.float32)
    for index, count, extent, factor in zip(cells, shape, half, slope[:3], strict=True):
        centres = ((np.arange(count) + 0.5) / count * 2 - 1) * extent * factor
        pixel += centres.astype(np.float32)[index]
    reach = int(np.ceil(np.abs(slope[:3]) @ (half / shape))) + 1
    return np.floor(pixel).astype(np.int32), reach


def _max_filter(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Whether any pixel within `reach` rows is true, from differences of cumulative sums."""
    sums = np.cumsum(mask, axis=0, dtype=np.int32)
    sums = np.concatenate([np.zeros_like(sums[:1]), sums])
    rows = np.arange(mask.shape[0])
    return sums[np.minimum(rows + reach + 1, len(rows))] > sums[np.maximum(rows - reach, 0)]
