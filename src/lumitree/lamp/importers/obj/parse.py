"""The text of an OBJ file as arrays."""

import dataclasses
import re
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.core.file_kinds import in_utf8
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.lamp.importers.model_folder import MAX_MODEL_BYTES
from lumitree.lamp.importers.obj.corners import read_corners
from lumitree.lamp.importers.obj.numbers import (
    painted_colours,
    read_table,
    readable,
    vertex_colours,
)
from lumitree.lamp.importers.polygons import MAX_CORNERS
from lumitree.lamp.importers.topology import Indices
from lumitree.lamp.meshes import Floats

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
