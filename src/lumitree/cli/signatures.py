"""Commands from the signatures and docstrings of public functions.

They are read from the source, so that `--help` and completion import none of it: `__init__.pyi`
says in which module a public name is. A parameter of a function is an option of its command, with
the same name and default, and its description in the docstring is the help. Parameters without a
default are positional.
"""

import ast
import dataclasses
import functools
import glob
import inspect
import math
import os
import re
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from lumitree.errors import LumitreeError, shown

NEEDED = inspect.Parameter.empty
_KINDS = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_ONLY)
_ROOT = Path(__file__).parents[1]
_SECTIONS = r"^(?:Args|Attributes|Returns|Raises|Example):\n"
# Not read from the registry, whose imports take longer than a completion may.
BUILTIN_NAMES = ("arc", "bulbs", "cluster", "dallas", "neoclassical", "portica", "star")
_FILES = (".xml", ".obj", ".gltf", ".glb", ".lumitree", ".ies", ".ldt", ".gldf", ".tm33", ".ray")
_PLAIN = {"bool": bool, "int": int, "float": float}
# How a value is written, after the help of the parameter of Python.
_WRITTEN = {
    "parts": " Separated by commas, such as light,field; or all.",
    "time": " Such as 90, 90s, 5m or 1.5h.",
}
# Names of what a command writes.
OUTPUTS = ("output", "json", "layers", "aov", "luminance")


@dataclasses.dataclass(frozen=True)
class Option:
    """An argument of a command: its type for cyclopts; `NEEDED` stands for no default.

    A positional one may be several arguments, between which options may stand.
    """

    type: Any
    help: str
    default: Any = None
    positional: bool = False
    several: bool = False

    @property
    def _kind(self) -> Any:
        kind = inspect.Parameter
        if self.several:
            return kind.VAR_POSITIONAL
        return kind.POSITIONAL_ONLY if self.positional else kind.KEYWORD_ONLY


def described(name: str) -> tuple[str, str]:
    """First sentence and further text of the docstring of a public function."""
    summary, _, rest = (ast.get_docstring(_definition(name)) or "").partition("\n\n")
    text = re.split(_SECTIONS, rest, maxsplit=1, flags=re.M)[0].strip()
    return _joined(summary), "\n\n".join(map(_joined, text.split("\n\n")))


def options_of(name: str) -> dict[str, Option]:
    """The parameters of a public function, or the fields of a dataclass, that can be options."""
    module, found = _public()[name], _definition(name)
    helps = meanings(ast.get_docstring(found) or "")
    options = {}
    if isinstance(found, ast.ClassDef):
        for base in map(ast.unparse, found.bases):
            options |= options_of(base) if base in _public() else {}
    for parameter, annotation, default in _parameters(found):
        if (kind := _option_type(parameter, annotation, module)) is not None:
            options[parameter] = Option(
                kind,
                helps.get(parameter, "") + _WRITTEN.get(parameter, ""),
                NEEDED if default is None else _value(default, module),
                positional=default is None and parameter != "output",
            )
    return options


def with_signature(
    run: Callable[..., Any], summary: str, text: str, options: Mapping[str, Option]
) -> Callable[..., Any]:
    """`run` with the signature of a command; it gets the arguments that were given."""

    ordered = sorted(options.items(), key=lambda item: not item[1].positional)

    def call(*given: Any, **named: Any) -> Any:
        if ordered and ordered[0][1].several:
            return run({ordered[0][0]: given} | named)
        positional = {name: value for (name, _), value in zip(ordered, given, strict=False)}
        return run(positional | named)

    parameters = [
        inspect.Parameter(
            name,
            each._kind,
            default=NEEDED if each.several else each.default,
            annotation=Annotated[
                Annotated[int, Parameter(converter=whole)] if each.type is int else each.type,
                Parameter(help=each.help, show_default=each.default not in (None, ())),
            ],
        )
        for name, each in ordered
    ]
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {each.name: each.annotation for each in parameters}
    call.__doc__ = f"{summary}\n\n{text}"
    return call


@functools.cache
def _public() -> dict[str, str]:
    """Modules of the public names, and of the demonstration."""
    found = {"demo": "lumitree.demo"}
    for each in ast.parse((_ROOT / "__init__.pyi").read_text(encoding="utf-8")).body:
        if isinstance(each, ast.ImportFrom):
            found |= {name.asname or name.name: each.module or "" for name in each.names}
    return found


