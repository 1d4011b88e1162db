"""The text of an OBJ file as arrays."""

import dataclasses
import re
import warnings
from pathlib import Path

import numpy as np

from lumitree.core.file_kinds import in_utf8
from lumitree.core.images import linear_from_srgb
from lumitree.core.reading import read_bytes
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
# Faces are grouped by material alone.
_GROUPS = (b"g", b"o", b"mg")
_FREE_FORM = (b"vp", b"cstype", b"deg", b"bmat", b"step", b"curv", b"curv2", b"surf", b"parm")
_FREE_FORM += (b"trim", b"hole", b"scrv", b"sp", b"end", b"con", b"bzp", b"bsp", b"cdc", b"cdp")
_UNUSED: dict[bytes, str] = {b"l": "lines", b"p": "points"}
_UNUSED |= dict.fromkeys(_FREE_FORM, "free-form curves and surfaces (export polygons)")


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


def readable(text: bytes) -> str:
    """Text of a file that does not say how it is encoded, without control characters."""
    try:
        decoded = text.decode("utf-8")
    except UnicodeDecodeError:
        decoded = text.decode("latin-1")
    return shown(decoded, len(decoded))


def with_point(word: str) -> str:
    """A number with a decimal comma as one with a point; anything else unchanged."""
    return word.replace(",", ".") if _DECIMAL_COMMA.fullmatch(word) else word


