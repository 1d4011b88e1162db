"""TOML files as objects of dataclasses, whose fields are the keys.

Error messages name the file and the key; of an unknown key, also the nearest known one.
"""

import contextlib
import dataclasses
import math
import re
import reprlib
import tomllib
import types
import typing
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeGuard, TypeVar, Union, cast

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


def read_toml(path: Path, expected: str) -> dict[str, Any]:
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


def converted(values: object, kind: type[_T], path: Path, name: str = "") -> _T:
    """A table as an object of a dataclass; keys that it lacks have the defaults of the class.

    Args:
        values: the table.
        kind: dataclass whose fields are numbers, texts, literals, tuples of numbers, collections of
            texts, dictionaries, such dataclasses, and unions of these.
        path: the file, for messages.
        name: name of the table in the file; empty for the whole file.

    Raises:
        LumitreeError: a key is unknown or missing, or a value is wrong.
    """
    try:
        return _object(values, kind, name)
    except LumitreeError as error:
        raise LumitreeError(f"{shown(path, 300)}: {' '.join(str(error).split())}") from None


class _MismatchError(Exception):
    """A value is of another type; the message states what was expected."""


def _object(values: object, kind: type[_T], name: str) -> _T:
    if not isinstance(values, dict):
        raise LumitreeError(f"{name} is {shown_value(values)}; expected a table {{ ... }}")
    hints = typing.get_type_hints(kind, include_extras=True)
    arguments = {}
    for key, value in values.items():
        full = shown(f"{name}.{key}" if name else key)
        if key not in hints:
            raise LumitreeError(f"unknown key {full!r}{did_you_mean(key, hints)}")
        try:
            arguments[key] = _value(value, hints[key], full)
        except _MismatchError as wrong:
            raise LumitreeError(f"{full} is {shown_value(value)}; expected {wrong}") from None
    for field in dataclasses.fields(cast(Any, kind)):
        if field.name not in values and _is_required(field):
            raise LumitreeError(f"{name} has no {field.name}")
    return kind(**arguments)


def _is_required(field: dataclasses.Field[Any]) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _value(value: object, kind: Any, name: str) -> Any:
    """A value of an annotated type."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (types.UnionType, Union):
        expected = []
        for each in arguments:
            try:
                return _value(value, each, name)
            except _MismatchError as wrong:
                expected.append(str(wrong))
        raise _MismatchError(" or ".join(filter(None, expected)))
    if origin is Annotated:
        low, high, above = arguments[1]
        number = _value(value, arguments[0], name)
        if not low <= number <= high or (above and number == low):
            raise _MismatchError(
                f"a number {'above' if above else 'of at least'} {low:g} and at most {high:g}"
            )
        return number
    if dataclasses.is_dataclass(kind):
        # A group of settings that the file does not have is an object already.
        return (
            value if isinstance(value, cast(type, kind)) else _object(value, cast(Any, kind), name)
        )
    if kind is types.NoneType and value is None:
        return None
    if kind is float and is_number(value):
        return float(value)
    if kind in (int, bool, str) and type(value) is kind and value != "":
        return value
    if origin is Literal and value in arguments:
        return value
    if origin is dict and isinstance(value, dict):
        return value
    if origin is tuple and isinstance(value, list | tuple) and len(value) == len(arguments):
        with contextlib.suppress(_MismatchError):
            return tuple(_value(each, of, name) for each, of in zip(value, arguments, strict=True))
    if origin is Collection and isinstance(value, list | tuple):
        return tuple(_value(each, arguments[0], name) for each in value)
    raise _MismatchError(_expected(kind, origin, arguments))


def _expected(kind: Any, origin: Any, arguments: tuple[Any, ...]) -> str:
    if origin is Literal:
        return " or ".join(map(repr, arguments))
    if origin is tuple:
        return f"{len(arguments)} numbers"
    names = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}
    return names.get(kind, {dict: "tables", Collection: "a list of texts"}.get(origin, ""))


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
