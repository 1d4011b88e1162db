"""The text of an OBJ file as arrays."""

import codecs
import dataclasses
import re
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.importers.model_folder import MAX_MODEL_BYTES
from lumitree.importers.polygons import MAX_CORNERS
from lumitree.importers.topology import Indices
from lumitree.model.geometry import Floats

# Beyond this, squares of lengths leave the range of single precision.
MAX_COORDINATE = 1e9
_FREE_FORM = {b"vp", b"cstype", b"deg", b"curv", b"curv2", b"surf", b"bzp", b"bsp"}


@dataclasses.dataclass(frozen=True)
class ObjFile:
    """Everything in an OBJ file that lumitree reads; indices begin at 0.

    Attributes:
        path: of the file.
        positions: [V, 3].
        uv: [T, 2], v = 0 at an image's last row, as the file has it.
        normals: [N, 3], of any length.
        corners: [C, 3] position, texture coordinate and normal of every polygon's corners, one
            polygon after the other; -1 where the last two are missing.
        sizes: [P] corners of each polygon.
        material: [P] number in `materials`.
        smoothing: [P] smoothing group; 0 for none; 1 throughout in a file that names none.
        materials: names; "" for what comes before any `usemtl`.
        libraries: rest of every `mtllib` line.
    """

    path: Path
    positions: Floats
    uv: Floats
    normals: Floats
    corners: Indices
    sizes: Indices
    material: Indices
    smoothing: Indices
    materials: tuple[str, ...]
    libraries: tuple[str, ...]


