"""IES LM-63 files of all editions.

Files of manufacturers differ from the standard in more ways than libraries accept.

    IESNA:LM-63-2002           edition; missing before 1991
    [KEYWORD] text             any number of lines
    TILT=NONE                  or INCLUDE, or the name of a file
    position, n, n angles, n factors                         with TILT=INCLUDE only
    lamps, lumens per lamp, multiplier, n of V, n of H, type, unit, width, length, height
    ballast factor, second number, watts
    V angles, H angles, and for each H the intensities of all V

Numbers are separated by spaces, line ends or commas. The meaning of the second number depends on
the edition.

Sources: Ashdown, "Parsing the IESNA LM-63 photometric data file" (1998), for 1986 to 1995; Table 2
and sections 5.12 and 5.13 of ANSI/IES LM-63-19, as two programs that read it cite them, for the
file generation type.
"""

import dataclasses
import os
import re
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lumitree.core.files import write_bytes
from lumitree.errors import LumitreeError, shown
from lumitree.formats.opening import Opening, lm63_dimensions, lm63_opening
from lumitree.formats.reading import (
    MAX_ANGLES,
    date_of_writing,
    integer,
    one_line,
    read_text,
    stated_power,
    warn_of_file,
    without_noise,
)
from lumitree.formats.type_c import (
    IntensityDistribution,
    Turned,
    completed,
    on_grid,
    turned_of_type_b,
    type_a,
)
from lumitree.lamp.importers.model_files import ModelFolder

KIND = "IES LM-63 file"
_METRES_PER_FOOT = 0.3048
# Significant digits of the largest intensity in a file.
_DIGITS = 7
_MAKER = "lumitree"
# Characters of a line; the standard allows 256.
_LINE = 132
_TYPES = {1: "C", 2: "B", 3: "A"}
_MAX_TILT_ANGLES = 1000
# The edition of a file that names none.
FIRST_EDITION = 1986
SIMULATED, UNDEFINED = "1.00010", "1.00001"
# Titles of Table 2 of LM-63-2019. Programs may show only them and their descriptions, and no other
# judgement of a file. The digits after the point are flags: accredited, interpolated, scaled,
# simulated, undefined.
GENERATIONS = {
    UNDEFINED: "Undefined",
    SIMULATED: "Computer Simulation",
    "1.00000": "Test at an unaccredited lab",
    "1.00100": "Test at an unaccredited lab that has been lumen scaled",
    "1.01000": "Test at an unaccredited lab with interpolated angle set",
    "1.01100": "Test at an unaccredited lab with interpolated angle set that has been lumen scaled",
    "1.10000": "Test at an accredited lab",
    "1.10100": "Test at an accredited lab that has been lumen scaled",
    "1.11000": "Test at an accredited lab with interpolated angle set",
    "1.11100": "Test at an accredited lab with interpolated angle set that has been lumen scaled",
}
Array = NDArray[np.float64]


def write_ies(path: str | os.PathLike[str], distribution: IntensityDistribution) -> None:
    """Write an IES LM-63-2019 file of Type C, see `ies_content`.

    Raises:
        LumitreeError: the file cannot be written.
    """
    write_bytes(path, ies_content(distribution))


