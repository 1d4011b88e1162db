"""Text of photometric files: its encoding, its date, and messages about its numbers."""

import datetime
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from lumitree.core.file_kinds import in_utf8
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, LumitreeWarning, shown

T = TypeVar("T")
MAX_FILE_BYTES = 1 << 24
# Largest number of C planes, of γ angles and of sets of lamps.
MAX_ANGLES, MAX_SETS = 3601, 20
# Relative difference of fluxes that coarse angles may cause.
_FLUX_ERROR = 0.05
# EULUMDAT limits the length of text lines.
_TEXT = 78


def read_text(path: str | os.PathLike[str], kind: str, parse: Callable[[str], T]) -> T:
    """Result of `parse` for the text of a file, whose lines end in \\n; errors name the file."""
    text = decoded(read_bytes(path, f"an {kind}", MAX_FILE_BYTES))
    try:
        # Numbers of any size are checked where they are used.
        with np.errstate(all="ignore"):
            return parse(text)
    except LumitreeError as error:
        raise LumitreeError(f"{shown(path, 300)} is not a usable {kind}: {error}") from None


def decoded(content: bytes) -> str:
    """Text in UTF-8, UTF-16 or else Latin-1, with lines that end in \\n."""
    content = in_utf8(content)
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def number(text: str, what: str) -> float:
    """A finite number with a decimal point or comma."""
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise LumitreeError(f"{what} is {shown(text, 40)!r}; expected a number")
    return value


def integer(value: float, what: str, low: int, high: int) -> int:
    """A number as an integer from `low` to `high`."""
    if not (low <= value <= high and value == int(value)):
        raise LumitreeError(f"it has {value:g} {what}; expected {low} to {high}")
    return int(value)


def one_line(text: str) -> str:
    """Text for one line of a file: printable characters of Latin-1."""
    return shown(text, _TEXT).replace("…", ".").encode("latin-1", "replace").decode("latin-1")


def date_of_writing() -> datetime.datetime:
    """The date that a written file states: now, or SOURCE_DATE_EPOCH, seconds since 1970.

    With this environment variable equal commands write equal files at any time
    (https://reproducible-builds.org).
    """
    seconds = os.environ.get("SOURCE_DATE_EPOCH")
    if seconds is None:
        return datetime.datetime.now().astimezone()
    try:
        return datetime.datetime.fromtimestamp(int(seconds), datetime.UTC)
    except (ValueError, OverflowError, OSError):
        raise LumitreeError(
            f"SOURCE_DATE_EPOCH is {shown(seconds, 40)}; expected seconds since 1970, or unset it"
        ) from None


def warn_of_flux(path: str | os.PathLike[str], lumens: float, stated: float, what: str) -> None:
    """Warn of intensities whose flux, lm, is not what their file states; 0 if it states none.

    `what` says how the file states it, such as "where it states 500 lm".
    """
    if min(stated, lumens) > 0 and abs(lumens - stated) > _FLUX_ERROR * stated:
        warn_of_file(
            path,
            f"its intensities have {lumens:.6g} lm, {what}; the intensities are used (give the "
            "flux that you know by lumens)",
        )


def warn_of_file(path: str | os.PathLike[str], text: str) -> None:
    """Warn of a photometric file."""
    warnings.warn(f"{shown(Path(path).name, 200)}: {text}", LumitreeWarning, stacklevel=3)