def _definition(name: str) -> ast.FunctionDef | ast.ClassDef:
    """The definition of a public function or class."""
    for each in _tree(_public()[name]).body:
        if isinstance(each, ast.FunctionDef | ast.ClassDef) and each.name == name:
            return each
    raise AssertionError(f"no definition of {name}")


@functools.cache
def _tree(module: str) -> ast.Module:
    return ast.parse((_ROOT / _path(module)).read_text(encoding="utf-8"))


def _path(module: str) -> str:
    return f"{module.removeprefix('lumitree.').replace('.', '/')}.py"


def _parameters(
    found: ast.FunctionDef | ast.ClassDef,
) -> Iterable[tuple[str, ast.expr, ast.expr | None]]:
    """Name, annotation and default of the parameters of a function or the fields of a class."""
    if isinstance(found, ast.ClassDef):
        for each in found.body:
            if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name):
                yield each.target.id, each.annotation, each.value
        return
    arguments = found.args
    defaults = [None] * (len(arguments.args) - len(arguments.defaults)) + arguments.defaults
    for argument, default in (
        *zip(arguments.args, defaults, strict=True),
        *zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True),
    ):
        assert argument.annotation is not None
        yield argument.arg, argument.annotation, default


def meanings(doc: str) -> dict[str, str]:
    """Descriptions of parameters or fields, from a docstring without indentation."""
    section = re.split(r"^(?:Args|Attributes):\n", doc, maxsplit=1, flags=re.M)[-1]
    section = section.partition("\n\n")[0]
    entries = re.findall(r"^ {4}(\w[\w, ]*):((?:.*\n?)(?: {8}.*\n?)*)", section, re.M)
    return {name: _joined(text) for names, text in entries for name in names.split(", ")}


def _joined(text: str) -> str:
    """Lines of a paragraph as one line, with a capital; lists keep their lines."""
    text = re.sub(r"\s*\n\s*(?!\s*\* )", " ", text.strip())
    return text[:1].upper() + text[1:]


def _option_type(name: str, annotation: ast.expr, module: str) -> Any:
    """The type of an option for cyclopts; None if a command line has no values of the type."""
    text = ast.unparse(annotation).strip("'\"")
    alias = "-o" if name == "output" else ()
    if name == "time":
        return Annotated[float | None, Parameter(converter=one(duration), metavar="T")]
    if name == "grid":
        return Annotated[tuple[int, ...] | None, Parameter(converter=one(grid), metavar="3x2")]
    if name == "pitch":
        return vector(2, 3)
    if name == "parts":
        return Annotated[tuple[str, ...] | None, Parameter(converter=one(parts), n_tokens=1)]
    if "LuminaireLike" in text or "Asset" in text:
        return Annotated[Path, Parameter(converter=one(str), completer=lamps)]
    if text.startswith(("FilePath | Sequence", "Sequence[FilePath")):
        return Annotated[list[Path], Parameter(converter=each_text, n_tokens=1, alias=alias)]
    if "FilePath" in text:
        return Annotated[Path | None, Parameter(converter=one(str), alias=alias)]
    if "tuple[float" in text:
        counts = [text.count("float") - text.startswith("float"), *[1] * text.startswith("float")]
        return vector(*counts)
    if text == "float | str":
        return Annotated[str, Parameter(converter=one(number), allow_leading_hyphen=True)]
    if (choices := _choices(annotation, module)) is not None:
        return Literal[choices]  # type: ignore[valid-type]
    return TEXT if text.startswith("str") else _PLAIN.get(text.removesuffix(" | None"))


def _choices(annotation: ast.expr, module: str) -> tuple[str, ...] | None:
    """The values of a `Literal`, or of a name for one."""
    if isinstance(annotation, ast.BinOp):
        annotation = annotation.left
    if isinstance(annotation, ast.Name):
        found = _assigned(annotation.id, module)
        return None if found is None else _choices(*found)
    if isinstance(annotation, ast.Subscript) and ast.unparse(annotation.value) == "Literal":
        values = ast.literal_eval(annotation.slice)
        return values if isinstance(values, tuple) else (values,)
    return None


def _assigned(name: str, module: str) -> tuple[ast.expr, str] | None:
    """The value of a constant of a module, or of one that it imports, and its module."""
    if not (_ROOT / _path(module)).exists():
        return None
    for each in _tree(module).body:
        if isinstance(each, ast.Assign) and ast.unparse(each.targets[0]) == name:
            return each.value, module
        if isinstance(each, ast.ImportFrom) and any(alias.name == name for alias in each.names):
            return _assigned(name, each.module or "")
    return None