def ies_content(distribution: IntensityDistribution) -> bytes:
    """Content of an IES LM-63-2019 file of Type C.

    Its file generation type is the distribution's, or "Undefined". The number of lamp lumens is the
    flux of the bare emitters, or -1 (absolute photometry) if it is not known. The length of the
    luminous opening is its side along C = 0, the width its side along C = 90; their signs state its
    shape.
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
        f"1.0 {distribution.generation or UNDEFINED} {row([distribution.watts or 0], 4)}",
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
    return read_text(path, KIND, lambda text: _Reader(Path(path), text).read())


class _Header(NamedTuple):
    """The first 13 numbers after TILT."""

    lamps: float
    lumens: float
    multiplier: float
    vertical: float
    horizontal: float
    kind: float
    unit: float
    width: float
    length: float
    height: float
    ballast: float
    second: float
    watts: float


class _Tilt(NamedTuple):
    """Factors on the intensities by the angle by which the luminaire is tilted."""

    angles: list[float]
    factors: list[float]


@dataclasses.dataclass(frozen=True)
class _Numbers:
    """The numbers of a file.

    Angles [V] and [H], degrees, and intensities [H, V] are as the file has them. `second` is the
    text of `header.second`; `surplus` is the number of further numbers.
    """

    tilt: _Tilt | None
    header: _Header
    second: str
    vertical: Array
    horizontal: Array
    intensity: Array
    surplus: int


class _Reader:
    def __init__(self, path: Path, text: str) -> None:
        self._path, self._text = path, text

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
        header, year = numbers.header, _edition(head)
        second = second_number(numbers.second, header.second, year)
        at_rest = self._tilt(tilt)
        scale = header.multiplier * header.ballast * second.factor * at_rest
        intensity = without_noise(self._path, numbers.intensity * scale)
        turned, (c, gamma, intensity) = self._type_c(numbers, intensity)
        emitted = header.lamps * header.lumens
        opening = self._opening(header, year)
        if second.remark:
            self._warn(f"the number after its ballast factor, {second.remark}")
        if header.lumens < 0 and header.ballast != 1:
            self._warn(
                f"it states absolute photometry and a ballast factor of {header.ballast:g}, by "
                "which its intensities are multiplied"
            )
        return IntensityDistribution(
            name=shown(_keyword(head, "LUMINAIRE") or self._path.stem),
            c=c,
            gamma=gamma,
            intensity=intensity,
            opening=opening,
            emitted_lumens=emitted if header.lumens > 0 and emitted > 0 else None,
            watts=stated_power(f"{header.watts}"),
            generation=second.generation,
            turned=turned,
            details={
                "format": f"IES LM-63-{year}" if year > FIRST_EDITION else "IES LM-63, no edition",
                "photometry": f"Type {_TYPES[int(header.kind)]}, "
                + ("relative" if header.lumens > 0 else "absolute"),
                "file_generation_type": GENERATIONS.get(second.generation or "", "not stated"),
                "factors": f"candela multiplier {header.multiplier:g}, ballast "
                f"{header.ballast:g}, second number {second.factor:g}, TILT {at_rest:g}",
                "luminous_opening": str(opening),
            },
        )

    def _type_c(
        self, numbers: _Numbers, intensity: Array
    ) -> tuple[Turned | None, tuple[Array, ...]]:
        """C, γ and intensities, and intensities of Type B in its own angles."""
        horizontal, vertical = numbers.horizontal, numbers.vertical
        kind = integer(numbers.header.kind, "as type of photometry (1: C, 2: B, 3: A)", 1, 3)
        if kind == 1:
            return None, completed(horizontal, vertical, intensity)
        if vertical[0] == 0:
            self._warn(
                f"its vertical angles begin at 0, in photometry of Type {_TYPES[kind]}; it is "
                "taken to be symmetric about them"
            )
        if kind == 3:
            return None, type_a(horizontal, vertical, intensity)
        turned = turned_of_type_b(horizontal, vertical, intensity)
        return turned, on_grid(turned)

    def _opening(self, header: _Header, year: int) -> Opening:
        is_metric = integer(header.unit, "as unit (1: feet, 2: metres)", 1, 2) == 2
        metres = 1.0 if is_metric else _METRES_PER_FOOT
        width, length, height = header.width, header.length, header.height
        opening = lm63_opening(width, length, height, year, metres)
        if opening is not None:
            return opening
        self._warn(
            f"width, length and height of the luminous opening, {width:g}, {length:g} and "
            f"{height:g}, have no meaning with these signs; it is taken to be a box"
        )
        return Opening((abs(length) * metres, abs(height) * metres, abs(width) * metres))

    def _tilt(self, tilt: _Tilt | None) -> float:
        """Factor of the luminaire at rest, which is aimed straight down."""
        if tilt is None or all(factor == 1 for factor in tilt.factors):
            return 1.0
        angle = min(max(0.0, tilt.angles[0]), tilt.angles[-1])
        factor = float(np.interp(angle, tilt.angles, tilt.factors))
        self._warn(
            f"its TILT table has factors from {min(tilt.factors):g} to {max(tilt.factors):g} for "
            f"tilted luminaires; the one for {angle:g} degrees, {factor:g}, is used"
        )
        return factor

    def _tilt_file(self, name: str) -> _Tilt:
        found = ModelFolder(self._path).find(name, str(self._path))
        if found is None:
            raise LumitreeError(
                f"its TILT table is in {shown(name)!r}, which is not beside it; put it there, or "
                "write TILT=NONE for a luminaire that is not tilted"
            )
        words = read_text(found, "TILT file", lambda text: text.replace(",", " ").split())
        return _take_tilt(_leading(words))[0]

    def _warn(self, text: str) -> None:
        warn_of_file(self._path, text)


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


def _edition(head: str) -> int:
    """Year of the edition that the first line names, however it is spelt."""
    first = head.lstrip().partition("\n")[0].upper()
    year = r"[\s:_/-]*(\d{4}|\d{2})(?!\d)"
    match = re.search(rf"LM[\s_-]?63{year}", first) or re.search(rf"IES(?:NA)?{year}", first)
    if match is None:
        return FIRST_EDITION
    number = int(match[1])
    return number if number > 99 else number + (1900 if number >= 80 else 2000)


@dataclasses.dataclass(frozen=True)
class SecondNumber:
    """Meaning of the number after the ballast factor.

    `factor` is on the intensities, `generation` a key of `GENERATIONS`. `remark` says which of
    several readings is taken; it is empty if there is only one.
    """

    factor: float = 1.0
    generation: str | None = None
    remark: str = ""


def second_number(text: str, value: float, year: int) -> SecondNumber:
    """Meaning of the number after the ballast factor.

    It is the ballast-lamp photometric factor until 1991; for future use, and 1, in 1995 and 2002;
    and the file generation type since 2019. The year is `FIRST_EDITION` for a file that names no
    edition. `text` is the number as the file has it, with a decimal point.
    """
    # "1" and "1.0" are in files without a type.
    code = f"{value:.5f}"
    stated = "." in text and (code != "1.00000" or text == code)
    generation = code if stated and code in GENERATIONS and float(code) == value else None
    if year > 2002:
        unknown = f"{value:g} is no file generation type of LM-63-2019; it is not used"
        remark = "" if generation or value in (0, 1) else unknown
        return SecondNumber(generation=generation, remark=remark)
    if year > 1995:
        unused = f"{value:g} has no meaning in LM-63-2002; it is not used"
        return SecondNumber(remark="" if generation or value in (0, 1) else unused)
    if value == 1:
        return SecondNumber(generation=generation if year == FIRST_EDITION else None)
    if not value > 0:
        return SecondNumber(remark=f"{value:g} can be no factor; it is taken as 1")
    if year == FIRST_EDITION and generation and re.fullmatch(r"1\.[01]{5}", text):
        remark = f"{text} is taken as a file generation type of LM-63-2019, not as a factor"
        return SecondNumber(generation=generation, remark=remark)
    if year == 1995:
        remark = f"{value:g} is taken as a factor, as until 1991; LM-63-1995 gives it no meaning"
        return SecondNumber(factor=value, remark=remark)
    return SecondNumber(factor=value)


def _read_numbers(text: str, has_tilt: bool) -> _Numbers:
    """Numbers of the text after the line TILT=; ambiguous commas are refused."""
    if "," not in text:
        return _take_numbers(text.split(), has_tilt)
    spaced = text.replace(",", " ").split()
    with_points = [word.strip(",").replace(",", ".") for word in text.split()]
    results: list[_Numbers] = []
    reasons: list[LumitreeError] = []
    for words in (spaced, with_points):
        try:
            results.append(_take_numbers(words, has_tilt))
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


def _take_numbers(words: list[str], has_tilt: bool) -> _Numbers:
    tilt, numbers = None, _leading(words)
    count, size = len(numbers), len(_Header._fields)
    if has_tilt:
        tilt, numbers = _take_tilt(numbers)
    if len(numbers) < size:
        raise LumitreeError(f"it has {len(numbers)} numbers after TILT; expected at least {size}")
    header = _Header(*numbers[:size])
    if not np.isfinite(header).all():
        raise LumitreeError(f"one of its first {size} numbers is NaN or infinite")
    vertical = integer(header.vertical, "vertical angles", 1, MAX_ANGLES)
    horizontal = integer(header.horizontal, "horizontal angles", 1, MAX_ANGLES)
    expected = size + vertical + horizontal + vertical * horizontal
    if len(numbers) < expected:
        raise LumitreeError(
            f"it has {len(numbers)} numbers, expected {expected} for {vertical} x {horizontal} "
            "intensities and their angles; the file is cut off"
        )
    values = np.array(numbers[size:expected])
    if not np.isfinite(values).all():
        raise LumitreeError("its angles or intensities have NaN or infinite numbers")
    angles, planes, intensity = np.split(values, [vertical, vertical + horizontal])
    return _Numbers(
        tilt,
        header,
        words[count - len(numbers) + _Header._fields.index("second")],
        angles,
        planes,
        intensity.reshape(horizontal, vertical),
        len(numbers) - expected,
    )
