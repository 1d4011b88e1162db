"""The corners of an OBJ file's faces."""

import dataclasses

import numpy as np

from lumitree.lamp.importers.obj.numbers import first_failing
from lumitree.lamp.importers.topology import Indices


@dataclasses.dataclass(frozen=True)
class Corners:
    """Distinct corners as a file writes them, such as 1/2/3.

    Attributes:
        indices: [S, 3] position, texture coordinate and normal, from 0; -1 where the last two are
            missing.
        absent: [S, 2] whether a texture coordinate, and a normal, is named that is not there.
        wrong: the first corner that cannot be read; None if there is none.
        reason: why it cannot.
    """

    indices: Indices
    absent: np.ndarray
    wrong: int | None = None
    reason: str = ""


def read_corners(spellings: list[bytes], counts: tuple[int, int, int]) -> Corners:
    """Read distinct corners of a file with so many positions, texture coordinates and normals."""
    fields = [word.split(b"/") for word in spellings]
    read = np.full((len(fields), 3), -1, np.int64)
    absent = np.zeros((len(fields), 3), bool)
    for column in range(3):
        words = [row[column] if len(row) > column else b"" for row in fields]
        try:
            read[:, column] = [_index(word) for word in words]
        except (ValueError, OverflowError):
            at = first_failing(words, _index)
            reason = "is not of the form 1, 1/2, 1//3 or 1/2/3"
            return Corners(read, absent[:, 1:], at, reason)
        given = np.array([bool(word) for word in words])
        absent[:, column] = (read[:, column] < 0) | (read[:, column] >= counts[column])
        if column > 0:
            read[absent[:, column], column] = -1
            absent[:, column] &= given
        elif absent[:, 0].any():
            reason = f"names a position that is not there; the file has {counts[0]} positions"
            return Corners(read, absent[:, 1:], int(absent[:, 0].argmax()), reason)
    too_long = [at for at, row in enumerate(fields) if len(row) > 3]
    if too_long:
        return Corners(read, absent[:, 1:], too_long[0], "has more than three indices")
    return Corners(read, absent[:, 1:])


def _index(word: bytes) -> np.int64:
    """Index of a corner, counted from 0; -1 for none."""
    return np.int64(int(word) - 1 if word else -1)
