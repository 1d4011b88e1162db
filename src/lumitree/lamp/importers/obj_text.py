"""The text of an OBJ file as arrays."""

import dataclasses
import re
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.core.images import linear_from_srgb
from lumitree.core.reading import read_bytes
from lumitree.core.text import in_utf8
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.lamp.importers.model_files import MAX_MODEL_BYTES
from lumitree.lamp.importers.polygons import MAX_CORNERS
from lumitree.lamp.importers.topology import Indices
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


# Faces are grouped by material alone.
_GROUPS = (b"g", b"o", b"mg")
_FREE_FORM = (b"vp", b"cstype", b"deg", b"bmat", b"step", b"curv", b"curv2", b"surf", b"parm")
_FREE_FORM += (b"trim", b"hole", b"scrv", b"sp", b"end", b"con", b"bzp", b"bsp", b"cdc", b"cdp")
_LEFT_OUT: dict[bytes, str] = {b"l": "lines", b"p": "points"}
_LEFT_OUT |= dict.fromkeys(_FREE_FORM, "free-form curves and surfaces (export polygons)")


@dataclasses.dataclass(frozen=True)
class ObjFile:
    """Everything in an OBJ file that lumitree reads; indices begin at 0.

    Attributes:
        path: of the file.
        positions: [V, 3].
        colours: [V, 3] linear RGB of the vertices; None for none.
        uv: [T, 2], v = 0 at an image's last row, as the file has it.
        normals: [N, 3], of any length.
        corners: [C, 3] position, texture coordinate and normal of every polygon's corners, one
            polygon after the other; -1 where the last two are missing.
        sizes: [P] corners of each polygon.
        material: [P] number in `materials`.
        smoothing: [P] smoothing group; 0 for none; 1 throughout in a file that names none.
        smooths: whether the file names any smoothing group.
        materials: names; "" for what comes before any `usemtl`.
        libraries: rest of every `mtllib` line.
    """

    path: Path
    positions: Floats
    colours: Floats | None
    uv: Floats
    normals: Floats
    corners: Indices
    sizes: Indices
    material: Indices
    smoothing: Indices
    smooths: bool
    materials: tuple[str, ...]
    libraries: tuple[str, ...]


def parse_obj(path: Path) -> ObjFile:
    """Read an OBJ file of at most 512 MiB with at least one face."""
    return _Parser(path).parse(read_bytes(path, "an OBJ file", MAX_MODEL_BYTES))


