"""Tables of TOML and JSON files as objects of dataclasses, whose fields are the keys.

Error messages name the file and the key; of an unknown key, also the nearest known one.
"""

import dataclasses
import functools
import math
import re
import reprlib
import tomllib
import types
import typing
from collections.abc import Collection
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    Protocol,
    TypeGuard,
    TypeVar,
    Union,
    cast,
    runtime_checkable,
)

from lumitree.core.file_kinds import in_utf8
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, did_you_mean, shown

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
Table = dict[str, Any]


def read_toml(path: Path, expected: str) -> Table:
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
        return tomllib.loads(content)
    except (ValueError, RecursionError) as error:
        raise LumitreeError(
            f"{shown(path, 300)} is not valid TOML in UTF-8: {shown(error, 200)}"
        ) from None


class Range(NamedTuple):
    """Limits of a number, as `Annotated[float, Range(0, 1)]`; `above` excludes the lower one."""

    low: float
    high: float
    above: bool = False


@runtime_checkable
class OfTable(Protocol):
    """A class that makes its objects of tables in another way than by its fields."""

    @classmethod
    def of_table(cls, values: object, name: str) -> object:
        """The object of a value that is named `name` in messages."""
        ...


def converted(values: object, kind: type[_T], path: Path | None = None, name: str = "") -> _T:
    """A table as an object of a dataclass; keys that it lacks have the defaults of the class.

    Args:
        values: the table.
        kind: dataclass whose fields are numbers, texts, literals, tuples, collections of texts,
            dictionaries, classes with `OfTable`, such dataclasses, and unions of these. One of
            several dataclasses is chosen by the keys.
        path: the file, for messages; None to leave it out of them.
        name: name of the table in the file; empty for the whole file.

    Raises:
        LumitreeError: a key is unknown or missing, or a value is wrong.
    """
    where = "" if path is None else f"{shown(path, 300)}: "
    try:
        return object_of(values, kind, name)
    except LumitreeError as error:
        raise LumitreeError(f"{where}{' '.join(str(error).split())}") from None
    except RecursionError:
        raise LumitreeError(f"{where}tables are nested too deep") from None


def check_table(value: object) -> Table:
    """The table that a value is; anything else is refused."""
    if not isinstance(value, dict):
        raise LumitreeError(f"it is {shown_value(value)}; expected {_TABLE}")
    return value


def check_version(table: object, version: int) -> Table:
    """The table of a file; refused if its "version" is another, with which it has other keys."""
    found = table.get("version") if isinstance(table, dict) else None
    if not isinstance(table, dict) or type(found) is not int or found != version:
        raise LumitreeError(f"its version is {shown_value(found)}; this lumitree reads {version}")
    return table


class _MismatchError(Exception):
    """A value is of another type; the message states what was expected."""


def object_of(values: object, kind: type[_T], name: str) -> _T:
    """As `converted`, within a table, by the fields of a dataclass."""
    if not isinstance(values, dict):
        raise LumitreeError(f"{name or 'the file'} is {shown_value(values)}; expected {_TABLE}")
    fields = _fields(kind)
    arguments = {}
    for key, value in values.items():
        full = shown(f"{name}.{key}" if name else key)
        if key not in fields:
            raise LumitreeError(f"unknown key {full!r}{did_you_mean(key, fields)}")
        try:
            arguments[key] = _value(value, fields[key].hint, full)
        except _MismatchError as wrong:
            raise LumitreeError(f"{full} is {shown_value(value)}; expected {wrong}") from None
    for key, field in fields.items():
        if field.is_required and key not in values:
            raise LumitreeError(f"{name or 'the file'} has no {key}")
    return kind(**arguments)


class _Field(NamedTuple):
    hint: object
    is_required: bool


@functools.cache
def _fields(kind: type) -> dict[str, _Field]:
    """Fields of a dataclass by name."""
    hints = typing.get_type_hints(kind, include_extras=True)
    missing = dataclasses.MISSING
    return {
        each.name: _Field(hints[each.name], each.default is each.default_factory is missing)
        for each in dataclasses.fields(kind)
    }


def _value(value: object, kind: object, name: str) -> Any:
    """A value of an annotated type."""
    if kind is float and is_number(value):
        return float(value)
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (types.UnionType, Union):
        return _one_of(value, arguments, name)
    if origin is Annotated:
        found = _value(value, arguments[0], name)
        if isinstance(limits := arguments[1], Range):
            low, high, above = limits
            if not low <= found <= high or (above and found == low):
                raise _MismatchError(
                    f"a number {'above' if above else 'of at least'} {low:g} and at most {high:g}"
                )
        return found
    if dataclasses.is_dataclass(kind):
        # A group of settings that the file does not have is an object already.
        if isinstance(value, cast(type, kind)):
            return value
        if isinstance(kind, OfTable):
            return kind.of_table(value, name)
        if isinstance(value, dict):
            return object_of(value, cast(Any, kind), name)
    if kind is types.NoneType and value is None:
        return None
    if kind in (int, bool, str) and type(value) is kind and value != "":
        return value
    if origin is Literal and any(type(value) is type(each) and value == each for each in arguments):
        return value
    if origin is dict and isinstance(value, dict):
        return value
    if isinstance(value, list | tuple):
        if origin is Collection or arguments[1:] == (...,):
            items = enumerate(value)
            return tuple(_value(each, arguments[0], f"{name}.{index}") for index, each in items)
        if origin is tuple and len(value) == len(arguments):
            try:
                pairs = zip(value, arguments, strict=True)
                return tuple(_value(each, of, name) for each, of in pairs)
            except _MismatchError:
                pass
    raise _MismatchError(_expected(kind))


def _one_of(value: object, kinds: tuple[object, ...], name: str) -> object:
    """A value of one of several types."""
    if isinstance(value, dict):
        tables = [each for each in kinds if dataclasses.is_dataclass(each)]
        known = [each for each in tables if value.keys() <= _fields(cast(type, each)).keys()]
        kinds = tuple(known[:1] or tables[:1]) or kinds
    elif value is None and types.NoneType in kinds:
        return None
    expected = []
    for each in kinds:
        try:
            return _value(value, each, name)
        except _MismatchError as wrong:
            expected.append(str(wrong))
    raise _MismatchError(" or ".join(filter(None, expected)))


_TABLE = "a table { ... }"
_EXPECTED = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}
_EXPECTED |= {dict: "tables", Collection: "a list of texts"}


def _expected(kind: object) -> str:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind):
        return _TABLE
    if origin is Literal:
        return " or ".join(map(repr, arguments))
    if origin is tuple:
        return "a list" if arguments[1:] == (...,) else f"{_lengths(kind)} numbers"
    return _EXPECTED.get(origin or kind, "")


def _lengths(kind: object) -> str:
    """Lengths of nested tuples, such as "4 x 4"."""
    inner = typing.get_args(kind)
    more = f" x {_lengths(inner[0])}" if typing.get_origin(inner[0]) is tuple else ""
    return f"{len(inner)}{more}"


def shown_value(value: object) -> str:
    """A value of a TOML file, for a message."""
    # A list may be of any length and depth.
    return repr(shown(value if isinstance(value, str) else reprlib.repr(value), 60))


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False