class _Parser:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._lines: list[bytes] = []
        self._values: dict[bytes, list[bytes]] = {b"v": [], b"vt": [], b"vn": []}
        self._faces: list[bytes] = []
        # Number of the first face of a material or smoothing group.
        self._material_runs: list[tuple[int, int]] = []
        self._group_runs: list[tuple[int, int]] = []
        self._materials: dict[str, int] = {}
        self._libraries: list[str] = []
        self._painted: list[bytes] = []
        # Unused properties, for one warning; a dictionary, because sets do not keep their order.
        self._unused: dict[str, None] = {}
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
            self._group_runs.append((len(self._faces), self._group(rest)))
        elif key not in _GROUPS:
            self._unused[_UNUSED.get(key) or f"lines of {shown(readable(key))!r}"] = None

    def _group(self, text: bytes) -> int:
        if text in (b"off", b"on", b""):
            return int(text == b"on")
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
                # A word that is no number, or is before the beginning, is refused with the rest.
                back = int(field[1:]) if re.fullmatch(rb"-\d{1,9}", field) else 0
                if 0 < back <= count:
                    fields[column] = b"%d" % (count + 1 - back)
            words[at] = b"/".join(fields)
        return b" ".join(words)

    def _finished(self) -> ObjFile:
        if not self._faces:
            others = f", but {self._shown_unused()}" if self._unused else ""
            raise LumitreeError(f"{self._path} has no faces{others}; expected polygons")
        if not self._material_runs or self._material_runs[0][0] > 0:
            self._material_runs.insert(0, (0, self._materials.setdefault("", len(self._materials))))
        smooths = bool(self._group_runs)
        if not smooths or self._group_runs[0][0] > 0:
            self._group_runs.insert(0, (0, 0 if smooths else 1))
        rows = self._table(b"v", 3)
        colours = self._vertex_colours(rows)
        coordinates = np.nan_to_num(self._table(b"vt", 1))
        if (coordinates[:, 2:] != 0).any():
            self._unused["third texture coordinates"] = None
        uv, normals = np.pad(coordinates, ((0, 0), (0, 1)))[:, :2], self._table(b"vn", 3)[:, :3]
        corners, sizes = self._corners((len(rows), len(uv), len(normals)))
        if self._commas:
            self._warn("numbers have decimal commas, which are read as decimal points")
        if self._unused:
            self._warn(f"not used: {self._shown_unused()}")
        return ObjFile(
            path=self._path,
            positions=rows[:, :3],
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
        """The numbers [N, W] of lines that begin with `key`; NaN where others have more numbers.

        Each line must have `fewest`.
        """
        lines = self._values[key]
        if not lines:
            return np.zeros((0, fewest))
        values = _uniform(lines, key, fewest)
        if values is None:
            values = self._ragged(key, fewest)
        bad = np.abs(values) > MAX_COORDINATE
        bad[:, :fewest] |= np.isnan(values[:, :fewest])
        if bad.any():
            at = int(bad.any(axis=1).argmax())
            raise self._error(key, at, f"a value is not finite or beyond {MAX_COORDINATE:g}")
        return values

    def _ragged(self, key: bytes, fewest: int) -> Floats:
        """The numbers of any lines, NaN where there is none."""
        rows = []
        for at, line in enumerate(self._values[key]):
            row = line.partition(b"#")[0].split()
            if row[:1] != [key]:
                begin = shown(readable(line.split()[0]))
                raise self._error(key, at, f"a line begins with {begin!r}")
            if len(row) <= fewest:
                advice = ", separated by spaces" if b"," in line else ""
                found = f"{len(row) - 1} numbers after {readable(key)!r}"
                raise self._error(key, at, f"{found}; expected {fewest}{advice}")
            rows.append(row[1 : _MAX_NUMBERS + 1])
        commas = not any(b"." in word for row in rows for word in row)
        commas &= any(b"," in word for row in rows for word in row)
        self._commas |= commas
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
                    raise self._error(key, at, f"{found!r} is not a number{advice}") from None
        return values

    def _vertex_colours(self, rows: Floats) -> Floats | None:
        """Linear RGB of vertices [V, 3]: white where a line has none; None where no line has one.

        After x, y and z a line [V, W] may have a weight, a colour, or both: `w`, `r g b`,
        `w r g b`. Where each fourth of seven numbers is not 1, the seventh is an opacity:
        `r g b a`. Colours are sRGB-encoded, in [0, 1] or in [0, 255]. ZBrush has them in comments
        `#MRGB`, as eight hexadecimal digits for each vertex: a mask, which is not used, R, G and B.
        """
        count = (~np.isnan(rows)).sum(axis=1)
        four, six, seven = count == 4, count == 6, count == 7
        weighted = bool(seven.any() and (rows[seven, 3] == 1).all())
        if four.any() and (rows[four, 3] != 1).any():
            self._unused["weights of vertices"] = None
        if seven.any() and not weighted and (rows[seven, 6] != 1).any():
            self._unused["opacities of vertices"] = None
        if ((count == 5) | (count > 7)).any():
            self._unused["numbers after positions of vertices, if 2 or more than 4"] = None
        coloured = six | seven
        if not coloured.any():
            return self._painted_colours(len(rows)) if self._painted else None
        encoded = np.ones((len(rows), 3))
        encoded[six] = rows[six, 3:6]
        if seven.any():
            encoded[seven] = rows[seven, 4:7] if weighted else rows[seven, 3:6]
        if encoded.max() > _BYTES_ABOVE:
            encoded[coloured] /= 255
        if encoded.min() < 0 or encoded.max() > _CLIPPED_ABOVE:
            self._unused["vertex colours beyond 0 to 1, and 0 to 255 (clipped)"] = None
        return linear_from_srgb(np.clip(encoded, 0, 1)).astype(np.float64)

    def _painted_colours(self, count: int) -> Floats | None:
        try:
            values = np.frombuffer(bytes.fromhex(b"".join(self._painted).decode("ascii")), np.uint8)
        except ValueError:
            values = np.zeros(0)
        if len(values) != 4 * count:
            self._unused["#MRGB colours (not one for each vertex)"] = None
            return None
        return linear_from_srgb(values.reshape(-1, 4)[:, 1:] / 255).astype(np.float64)

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
        rows = []
        for word in spellings:
            try:
                row = [_index(field) for field in word.split(b"/")]
            except ValueError:
                row = []
            if 1 <= len(row) <= 3 and 0 < row[0] <= counts[0]:
                rows.append(row + [0] * (3 - len(row)))
                continue
            reason = "is not of the form 1, 1/2, 1//3 or 1/2/3"
            if 1 <= len(row) <= 3:
                reason = f"names a position that is not there; the file has {counts[0]} positions"
            face = int(np.searchsorted(np.cumsum(sizes), words.index(word), "right"))
            raise self._error(b"f", face, f"corner {shown(readable(word))!r} {reason}")
        read = np.array(rows, np.int64)
        outside = (read < 0) | (read > counts)
        kinds = (1, "texture coordinates", "not used"), (2, "normals", "computed")
        for column, kind, treated in kinds:
            number = int(outside[use, column].sum())
            if number:
                corners = "1 corner names" if number == 1 else f"{number} corners of faces name"
                self._warn(
                    f"{corners} {kind} that are not there (the file has {counts[column]}); they "
                    f"are {treated}"
                )
        return np.where(outside, -1, read - 1)[use], sizes

    def _shown_unused(self) -> str:
        return shown(", ".join(self._unused), 300)

    def _warn(self, text: str) -> None:
        warnings.warn(f"{shown(self._path, 300)}: {text}", LumitreeWarning, stacklevel=2)

    def _error(self, key: bytes, index: int, message: str) -> LumitreeError:
        """Error in the line of element `index` of its kind."""
        seen = -1
        for number, line in enumerate(self._lines, 1):
            seen += line.split(None, 1)[:1] == [key]
            if seen == index:
                return LumitreeError(f"{self._path}, line {number}: {message}")
        return LumitreeError(f"{self._path}: {message}")


def _index(field: bytes) -> int:
    """Index of a corner's field, from 1; 0 for none, and -1 for a stated 0."""
    index = (int(field) or -1) if field else 0
    if abs(index) > MAX_COORDINATE:
        raise ValueError
    return index


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
