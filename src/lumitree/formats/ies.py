"""IES LM-63 files of all editions.

They are written by the library photompy, and read here: files of manufacturers differ from the
standard in more ways than the library accepts.

    IESNA:LM-63-2002           edition; missing before 1991
    [KEYWORD] text             any number of lines
    TILT=NONE                  or INCLUDE, or the name of a file
    position, n, n angles, n factors                         with TILT=INCLUDE only
    lamps, lumens per lamp, multiplier, n of V, n of H, type, unit, width, length, height
    ballast factor, another number, watts
    V angles, H angles, and for each H the intensities of all V

Numbers are separated by spaces, line ends or commas.
"""

import dataclasses
import datetime
import os
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.core.files import write_bytes
from lumitree.errors import LumitreeError, shown
from lumitree.formats.opening import Opening, lm63_dimensions, lm63_opening
from lumitree.formats.photometric_text import (
    MAX_ANGLES,
    integer,
    one_line,
    read_text,
    warn_of_file,
)
from lumitree.formats.symmetry import completed, type_a, type_b, without_noise
from lumitree.formats.type_c import IntensityDistribution
from lumitree.lamp.importers.model_folder import ModelFolder

KIND = "IES LM-63 file"
_METRES_PER_FOOT = 0.3048
# Significant digits of the largest intensity in a file.
_DIGITS = 7
_MAKER = "lumitree"
_NUM_HEADER = 13
_MAX_TILT_ANGLES = 1000
# The edition of a file that names none.
_FIRST_EDITION = 1986


def write_ies(path: str | os.PathLike[str], distribution: IntensityDistribution) -> None:
    """Write an IES LM-63-2019 file of Type C, see `ies_content`.

    Raises:
        LumitreeError: the file cannot be written.
    """
    write_bytes(path, ies_content(distribution))


def ies_content(distribution: IntensityDistribution) -> bytes:
    """Content of an IES LM-63-2019 file of Type C, marked as simulated.

    The number of lamp lumens is the flux of the bare emitters, or -1 (absolute photometry) if that
    is not known. The length of the luminous opening is its side along C = 0, the width that along
    C = 90; their signs state its shape.
    """
    from photompy import IESFile, PhotometricType, Photometry

    planes = np.append(distribution.c, distribution.c[0] + 360)
    values = np.concatenate([distribution.intensity, distribution.intensity[:1]])
    photometry = Photometry(distribution.gamma, planes, values, PhotometricType.C)
    largest = float(values.max(initial=0)) or 1.0
    width, length, height = lm63_dimensions(distribution.opening)
    emitted = distribution.emitted_lumens
    file = IESFile.from_photometry(
        photometry,
        manufacturer=_MAKER,
        lumcat=one_line(distribution.name),
        luminaire=one_line(distribution.name),
        test="simulated",
        testlab=_MAKER,
        issuedate=datetime.date.today().isoformat(),
        lumens_per_lamp=-1 if emitted is None else round(emitted, 4),
        width=round(width, 6),
        length=round(length, 6),
        height=round(height, 6),
    )
    # photompy writes two decimals by default, which loses intensities of some millicandela.
    decimals = max(3, _DIGITS - int(np.ceil(np.log10(largest))))
    return _numbers_in_full(file.write(precision=decimals) or b"")


def read_ies(path: str | os.PathLike[str]) -> IntensityDistribution:
    """Read an IES LM-63 file of any edition and type; Types A and B are converted to Type C.

    Warns of small negative intensities, which are taken as 0; of TILT tables, of which the factor
    at 0 degrees is used; and of an opening whose shape is in no edition.

    Raises:
        LumitreeError: the file is missing or damaged, or its angles are of no known symmetry.
    """
    return read_text(path, KIND, lambda text: _Reader(path, text).read())


@dataclasses.dataclass(frozen=True)
class _Tilt:
    """Factors on the intensities by the angle by which the luminaire is tilted."""

    angles: list[float]
    factors: list[float]


