"""TOML files of the settings of a bake: a key is the name of a field, a table a group of fields."""

import dataclasses
import inspect
import sys
import textwrap
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lumitree.cli.signatures import meanings
from lumitree.core.tables import converted, read_toml
from lumitree.errors import LumitreeError, shown
from lumitree.fit.config import BakeConfig, Method, Quality

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_WIDTH = 98
_FURTHER = ("work", "variant")
_HEAD = """# Settings of 'lumitree bake --config FILE'. Remove the # before a setting to change it.
# "..." stands for None: the setting has no value unless it is given.

# Folder for the state, which is kept; it must be new, empty or of an earlier call. Default:
# the name of ASSET with .work, removed at the end.
#work = ...

# Mitsuba variant. Default: "llvm_ad_rgb".
#variant = ...
"""


def read_config(
    file: str, quality: Quality | None = None, method: Method | None = None
) -> tuple[BakeConfig, dict[str, Any], list[str]]:
    """Settings of a quality, with the values of a file; `method` replaces the file's.

    Returns:
        The settings; the arguments `work` and `variant` of `bake` that the file has; and the keys
        of the file, with the keys of its tables after a dot.

    Raises:
        LumitreeError: a key is unknown, or a value is of the wrong type or out of range; it names
            the file.
    """
    path = Path(file)
    values = read_toml(path, "a TOML file of settings")
    further = {name: values.pop(name) for name in _FURTHER if name in values}
    for name, value in further.items():
        if not isinstance(value, str):
            raise LumitreeError(f"{shown(file, 300)}: {name}: expected a text")
    names = _names(values)
    octree = values.get("octree")
    if isinstance(octree, dict) and "rays" in octree:
        # As for `bake`: a budget of rays replaces a budget of time.
        octree.setdefault("time", None)
    if method is not None:
        values["method"] = method
    # A wrong method is refused below, as all wrong values of the file are.
    base = BakeConfig.of(quality, "network" if values.get("method") == "network" else "octree")
    return converted(_completed(values, base), BakeConfig, path), further, names


def _names(values: dict[str, Any]) -> list[str]:
    """The keys of a table, and the keys of tables in it after a dot."""
    tables = {key: value for key, value in values.items() if isinstance(value, dict)}
    return [*values, *(f"{key}.{each}" for key, table in tables.items() for each in table)]


def _completed(values: dict[str, Any], config: "DataclassInstance") -> dict[str, Any]:
    """A table, with the fields of a dataclass that it lacks."""
    found = {field.name: getattr(config, field.name) for field in dataclasses.fields(config)}
    for name, value in values.items():
        group = isinstance(value, dict) and dataclasses.is_dataclass(found.get(name))
        found[name] = _completed(value, found[name]) if group else value
    return found


def write_config(
    file: str, quality: Quality | None = None, method: Method | None = None
) -> dict[str, str]:
    """Write the settings of a quality, with comments, to a file or, with "-", to the terminal."""
    from lumitree.core.files import write_bytes

    text = _HEAD + config_text(BakeConfig.of(quality, method or "octree"))
    if file == "-":
        sys.stdout.write(text)
    else:
        write_bytes(file, text.encode())
    return {"config": file}


def config_text(config: "DataclassInstance") -> str:
    """A TOML file of all settings and of what they mean. All values are commented out."""
    return "\n".join(_lines(config, "")) + "\n"


def _lines(config: "DataclassInstance", name: str) -> list[str]:
    helps = meanings(inspect.getdoc(type(config)) or "")
    fields = dataclasses.fields(config)
    groups = [each.name for each in fields if dataclasses.is_dataclass(getattr(config, each.name))]
    lines = []
    if name:
        summary = (type(config).__doc__ or "").partition("\n")[0]
        lines += ["", f"# {summary}", f"[{name}]"]
    for field in fields:
        if field.name not in groups:
            meaning = helps.get(field.name, "")
            if (limits := field.metadata.get("limits")) is not None:
                low, high = (f"{x:,}" if isinstance(x, int) else f"{x:g}" for x in limits)
                meaning += f" From {low} to {high}."
            comment = textwrap.wrap(meaning, _WIDTH, initial_indent="# ", subsequent_indent="# ")
            lines += ["", *comment] if meaning else []
            lines.append(f"#{field.name} = {_shown(getattr(config, field.name))}")
    for group in groups:
        lines += _lines(getattr(config, group), f"{name}.{group}" if name else group)
    return lines


def _shown(value: object) -> str:
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