class _Parser:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._lines: list[bytes] = []
        self._values: dict[bytes, list[bytes]] = {b"v": [], b"vt": [], b"vn": []}
        self._faces: list[bytes] = []
        # Number of the first face that a material or smoothing group holds for.
        self._material_runs: list[tuple[int, int]] = []
        self._group_runs: list[tuple[int, int]] = []
        self._materials: dict[str, int] = {}
        self._libraries: list[str] = []
        self._painted: list[bytes] = []
        # Unused properties, for one warning; a dictionary, because sets do not keep their order.
        self._left_out: dict[str, None] = {}
        self._commas = False

    def parse(self, data: bytes) -> ObjFile:
        self._lines = in_utf8(data).replace(b"\\\n", b" ").split(b"\n")
        # Nearly all lines begin so; "vtx" is refused with the numbers.
        frequent = {b"v ": self._values[b"v"], b"vt": self._values[b"vt"]}
        frequent[b"vn"] = self._values[b"vn"]
        for line in self._lines:
            start = line[:2]
            if start == b"f ":
                self._add_face(line)
            elif start in frequent:
                frequent[start].append(line)
            elif line:
                self._other(line)
        return self._finished()

    def _other(self, line: bytes) -> None:
        """A line that is not one of the four frequent ones, or that is indented."""
        words = line.split(None, 1)
        if not words:
            return
        key, rest = words[0], words[1].strip() if len(words) > 1 else b""
        if key == b"#MRGB":
            self._painted.append(rest)
        elif key.startswith(b"#"):
            return
        elif key == b"f":
            self._add_face(line)
        elif key in self._values:
            self._values[key].append(line)
        elif key == b"usemtl":
            number = self._materials.setdefault(readable(rest), len(self._materials))
            self._material_runs.append((len(self._faces), number))
        elif key == b"mtllib":
            self._libraries.append(readable(rest))
        elif key == b"s":
            off = rest in (b"off", b"0", b"")
            self._group_runs.append((len(self._faces), 0 if off else self._group(rest)))
        elif key not in _GROUPS:
            text = _LEFT_OUT.get(key) or f"lines of {shown(readable(key))!r}"
            self._left_out[text] = None

    def _group(self, text: bytes) -> int:
        try:
            return 1 if text == b"on" else int(text) % 2**31
        except ValueError:
            raise LumitreeError(
                f"{self._path}: smoothing group {shown(readable(text))!r} is neither a number nor "
                "off"
            ) from None

    def _add_face(self, line: bytes) -> None:
        if b"-" in line or b"#" in line:
            line = self._absolute(line.partition(b"#")[0])
        self._faces.append(line)

    def _absolute(self, line: bytes) -> bytes:
        """A face with indices counted from the beginning, not from the latest element."""
        counts = [len(values) for values in self._values.values()]
        words = line.split()
        for at, word in enumerate(words[1:], 1):
            fields = word.split(b"/")
            for column, (field, count) in enumerate(zip(fields, counts, strict=False)):
                # A word that is no number, or is before the beginning, is refused with the rest.
                back = int(field[1:]) if re.fullmatch(rb"-\d{1,9}", field) else 0
                if 0 < back <= count:
                    fields[column] = b"%d" % (count + 1 - back)
            words[at] = b"/".join(fields)
        return b" ".join(words)

    def _finished(self) -> ObjFile:
        if not self._faces:
            others = f", but {self._shown_left_out()}" if self._left_out else ""
            raise LumitreeError(
                f"{self._path} holds no faces{others}; expected an OBJ model of polygons"
            )
        if not self._material_runs or self._material_runs[0][0] > 0:
            self._material_runs.insert(0, (0, self._materials.setdefault("", len(self._materials))))
        smooths = bool(self._group_runs)
        if not smooths:
            self._group_runs.append((0, 1))
        elif self._group_runs[0][0] > 0:
            self._group_runs.insert(0, (0, 0))
        positions, colours = self._vertices()
        uv, normals = self._texture_coordinates(), self._table(b"vn", 3)[:, :3]
        corners, sizes = self._corners((len(positions), len(uv), len(normals)))
        if self._commas:
            self._warn("numbers have decimal commas, which are read as decimal points")
        if self._left_out:
            self._warn(f"left out: {self._shown_left_out()}")
        return ObjFile(
            path=self._path,
            positions=positions,
            colours=colours,
            uv=uv,
            normals=normals,
            corners=corners,
            sizes=sizes,
            material=self._spread(self._material_runs),
            smoothing=self._spread(self._group_runs),
            smooths=smooths,
            materials=tuple(self._materials),
            libraries=tuple(self._libraries),
        )

    def _spread(self, runs: list[tuple[int, int]]) -> Indices:
        """Value [P] of every face, from where each value begins."""
        starts, values = zip(*runs, strict=True)
        return np.repeat(values, np.diff([*starts, len(self._faces)])).astype(np.int64)

    def _table(self, key: bytes, fewest: int) -> Floats:
        """The numbers of every line that begins with `key`, see `read_table`."""

        def error(index: int, message: str) -> LumitreeError:
            return self._error(key, index, message)

        values, commas = read_table(self._values[key], key, fewest, error)
        self._commas |= commas
        return values

    def _vertices(self) -> tuple[Floats, Floats | None]:
        """Positions and colours [V, 3]."""
        rows = self._table(b"v", 3)
        colours, left_out = vertex_colours(rows)
        for text in left_out:
            self._left_out[text] = None
        if colours is None and self._painted:
            colours = painted_colours(self._painted, len(rows))
            if colours is None:
                self._left_out["#MRGB colours (not one for each vertex)"] = None
        return rows[:, :3], colours

    def _texture_coordinates(self) -> Floats:
        rows = np.nan_to_num(self._table(b"vt", 1))
        if (rows[:, 2:] != 0).any():
            self._left_out["third texture coordinates"] = None
        return np.pad(rows, ((0, 0), (0, 1)))[:, :2]

    def _corners(self, counts: tuple[int, int, int]) -> tuple[Indices, Indices]:
        """Corners [C, 3] counted from 0, -1 where there is none, and corners of each face [P]."""
        words = b" ".join(self._faces).split()
        starts = np.array([at for at, word in enumerate(words) if word == b"f"])
        sizes = np.diff([*starts.tolist(), len(words)]) - 1
        wrong = (sizes < 3) | (sizes > MAX_CORNERS)
        if wrong.any() or len(sizes) != len(self._faces):
            at = int(wrong.argmax())
            raise self._error(
                b"f", at, f"a face with {sizes[at]} corners; expected 3 to {MAX_CORNERS}"
            )
        words = [word for word in words if word != b"f"]
        # Every face around a corner repeats it: each distinct text is parsed only once.
        spellings = {word: at for at, word in enumerate(dict.fromkeys(words))}
        use = np.array([spellings[word] for word in words])
        found = read_corners(list(spellings), counts)
        if found.wrong is not None:
            face = int(np.searchsorted(np.cumsum(sizes), (use == found.wrong).argmax(), "right"))
            word = shown(readable(list(spellings)[found.wrong]))
            raise self._error(b"f", face, f"corner {word!r} {found.reason}")
        self._warn_of_absent(found.absent[use], counts)
        return found.indices[use], sizes

    def _warn_of_absent(self, absent: NDArray[np.bool_], counts: tuple[int, int, int]) -> None:
        kinds = ("texture coordinates", "left out"), ("normals", "computed")
        for (kind, treated), number, count in zip(
            kinds, absent.sum(axis=0), counts[1:], strict=True
        ):
            if number:
                corners = "1 corner names" if number == 1 else f"{number} corners of faces name"
                self._warn(
                    f"{corners} {kind} that are not there (the file has {count}); they are "
                    f"{treated}"
                )

    def _shown_left_out(self) -> str:
        return shown(", ".join(self._left_out), 300)

    def _warn(self, text: str) -> None:
        warnings.warn(f"{shown(self._path, 300)}: {text}", LumitreeWarning, stacklevel=2)

    def _error(self, key: bytes, index: int, message: str) -> LumitreeError:
        """Error in the line that holds element `index` of its kind."""
        seen = -1
        for number, line in enumerate(self._lines, 1):
            seen += line.split(None, 1)[:1] == [key]
            if seen == index:
                return LumitreeError(f"{self._path}, line {number}: {message}")
        return LumitreeError(f"{self._path}: {message}")
