"""The numbers of an OBJ file's vertices, texture coordinates and normals."""

import re
from collections.abc import Callable, Sequence

import numpy as np

from lumitree.core.images import linear_from_srgb
from lumitree.errors import LumitreeError, shown
from lumitree.lamp.meshes import Floats

# Beyond this, squares of lengths leave the range of single precision.
MAX_COORDINATE = 1e9
# Numbers of a line after which all others are not read.
_MAX_NUMBERS = 16
# If a vertex colour is above the first, all are in [0, 255]; above the second is no rounding.
_BYTES_ABOVE, _CLIPPED_ABOVE = 2.0, 1.01
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")


def read_table(
    lines: list[bytes], key: bytes, fewest: int, error: Callable[[int, str], LumitreeError]
) -> tuple[Floats, bool]:
    """The numbers of lines that begin with `key`, and whether they have decimal commas.

    The array is [N, W], W at least `fewest`, which each line must have; NaN where a line has fewer
    numbers than others. `error` takes the number of a line and a message.
    """
    if not lines:
        return np.zeros((0, fewest)), False
    values, commas = _uniform(lines, key, fewest), False
    if values is None:
        values, commas = _ragged(lines, key, fewest, error)
    bad = (np.abs(values) > MAX_COORDINATE).any(axis=1) | np.isnan(values[:, :fewest]).any(axis=1)
    if bad.any():
        raise error(int(bad.argmax()), f"a value is not finite or beyond {MAX_COORDINATE:g}")
    return values, commas


def vertex_colours(rows: Floats) -> tuple[Floats | None, list[str]]:
    """Linear RGB of vertices [V, 3], and a list of what is left out of their lines.

    After x, y and z a line [V, W] may have a weight, a colour, or both: `w`, `r g b`, `w r g b`.
    Where each fourth of seven numbers is not 1, the seventh is an opacity: `r g b a`. Colours are
    sRGB-encoded, in [0, 1] or in [0, 255]. White where a line has none; None where no line has one.
    """
    count = (~np.isnan(rows)).sum(axis=1)
    left_out = []
    four, six, seven = count == 4, count == 6, count == 7
    weighted = bool(seven.any() and (rows[seven, 3] == 1).all())
    weights = rows[four, 3] if four.any() else np.ones(0)
    if (weights != 1).any():
        left_out.append("weights of vertices")
    if seven.any() and not weighted and (rows[seven, 6] != 1).any():
        left_out.append("opacities of vertices")
    if ((count == 5) | (count > 7)).any():
        left_out.append("what follows the positions of vertices with 5 or more than 7 numbers")
    coloured = six | seven
    if not coloured.any():
        return None, left_out
    encoded = np.ones((len(rows), 3))
    encoded[six] = rows[six, 3:6]
    if seven.any():
        encoded[seven] = rows[seven, 4:7] if weighted else rows[seven, 3:6]
    if encoded.max() > _BYTES_ABOVE:
        encoded[coloured] /= 255
    if encoded.min() < 0 or encoded.max() > _CLIPPED_ABOVE:
        left_out.append("vertex colours beyond 0 to 1, and 0 to 255 (clipped)")
    return _linear(np.clip(encoded, 0, 1)), left_out


def painted_colours(blocks: Sequence[bytes], count: int) -> Floats | None:
    """Linear RGB [count, 3] of ZBrush's `#MRGB` comments; None if they are not as many.

    Each vertex has eight hexadecimal digits: a mask, which is not used, R, G and B, sRGB-encoded.
    """
    try:
        values = np.frombuffer(bytes.fromhex(b"".join(blocks).decode("ascii")), np.uint8)
    except ValueError:
        return None
    if len(values) != 4 * count:
        return None
    return _linear(values.reshape(-1, 4)[:, 1:] / 255)


def readable(text: bytes) -> str:
    """Text of a file that does not say how it is encoded, without control characters."""
    try:
        decoded = text.decode("utf-8")
    except UnicodeDecodeError:
        decoded = text.decode("latin-1")
    return shown(decoded, len(decoded))


def first_failing(words: Sequence[bytes], convert: Callable[[bytes], object]) -> int:
    """Index of the first word for which `convert` raises ValueError or OverflowError."""
    for at, word in enumerate(words):
        try:
            convert(word)
        except (ValueError, OverflowError):
            return at
    raise AssertionError("no word fails")


def with_point(word: str) -> str:
    """A number with a decimal comma as one with a point; anything else unchanged."""
    return word.replace(",", ".") if _DECIMAL_COMMA.fullmatch(word) else word


def _linear(encoded: Floats) -> Floats:
    return linear_from_srgb(encoded).astype(np.float64)


def _uniform(lines: list[bytes], key: bytes, fewest: int) -> Floats | None:
    """The numbers of lines that are all alike; None if they are not."""
    words = b" ".join(lines).split()
    width = len(words) // len(lines) - 1
    if not fewest <= width <= _MAX_NUMBERS or len(words) != len(lines) * (width + 1):
        return None
    if set(words[:: width + 1]) != {key}:
        return None
    del words[:: width + 1]
    try:
        values = np.array(list(map(float, words))).reshape(-1, width)
    except ValueError:
        return None
    return None if np.isnan(values).any() else values


def _ragged(
    lines: list[bytes], key: bytes, fewest: int, error: Callable[[int, str], LumitreeError]
) -> tuple[Floats, bool]:
    """The numbers of any lines, NaN where there is none, and whether they have decimal commas."""
    rows = [_row(line, key, fewest, at, error) for at, line in enumerate(lines)]
    commas = not any(b"." in word for row in rows for word in row)
    commas &= any(b"," in word for row in rows for word in row)
    values = np.full((len(rows), max(map(len, rows))), np.nan)
    for at, row in enumerate(rows):
        for column, word in enumerate(row):
            try:
                values[at, column] = float(with_point(readable(word)) if commas else word)
            except ValueError:
                if column >= fewest:
                    break
                advice = "; write decimal points in all numbers" if b"," in word else ""
                found = shown(readable(word))
                raise error(at, f"{found!r} is not a number{advice}") from None
    return values, commas


def _row(
    line: bytes, key: bytes, fewest: int, at: int, error: Callable[[int, str], LumitreeError]
) -> list[bytes]:
    """The words after the key of a line that may end in a comment."""
    row = line.partition(b"#")[0].split()
    if row[:1] != [key]:
        raise error(at, f"a line begins with {shown(readable(line.split()[0]))!r}")
    if len(row) <= fewest:
        advice = ", separated by spaces" if b"," in line else ""
        found = f"{len(row) - 1} numbers after {readable(key)!r}"
        raise error(at, f"{found}; expected {fewest}{advice}")
    return row[1 : _MAX_NUMBERS + 1]
