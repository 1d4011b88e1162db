"""IES LM-63 files of all editions.

Files of manufacturers differ from the standard in more ways than libraries accept.

    IESNA:LM-63-2002           edition; missing before 1991
    [KEYWORD] text             any number of lines
    TILT=NONE                  or INCLUDE, or the name of a file
    position, n, n angles, n factors                         with TILT=INCLUDE only
    lamps, lumens per lamp, multiplier, n of V, n of H, type, unit, width, length, height
    ballast factor, second number, watts
    V angles, H angles, and for each H the intensities of all V

Numbers are separated by spaces, line ends or commas. `ies_fields` has what depends on the edition.
"""

import os
import re
import textwrap
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.core.files import write_bytes
from lumitree.errors import LumitreeError, shown
from lumitree.formats.ies_fields import (
    FIRST_EDITION,
    GENERATIONS,
    SIMULATED,
    UNDEFINED,
    SecondNumber,
    edition,
    second_number,
)
from lumitree.formats.ies_numbers import SECOND_NUMBER, Numbers, Tilt, read_numbers, read_tilt
from lumitree.formats.opening import Opening, lm63_dimensions, lm63_opening
from lumitree.formats.photometric_text import (
    date_of_writing,
    integer,
    one_line,
    read_text,
    warn_of_file,
)
from lumitree.formats.symmetry import (
    completed,
    on_grid,
    turned_of_type_b,
    type_a,
    without_noise,
)
from lumitree.formats.type_c import IntensityDistribution, Turned
from lumitree.lamp.importers.model_files import ModelFolder

KIND = "IES LM-63 file"
_METRES_PER_FOOT = 0.3048
# Significant digits of the largest intensity in a file.
_DIGITS = 7
_MAKER = "lumitree"
# Characters of a line; the standard allows 256.
_LINE = 132
_TYPES = {1: "C", 2: "B", 3: "A"}


def write_ies(path: str | os.PathLike[str], distribution: IntensityDistribution) -> None:
    """Write an IES LM-63-2019 file of Type C, see `ies_content`.

    Raises:
        LumitreeError: the file cannot be written.
    """
    write_bytes(path, ies_content(distribution))


def ies_content(distribution: IntensityDistribution) -> bytes:
    """Content of an IES LM-63-2019 file of Type C.

    Its file generation type is that of the distribution, or "Undefined". The number of lamp lumens
    is the flux of the bare emitters, or -1 (absolute photometry) if that is not known. The length
    of the luminous opening is its side along C = 0, the width that along C = 90; their signs state
    its shape.
    """
    emitted, name = distribution.emitted_lumens, one_line(distribution.name)
    planes = np.append(distribution.c, distribution.c[0] + 360)
    values = np.concatenate([distribution.intensity, distribution.intensity[:1]])
    largest = float(values.max(initial=0)) or 1.0
    decimals = max(3, _DIGITS - int(np.ceil(np.log10(largest))))

    def row(numbers: Iterable[float], digits: int = decimals) -> str:
        words = (np.format_float_positional(each + 0.0, digits, trim="0") for each in numbers)
        return textwrap.fill(" ".join(words), _LINE, subsequent_indent=" ")

    keywords = {
        "TEST": "simulated" if distribution.generation == SIMULATED else "converted",
        "TESTLAB": _MAKER,
        "ISSUEDATE": date_of_writing().date().isoformat(),
        "MANUFAC": _MAKER,
        "LUMCAT": name,
        "LUMINAIRE": name,
    }
    lines = [
        "IES:LM-63-2019",
        *(f"[{key}] {text}" for key, text in keywords.items()),
        "TILT=NONE",
        # One lamp, no multiplier, Type C, metres.
        f"1 {row([-1 if emitted is None else emitted], 4)} 1.0 {values.shape[1]} {len(planes)} 1 2 "
        + row(lm63_dimensions(distribution.opening), 6),
        f"1.0 {distribution.generation or UNDEFINED} 0.0",
        *(row(each) for each in (distribution.gamma, planes, *values)),
        "",
    ]
    return "\n".join(lines).encode("utf-8")


def read_ies(path: str | os.PathLike[str]) -> IntensityDistribution:
    """Read an IES LM-63 file of any edition and type; Types A and B are converted to Type C.

    Warns of small negative intensities, which are taken as 0; of TILT tables, of which the factor
    at 0 degrees is used; of factors that may be read in two ways; and of an opening whose shape is
    in no edition.

    Raises:
        LumitreeError: the file is missing or damaged, or its angles are of no known symmetry.
    """
    return read_text(path, KIND, lambda text: _Reader(path, text).read())


