"""Numbers of an IES LM-63 file, after its line TILT=, and of a TILT file."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.errors import LumitreeError
from lumitree.formats.photometric_text import MAX_ANGLES, integer

_NUM_HEADER = 13
# The number after the ballast factor.
SECOND_NUMBER = 11
_MAX_TILT_ANGLES = 1000


@dataclasses.dataclass(frozen=True)
class Tilt:
    """Factors on the intensities by the angle by which the luminaire is tilted."""

    angles: list[float]
    factors: list[float]


@dataclasses.dataclass(frozen=True)
class Numbers:
    """The numbers of a file.

    Angles [V] and [H], degrees, and intensities [H, V] are as the file has them. `header` has the
    first 13, `surplus` says how many other numbers follow.
    """

    tilt: Tilt | None
    header: list[float]
    second_number: str
    vertical: NDArray[np.float64]
    horizontal: NDArray[np.float64]
    intensity: NDArray[np.float64]
    surplus: int


def read_numbers(text: str, has_tilt: bool) -> Numbers:
    """Numbers of the text after the line TILT=; commas of more than one meaning are refused."""
    if "," not in text:
        return _take_numbers(text.split(), has_tilt)
    readings = (_spaced(text).split(), [word.strip(",").replace(",", ".") for word in text.split()])
    results: list[Numbers] = []
    reasons: list[LumitreeError] = []
    for words in readings:
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


def read_tilt(text: str) -> Tilt:
    """The table of a TILT file."""
    return _take_tilt(_leading(_spaced(text).split()))[0]


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


def _take_tilt(numbers: list[float]) -> tuple[Tilt, list[float]]:
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
    return Tilt(angles, factors), numbers[2 + 2 * count :]


def _take_numbers(words: list[str], has_tilt: bool) -> Numbers:
    tilt, numbers = None, _leading(words)
    count = len(numbers)
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
    return Numbers(
        tilt,
        header,
        words[count - len(numbers) + SECOND_NUMBER],
        angles,
        planes,
        intensity.reshape(horizontal, vertical),
        len(numbers) - expected,
    )