def parse_obj(path: Path) -> ObjFile:
    """Read an OBJ file.

    Raises:
        LumitreeError: it is missing, larger than 512 MiB, holds no faces, or a line is wrong.
    """
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
        self._free_form = False

    def parse(self, data: bytes) -> ObjFile:
        data = data.removeprefix(codecs.BOM_UTF8).replace(b"\\\r\n", b"  ").replace(b"\\\n", b" ")
        self._lines = data.splitlines()
        # What nearly all lines begin with; "vtx" is refused with the numbers.
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
        if not words or words[0].startswith(b"#"):
            return
        key, rest = words[0], words[1].strip() if len(words) > 1 else b""
        if key == b"f":
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
        elif key in _FREE_FORM and not self._free_form:
            self._free_form = True
            warnings.warn(
                f"{self._path}: free-form curves and surfaces are left out; export polygons",
                LumitreeWarning,
                stacklevel=2,
            )

    def _group(self, text: bytes) -> int:
        try:
            return int(text) % 2**31
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
                # What is no number, or reaches before the beginning, is refused with the rest.
                back = int(field[1:]) if re.fullmatch(rb"-\d{1,9}", field) else 0
                if 0 < back <= count:
                    fields[column] = b"%d" % (count + 1 - back)
            words[at] = b"/".join(fields)
        return b" ".join(words)

    def _finished(self) -> ObjFile:
        if not self._faces:
            raise LumitreeError(f"{self._path} holds no faces; expected an OBJ model of polygons")
        if not self._material_runs or self._material_runs[0][0] > 0:
            self._material_runs.insert(0, (0, self._materials.setdefault("", len(self._materials))))
        if not self._group_runs:
            self._group_runs.append((0, 1))
        elif self._group_runs[0][0] > 0:
            self._group_runs.insert(0, (0, 0))
        positions, uv = self._numbers(b"v", 3), self._numbers(b"vt", 2)
        normals = self._numbers(b"vn", 3)
        corners, sizes = self._corners((len(positions), len(uv), len(normals)))
        return ObjFile(
            path=self._path,
            positions=positions,
            uv=uv,
            normals=normals,
            corners=corners,
            sizes=sizes,
            material=self._spread(self._material_runs),
            smoothing=self._spread(self._group_runs),
            materials=tuple(self._materials),
            libraries=tuple(self._libraries),
        )

    def _spread(self, runs: list[tuple[int, int]]) -> Indices:
        """Value [P] of every face, from where each value begins."""
        starts, values = zip(*runs, strict=True)
        return np.repeat(values, np.diff([*starts, len(self._faces)])).astype(np.int64)

    def _numbers(self, key: bytes, width: int) -> Floats:
        """First `width` numbers of every line [N, width] that begins with `key`."""
        lines = self._values[key]
        if not lines:
            return np.zeros((0, width))
        words = b" ".join(lines).split()
        if len(words) != len(lines) * (width + 1) or set(words[:: width + 1]) != {key}:
            # A line may be cut short by a comment, or hold a weight or a colour that is not used;
            # a texture coordinate may lack its v.
            rows = [self._row(line.split(), key, width, at) for at, line in enumerate(lines)]
            words = [word for row in rows for word in row]
        del words[:: width + 1]
        try:
            values = np.array(list(map(float, words))).reshape(-1, width)
        except ValueError:
            at = _first_failing(words, float)
            word = shown(readable(words[at]))
            raise self._error(key, at // width, f"{word!r} is not a number") from None
        bad = ~(np.abs(values) <= MAX_COORDINATE).all(axis=1)
        if bad.any():
            raise self._error(
                key, int(bad.argmax()), f"a value is not finite or beyond {MAX_COORDINATE:g}"
            )
        return values

    def _row(self, row: list[bytes], key: bytes, width: int, at: int) -> list[bytes]:
        comment = [index for index, word in enumerate(row) if word.startswith(b"#")]
        found = row[: comment[0]] if comment else row
        if width == 2 and len(found) == 2:
            found = [*found, b"0"]
        if row[0] != key:
            raise LumitreeError(f"{self._path}: a line begins with {shown(readable(row[0]))!r}")
        if len(found) <= width:
            message = f"{len(found) - 1} numbers after {readable(key)!r}; expected {width}"
            raise self._error(key, at, message)
        return found[: width + 1]

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
        read, wrong, reason = _read_corners(list(spellings), counts)
        if wrong is not None:
            face = int(np.searchsorted(np.cumsum(sizes), (use == wrong).argmax(), side="right"))
            word = shown(readable(list(spellings)[wrong]))
            raise self._error(b"f", face, f"corner {word!r} {reason}")
        return read[use], sizes

    def _error(self, key: bytes, index: int, message: str) -> LumitreeError:
        """Error in the line that holds element `index` of its kind."""
        seen = -1
        for number, line in enumerate(self._lines, 1):
            seen += line.split(None, 1)[:1] == [key]
            if seen == index:
                return LumitreeError(f"{self._path}, line {number}: {message}")
        return LumitreeError(f"{self._path}: {message}")


def _read_corners(
    spellings: list[bytes], counts: tuple[int, int, int]
) -> tuple[Indices, int | None, str]:
    """Indices [S, 3] of corners such as 1/2/3, the first wrong one or None, and why it is."""
    fields = [word.split(b"/") for word in spellings]
    read = np.full((len(fields), 3), -1, np.int64)
    for column in range(3):
        words = [row[column] if len(row) > column else b"" for row in fields]
        try:
            read[:, column] = [_index(word) for word in words]
        except (ValueError, OverflowError):
            at = _first_failing(words, _index)
            return read, at, "is not of the form 1, 1/2, 1//3 or 1/2/3"
        given = np.array([bool(word) for word in words])
        wrong = given & ((read[:, column] < 0) | (read[:, column] >= counts[column]))
        if column == 0:
            wrong |= ~given
        if wrong.any():
            reason = (
                f"names what is not there; the file has {counts[0]} positions, "
                f"{counts[1]} texture coordinates and {counts[2]} normals"
            )
            return read, int(wrong.argmax()), reason
    too_long = [at for at, row in enumerate(fields) if len(row) > 3]
    return read, too_long[0] if too_long else None, "has more than three indices"


def _index(word: bytes) -> np.int64:
    """Index of a corner, counted from 0; -1 for none."""
    return np.int64(int(word) - 1 if word else -1)


def readable(text: bytes) -> str:
    """Text of a file that does not say how it is encoded, without control characters."""
    try:
        decoded = text.decode("utf-8")
    except UnicodeDecodeError:
        decoded = text.decode("latin-1")
    return shown(decoded, len(decoded))


def _first_failing(words: Sequence[bytes], convert: Callable[[bytes], object]) -> int:
    for at, word in enumerate(words):
        try:
            convert(word)
        except (ValueError, OverflowError):
            return at
    raise AssertionError("no word fails")