def _value(default: ast.expr, module: str) -> Any:
    """A default: a constant, or None for what is not one."""
    if isinstance(default, ast.Name):
        found = _assigned(default.id, module)
        return None if found is None else _value(*found)
    try:
        return eval(compile(ast.Expression(default), module, "eval"), {"__builtins__": {}})
    except (NameError, AttributeError):
        return None


def lamps(context: Any) -> list[str]:
    """Completions of a source of light: built-in names, files and folders."""
    begun = context.incomplete
    names = [name for name in BUILTIN_NAMES if name.startswith(begun)]
    for path in glob.glob(glob.escape(begun) + "*"):
        if os.path.isdir(path):
            names.append(path + "/")
        elif path.lower().endswith(_FILES):
            names.append(path)
    return names


def value_of(option: str | None, text: str) -> str:
    """The value of an option or of an argument; refuses an empty one, and another option."""
    if not text or (option is not None and text.startswith("--")):
        found = shown(repr(text), 60)
        raise LumitreeError(f"{option or 'an argument'} needs a value; found {found}")
    return text


def one(read: Callable[[str], Any]) -> Callable[[Any, Sequence[Any]], Any]:
    """A converter for cyclopts of one text."""
    return lambda _, tokens: read(value_of(tokens[0].keyword, tokens[0].value))


def whole(_: Any, tokens: Sequence[Any]) -> int:
    """A converter for cyclopts of a whole number: its own rounds numbers such as 1.5."""
    (token,) = tokens
    try:
        return int(token.value)
    except ValueError:
        raise LumitreeError(
            f"{token.keyword} is {shown(repr(token.value), 60)}; expected a whole number"
        ) from None


def each_text(_: Any, tokens: Sequence[Any]) -> list[str]:
    """A converter for cyclopts of texts."""
    return [value_of(token.keyword, token.value) for token in tokens]


TEXT = Annotated[str, Parameter(converter=one(str))]
TEXTS = Annotated[list[str], Parameter(converter=each_text)]


def parts(text: str) -> tuple[str, ...]:
    """Parts of an asset, separated by commas; "all" for all."""
    return ("light", "field", "geometry") if text == "all" else tuple(text.split(","))


def grid(text: str) -> tuple[int, ...]:
    """Whole numbers that are separated by "x"."""
    counts = text.lower().split("x")
    if not all(map(str.isdecimal, counts)):
        raise LumitreeError(f"grid is {text!r}; expected whole numbers such as 3x2")
    return tuple(map(int, counts))


def duration(text: str) -> float:
    """Seconds of a duration such as 90, 90s, 5m or 1.5h."""
    factor = {"s": 1, "m": 60, "h": 3600}.get(text[-1:])
    try:
        value = float(text if factor is None else text[:-1]) * (factor or 1)
    except ValueError:
        value = -1.0
    if not 0 < value < math.inf:
        raise LumitreeError(f"{text!r} is not a duration; write 90s, 5m or 1h")
    return value


def vector(*counts: int) -> Any:
    """The type of numbers that are separated by commas, as many as one of `counts`."""

    def read(text: str) -> tuple[float, ...] | float:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) not in counts or not all(map(math.isfinite, values)):
            expected = f"{' or '.join(map(str, counts))} finite numbers"
            raise LumitreeError(f"{text!r} is not {expected} separated by commas")
        return values[0] if len(values) == 1 else values

    settings = Parameter(
        converter=one(read), n_tokens=1, allow_leading_hyphen=True, metavar="X,Y,..."
    )
    return Annotated[tuple[float, ...] | None, settings]


def number(text: str) -> float | str:
    """A number, or the text if it is none."""
    try:
        return float(text)
    except ValueError:
        return text


def convert(name: str, option: Option, text: str) -> Any:
    """The value of an option of a group, which cyclopts does not parse."""
    for each in typing.get_args(option.type)[1:]:
        if each.converter is not None:
            return each.converter(None, [SimpleNamespace(keyword=f"--{name}", value=text)])
    if "float" not in str(option.type):
        return text
    value = number(text)
    if isinstance(value, str):
        raise LumitreeError(f"--{name} is {text!r}; expected a number")
    return value
