"""TOML files of the settings of a bake: a key is the name of a field, a table a group of fields."""

import dataclasses
import re
import textwrap
import types
import typing
from collections.abc import Callable, Collection
from typing import Any, Literal, TypeVar

from lumitree.core.toml_table import Table, UnexpectedError, boolean, is_number, text
from lumitree.errors import LumitreeError

_T = TypeVar("_T")
_WIDTH = 98


def read_config(table: Table, config: _T) -> tuple[_T, list[str]]:
    """Settings of a table, over others.

    Args:
        table: of the file, or of a group.
        config: dataclass whose fields are replaced where the table has them.

    Returns:
        The settings, and the full names of the fields that the table has.

    Raises:
        LumitreeError: a value is of the wrong type or out of range; it names the file.
    """
    given: list[str] = []
    values: dict[str, Any] = {}
    hints = typing.get_type_hints(type(config))
    for field in dataclasses.fields(typing.cast(Any, config)):
        old = getattr(config, field.name)
        if dataclasses.is_dataclass(old):
            group = table.table(field.name)
            if group is not None:
                values[field.name], names = read_config(group, old)
                given += [f"{field.name}.{name}" for name in names]
                group.finish()
        elif (value := table.take(field.name, _reader(hints[field.name]))) is not None:
            values[field.name] = value
            given.append(field.name)
    if "rays" in given and "time" not in given and "time" in hints:
        # As on a command line: a budget of rays replaces a budget of time.
        values["time"] = None
    try:
        return dataclasses.replace(typing.cast(Any, config), **values), given
    except LumitreeError as error:
        table.fail(str(error))


def config_text(config: Any) -> str:
    """A TOML file of all settings and of what they mean. All values are commented out."""
    return "\n".join(_lines(config, "")) + "\n"


def _lines(config: Any, name: str) -> list[str]:
    meanings = _meanings(type(config))
    fields = dataclasses.fields(config)
    groups = [each.name for each in fields if dataclasses.is_dataclass(getattr(config, each.name))]
    lines = []
    if name:
        summary = (type(config).__doc__ or "").partition("\n")[0]
        lines += ["", f"# {summary}", f"[{name}]"]
    for field in fields:
        if field.name not in groups:
            meaning = meanings.get(field.name, "")
            if (limits := field.metadata.get("limits")) is not None:
                low, high = (f"{x:,}" if isinstance(x, int) else f"{x:g}" for x in limits)
                meaning += f" From {low} to {high}."
            lines += ["", *_comment(meaning)] if meaning else []
            lines.append(f"#{field.name} = {_shown(getattr(config, field.name))}")
    for group in groups:
        lines += _lines(getattr(config, group), f"{name}.{group}" if name else group)
    return lines


def _meanings(kind: type) -> dict[str, str]:
    """Descriptions of the fields of a dataclass, from its docstring."""
    section = (kind.__doc__ or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    entries = re.findall(r"^ {8}(\w[\w, ]*):((?:.*\n?)(?: {12}.*\n?)*)", section, re.MULTILINE)
    return {name: " ".join(meant.split()) for names, meant in entries for name in names.split(", ")}


def _comment(meaning: str) -> list[str]:
    meaning = meaning[0].upper() + meaning[1:]
    return textwrap.wrap(meaning, _WIDTH, initial_indent="# ", subsequent_indent="# ")


def _shown(value: Any) -> str:
    """A value in TOML, or "..." for None, which TOML does not have."""
    if value is None:
        return "..."
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Collection):
        return "[" + ", ".join(map(_shown, value)) + "]"
    return repr(value)


def _reader(hint: Any) -> Callable[[Any], Any]:
    """Reader of the values of a field, by its annotation."""
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        (hint,) = (each for each in typing.get_args(hint) if each is not types.NoneType)
    if hint is bool:
        return boolean
    if hint is int:
        return _whole
    if hint is float:
        return _number
    return text if hint is str or typing.get_origin(hint) is Literal else _texts


def _whole(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise UnexpectedError("a whole number")
    return value


def _number(value: Any) -> float:
    if not is_number(value):
        raise UnexpectedError("a number")
    return float(value)


def _texts(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
        raise UnexpectedError("a list of texts")
    return tuple(value)