@dataclasses.dataclass(frozen=True)
class _Numbers:
    """The numbers of a file, and how many others follow."""

    tilt: _Tilt | None
    header: list[float]
    vertical: NDArray[np.float64]
    horizontal: NDArray[np.float64]
    intensity: NDArray[np.float64]
    surplus: int


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
        numbers = _read_numbers(rest, kind.upper() == "INCLUDE")
        tilt = numbers.tilt
        if kind.upper() not in ("INCLUDE", "NONE", ""):
            tilt = self._tilt_file(kind)
        header = numbers.header
        year = _edition(head)
        scale = header[2] * header[10] * self._factor(rest, header[11], year) * self._tilt(tilt)
        intensity, least = without_noise(numbers.intensity * scale)
        if least < 0:
            warn_of_file(
                self._path, f"small negative intensities (down to {least:g} cd) count as 0"
            )
        c, gamma, intensity = self._type_c(numbers, intensity)
        emitted = header[0] * header[1]
        return IntensityDistribution(
            name=shown(_keyword(head, "LUMINAIRE") or self._path.stem),
            c=c,
            gamma=gamma,
            intensity=intensity,
            opening=self._opening(header, year),
            emitted_lumens=emitted if header[1] > 0 and emitted > 0 else None,
        )

    def _type_c(self, numbers: _Numbers, intensity: NDArray[np.float64]):
        horizontal, vertical = numbers.horizontal, numbers.vertical
        kind = integer(numbers.header[5], "as type of photometry (1: C, 2: B, 3: A)", 1, 3)
        if kind == 1:
            return completed(horizontal, vertical, intensity)
        if vertical[0] == 0:
            warn_of_file(
                self._path,
                f"its vertical angles begin at 0, in photometry of Type {'BA'[kind - 2]}; it is "
                "taken to be symmetric about them",
            )
        return (type_b if kind == 2 else type_a)(horizontal, vertical, intensity)

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

    def _factor(self, rest: str, value: float, year: int) -> float:
        """The number after the ballast factor: a factor too until 1995, no meaning in 2002.

        Since 2019 it is a code of how the file was made, 1 and five digits that are 0 or 1. A file
        that names no edition may be of any.
        """
        code = year == _FIRST_EDITION and re.search(r"(?<!\S)1\.[01]{5}(?!\S)", rest)
        return (
            value if year <= 1995 and value > 0 and not (code and value == float(code[0])) else 1.0
        )

    def _tilt(self, tilt: _Tilt | None) -> float:
        """Factor of the luminaire at rest."""
        if tilt is None or all(factor == 1 for factor in tilt.factors):
            return 1.0
        factor = float(np.interp(0.0, tilt.angles, tilt.factors))
        warn_of_file(
            self._path,
            f"its TILT table has factors from {min(tilt.factors):g} to {max(tilt.factors):g} for "
            f"tilted luminaires; the one for 0 degrees, {factor:g}, is used",
        )
        return factor

    def _tilt_file(self, name: str) -> _Tilt:
        found = ModelFolder(self._path).find(name, str(self._path))
        if found is None:
            raise LumitreeError(
                f"its TILT table is in {shown(name)!r}, which is not beside it; put it there, or "
                "write TILT=NONE for a luminaire that is not tilted"
            )
        return read_text(
            found, "TILT file", lambda text: _take_tilt(_leading(_spaced(text).split()))[0]
        )


def _read_numbers(text: str, has_tilt: bool) -> _Numbers:
    """Numbers of the text after the line TILT=, whatever its commas mean."""
    if "," not in text:
        return _take_numbers(_leading(text.split()), has_tilt)
    readings = (_spaced(text).split(), [word.strip(",").replace(",", ".") for word in text.split()])
    results: list[_Numbers] = []
    reasons: list[LumitreeError] = []
    for words in readings:
        try:
            results.append(_take_numbers(_leading(words), has_tilt))
        except LumitreeError as error:
            reasons.append(error)
    exact = [numbers for numbers in results if numbers.surplus == 0]
    if exact:
        return exact[0]
    if not results:
        raise reasons[0]
    raise LumitreeError(
        "its commas may separate numbers or stand for decimal points, and neither gives the number "
        "of intensities that it states; write numbers with points"
    )


