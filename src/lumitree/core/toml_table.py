"""TOML files whose values are checked as they are read.

Error messages contain the name of the file and the key.
"""

import math
import re
import reprlib
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn, TypeGuard, TypeVar

from lumitree.core.file_kinds import in_utf8
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, shown

_MAX_BYTES = 2**20
# tomllib takes time and memory in proportion to the square of the parts of a dotted key.
_MAX_KEY_PARTS = 10
_TEXT_OR_COMMENT = re.compile(
    r"""
    "{3} (?: [^"\\]++ | \\. | ""?(?!") )*+ "{3,5} | '{3} (?: [^']++ | ''?(?!') )*+ '{3,5}
    | " (?: [^"\\\n]++ | \\. )*+ " | ' [^'\n]*+ ' | \# [^\n]*+
    """,
    re.DOTALL | re.VERBOSE,
)
_LONG_KEY = re.compile(rf"(?:\.[ \t]*+[\w-]++[ \t]*+){{{_MAX_KEY_PARTS}}}")
_T = TypeVar("_T")


def read_toml(path: Path, expected: str) -> "Table":
    """The table of a TOML file.

    Args:
        path: the file.
        expected: kind of file that is expected, for the message.

    Raises:
        LumitreeError: it is missing, larger than 1 MiB, or not TOML in UTF-8; or a key in it has
            more than 10 parts.
    """
    data = read_bytes(path, expected, _MAX_BYTES)
    try:
        content = in_utf8(data).decode("utf-8")
        if _LONG_KEY.search(_TEXT_OR_COMMENT.sub("x", content)):
            raise LumitreeError(
                f"{shown(path, 300)} has a key of more than {_MAX_KEY_PARTS} parts joined by dots; "
                "write a name that has dots in quotes"
            )
        table = tomllib.loads(content)
    except (ValueError, RecursionError) as error:
        raise LumitreeError(
            f"{shown(path, 300)} is not valid TOML in UTF-8: {shown(error, 200)}"
        ) from None
    return Table(path, "", table)


class UnexpectedError(Exception):
    """A value is wrong; the message states what was expected."""


class Table:
    """A TOML table whose keys are taken out one by one; keys that remain are unknown.

    Args:
        path: of the file.
        name: of the table, for messages; empty for the file's own.
        values: of the table.

    Attributes:
        name: as given.
    """

    def __init__(self, path: Path, name: str, values: dict[str, Any]) -> None:
        self.name = name
        self._path, self._values = path, dict(values)
        self._known: list[str] = []

    def take(self, key: str, read: Callable[[Any], _T]) -> _T | None:
        """The value of a key, checked; None where the key is absent."""
        self._known.append(key)
        if key not in self._values:
            return None
        value = self._values.pop(key)
        try:
            return read(value)
        except UnexpectedError as wrong:
            self.fail(f"{self._full(key)} is {shown_value(value)}; expected {wrong}")

    def table(self, key: str) -> "Table | None":
        """The table of a key; None where the key is absent."""
        values = self.take(key, dictionary("a table { ... }"))
        return None if values is None else Table(self._path, self._full(key), values)

    def finish(self) -> None:
        """Refuse what has not been taken."""
        for key in self._values:
            self.fail(f"unknown key {self._full(key)!r}; known here: {', '.join(self._known)}")

    def fail(self, message: str) -> NoReturn:
        """Raise a `LumitreeError` with the name of the file."""
        raise LumitreeError(f"{shown(self._path, 300)}: {' '.join(message.split())}")

    def _full(self, key: str) -> str:
        return shown(f"{self.name}.{key}" if self.name else key)


def shown_value(value: Any) -> str:
    """A value of a TOML file, for a message."""
    # A list may be of any length and depth.
    return repr(shown(value if isinstance(value, str) else reprlib.repr(value), 60))


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def number(low: float, high: float, open_low: bool = False) -> Callable[[Any], float]:
    """Reader of numbers from `low`, or above it, to `high`."""
    bounds = f"a number {'above' if open_low else 'of at least'} {low:g} and at most {high:g}"

    def read(value: Any) -> float:
        if not is_number(value) or not low <= value <= high or (open_low and value == low):
            raise UnexpectedError(bounds)
        return float(value)

    return read


def numbers(*counts: int) -> Callable[[Any], tuple[float, ...]]:
    """Reader of lists of as many finite numbers; one number may stand for a list of 1."""
    expected = " or ".join("one number" if count == 1 else f"{count} numbers" for count in counts)

    def read(value: Any) -> tuple[float, ...]:
        values = value if isinstance(value, list) else [value]
        if len(values) not in counts or not all(map(is_number, values)):
            raise UnexpectedError(expected)
        return tuple(float(each) for each in values)

    return read


def text(value: Any) -> str:
    """Reader of texts that are not empty."""
    if not isinstance(value, str) or not value:
        raise UnexpectedError("a text")
    return value


def boolean(value: Any) -> bool:
    """Reader of true and false."""
    if not isinstance(value, bool):
        raise UnexpectedError("true or false")
    return value


def dictionary(expected: str) -> Callable[[Any], dict[str, Any]]:
    """Reader of tables."""

    def read(value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise UnexpectedError(expected)
        return value

    return read