class _Reader:
    def __init__(self, path: str | os.PathLike[str], text: str) -> None:
        self._path, self._text = Path(path), text

    def read(self) -> IntensityDistribution:
        match = re.search(
            r"^[ \t]*TILT[ \t]*=[ \t]*(.*)$", self._text, re.MULTILINE | re.IGNORECASE
        )
        if match is None:
            raise LumitreeError("it has no line TILT=")
        head, rest = self._text[: match.start()], self._text[match.end() :]
        kind = match[1].strip().strip('"<>').strip()
        numbers = read_numbers(rest, kind.upper() == "INCLUDE")
        tilt = numbers.tilt
        if kind.upper() not in ("INCLUDE", "NONE", ""):
            tilt = self._tilt_file(kind)
        header, year = numbers.header, edition(head)
        second = second_number(numbers.second_number, header[SECOND_NUMBER], year)
        tilt_factor = self._tilt(tilt)
        scale = header[2] * header[10] * second.factor * tilt_factor
        intensity, least = without_noise(numbers.intensity * scale)
        if least < 0:
            warn_of_file(
                self._path, f"small negative intensities (down to {least:g} cd) count as 0"
            )
        turned, (c, gamma, intensity) = self._type_c(numbers, intensity)
        emitted = header[0] * header[1]
        opening = self._opening(header, year)
        self._warn_of_factors(second, header)
        return IntensityDistribution(
            name=shown(_keyword(head, "LUMINAIRE") or self._path.stem),
            c=c,
            gamma=gamma,
            intensity=intensity,
            opening=opening,
            emitted_lumens=emitted if header[1] > 0 and emitted > 0 else None,
            generation=second.generation,
            turned=turned,
            details={
                "format": f"IES LM-63-{year}" if year > FIRST_EDITION else "IES LM-63, no edition",
                "photometry": f"Type {_TYPES[int(header[5])]}, "
                + ("relative" if header[1] > 0 else "absolute"),
                "file_generation_type": GENERATIONS.get(second.generation or "", "not stated"),
                "factors": f"candela multiplier {header[2]:g}, ballast {header[10]:g}, second "
                f"number {second.factor:g}, TILT {tilt_factor:g}",
                "luminous_opening": str(opening),
            },
        )

    def _warn_of_factors(self, second: SecondNumber, header: list[float]) -> None:
        """Say which reading is taken of factors that have several."""
        if second.remark:
            warn_of_file(self._path, f"the number after its ballast factor, {second.remark}")
        if header[1] < 0 and header[10] != 1:
            warn_of_file(
                self._path,
                f"it states absolute photometry and a ballast factor of {header[10]:g}, by which "
                "its intensities are multiplied",
            )

    def _type_c(
        self, numbers: Numbers, intensity: NDArray[np.float64]
    ) -> tuple[Turned | None, tuple[NDArray[np.float64], ...]]:
        """C, γ and intensities, and intensities of Type B in its own angles."""
        horizontal, vertical = numbers.horizontal, numbers.vertical
        kind = integer(numbers.header[5], "as type of photometry (1: C, 2: B, 3: A)", 1, 3)
        if kind == 1:
            return None, completed(horizontal, vertical, intensity)
        if vertical[0] == 0:
            warn_of_file(
                self._path,
                f"its vertical angles begin at 0, in photometry of Type {_TYPES[kind]}; it is "
                "taken to be symmetric about them",
            )
        if kind == 3:
            return None, type_a(horizontal, vertical, intensity)
        turned = turned_of_type_b(horizontal, vertical, intensity)
        return turned, on_grid(turned)

    def _opening(self, header: list[float], year: int) -> Opening:
        metres = (
            1.0
            if integer(header[6], "as unit (1: feet, 2: metres)", 1, 2) == 2
            else _METRES_PER_FOOT
        )
        width, length, height = header[7:10]
        opening = lm63_opening(width, length, height, year, metres)
        if opening is not None:
            return opening
        warn_of_file(
            self._path,
            f"width, length and height of the luminous opening, {width:g}, {length:g} and "
            f"{height:g}, have no meaning with these signs; it is taken to be a box",
        )
        return Opening((abs(length) * metres, abs(height) * metres, abs(width) * metres))

    def _tilt(self, tilt: Tilt | None) -> float:
        """Factor of the luminaire at rest, which is aimed straight down."""
        if tilt is None or all(factor == 1 for factor in tilt.factors):
            return 1.0
        angle = min(max(0.0, tilt.angles[0]), tilt.angles[-1])
        factor = float(np.interp(angle, tilt.angles, tilt.factors))
        warn_of_file(
            self._path,
            f"its TILT table has factors from {min(tilt.factors):g} to {max(tilt.factors):g} for "
            f"tilted luminaires; the one for {angle:g} degrees, {factor:g}, is used",
        )
        return factor

    def _tilt_file(self, name: str) -> Tilt:
        found = ModelFolder(self._path).find(name, str(self._path))
        if found is None:
            raise LumitreeError(
                f"its TILT table is in {shown(name)!r}, which is not beside it; put it there, or "
                "write TILT=NONE for a luminaire that is not tilted"
            )
        return read_text(found, "TILT file", read_tilt)


def _keyword(head: str, name: str) -> str:
    """Text of a keyword, with the lines [MORE] after it."""
    found: list[str] = []
    taken = False
    for line in head.split("\n"):
        match = re.match(r"\s*\[([^\]]*)\](.*)", line)
        key = match[1].strip().upper() if match else ""
        taken = (key == name and not found) or (taken and key == "MORE")
        if match and taken:
            found.append(match[2].strip())
    return " ".join(found).strip()