def _spaced(text: str) -> str:
    return text.replace(",", " ")


def _leading(words: list[str]) -> list[float]:
    """The numbers that the words begin with."""
    numbers = []
    for word in words:
        try:
            numbers.append(float(word))
        except ValueError:
            break
    return numbers


def _take_tilt(numbers: list[float]) -> tuple[_Tilt, list[float]]:
    """The TILT table at the beginning, and the other numbers."""
    if len(numbers) < 2:
        raise LumitreeError("its TILT table is cut off")
    count = integer(numbers[1], "angles in its TILT table", 1, _MAX_TILT_ANGLES)
    angles, factors = numbers[2 : 2 + count], numbers[2 + count : 2 + 2 * count]
    if len(factors) < count or not (np.diff(angles) > 0).all() or not min(factors) >= 0:
        raise LumitreeError(
            f"its TILT table is damaged; expected {count} ascending angles and {count} factors of "
            "at least 0"
        )
    return _Tilt(angles, factors), numbers[2 + 2 * count :]


def _take_numbers(numbers: list[float], has_tilt: bool) -> _Numbers:
    tilt = None
    if has_tilt:
        tilt, numbers = _take_tilt(numbers)
    if len(numbers) < _NUM_HEADER:
        raise LumitreeError(
            f"it has {len(numbers)} numbers after TILT; expected at least {_NUM_HEADER}"
        )
    header = numbers[:_NUM_HEADER]
    if not np.isfinite(header).all():
        raise LumitreeError("one of its first 13 numbers is NaN or infinite")
    vertical = integer(header[3], "vertical angles", 1, MAX_ANGLES)
    horizontal = integer(header[4], "horizontal angles", 1, MAX_ANGLES)
    expected = _NUM_HEADER + vertical + horizontal + vertical * horizontal
    if len(numbers) < expected:
        raise LumitreeError(
            f"it has {len(numbers)} numbers, expected {expected} for {vertical} x {horizontal} "
            "intensities and their angles; the file is cut off"
        )
    values = np.array(numbers[_NUM_HEADER:expected])
    if not np.isfinite(values).all():
        raise LumitreeError("its angles or intensities hold NaN or infinite numbers")
    angles, planes, intensity = np.split(values, [vertical, vertical + horizontal])
    return _Numbers(
        tilt,
        header,
        angles,
        planes,
        intensity.reshape(horizontal, vertical),
        len(numbers) - expected,
    )


def _edition(head: str) -> int:
    """Year of the edition that the first line names, however it is spelt."""
    first = head.lstrip().partition("\n")[0].upper()
    year = r"[\s:_/-]*(\d{4}|\d{2})(?!\d)"
    match = re.search(rf"LM[\s_-]?63{year}", first) or re.search(rf"IES(?:NA)?{year}", first)
    if match is None:
        return _FIRST_EDITION
    number = int(match[1])
    return number if number > 99 else number + (1900 if number >= 80 else 2000)


def _keyword(head: str, name: str) -> str:
    """Text of a keyword, with that of the lines [MORE] after it."""
    found: list[str] = []
    taken = False
    for line in head.split("\n"):
        match = re.match(r"\s*\[([^\]]*)\](.*)", line)
        key = match[1].strip().upper() if match else ""
        taken = (key == name and not found) or (taken and key == "MORE")
        if match and taken:
            found.append(match[2].strip())
    return " ".join(found).strip()


def _numbers_in_full(content: bytes) -> bytes:
    """photompy writes tiny numbers with an exponent, which some readers do not accept."""
    return b"\n".join(
        b" ".join(
            np.format_float_positional(float(word), trim="-").encode() if b"e-" in word else word
            for word in line.split(b" ")
        )
        if b"[" not in line
        else line
        for line in content.split(b"\n")
    )
