"""Reading files that may be missing, damaged or hostile: what is not as expected is refused.

Every refusal is one line of printable characters, whatever the file holds.
"""

import json
import os
import stat
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from lumitree.errors import LumitreeError, shown

_T = TypeVar("_T", bound=str | int)
# What NumPy raises for damaged archives; RuntimeError where a flag says that one is encrypted, and
# TypeError where the file is no archive but one array.
_DAMAGED_ARCHIVE = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    RuntimeError,
    TypeError,
    MemoryError,
    SyntaxError,
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    tokenize.TokenError,
)
# Characters of a name that a file keeps.
MAX_LABEL = 1000
# Characters of a value that a message shows.
_SHOWN = 60


def read_bytes(path: str | os.PathLike[str], expected: str, max_bytes: int) -> bytes:
    """The content of a regular file.

    Args:
        path: the file.
        expected: what should be there, for the message: "a .lumitree asset".
        max_bytes: longer files are refused.

    Raises:
        LumitreeError: there is no file, it is a folder, pipe or device, it cannot be read, or it
            is too long.
    """
    path, name = Path(path), shown(path, 300)
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise LumitreeError(f"{name} is not a regular file; expected {expected}")
        if found.st_size > max_bytes:
            raise LumitreeError(
                f"{name} has {found.st_size} bytes; expected {expected} of at most {max_bytes}"
            )
        return path.read_bytes()
    except FileNotFoundError:
        raise LumitreeError(f"{name} does not exist; expected {expected}") from None
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise LumitreeError(f"cannot read {name}: {reason}; expected {expected}") from None
    except ValueError:
        raise LumitreeError(f"{name} is no file name; expected {expected}") from None


def read_arrays(path: str | os.PathLike[str], *names: str) -> dict[str, NDArray[Any]]:
    """The arrays of an `.npz` archive, or those of some names; no code in it is run.

    Raises:
        LumitreeError: there is no file, it is damaged, or an array is missing.
    """
    if not os.path.isfile(path):
        raise LumitreeError(f"{path} is missing or no regular file")
    try:
        # Opened here: NumPy leaves a file open that turns out to be damaged.
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in names or archive.files}
    except _DAMAGED_ARCHIVE as error:
        raise LumitreeError(f"{path} is damaged ({type(error).__name__})") from None


def label(name: str) -> str:
    """A name as files keep it: at most `MAX_LABEL` characters, "?" for unprintable ones."""
    return shown(name[:MAX_LABEL], MAX_LABEL)


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text; stricter than `json.loads`.

    Raises:
        LumitreeError: it is no JSON, an object has two members of one name, it is nested too
            deep, or it holds NaN or infinity.
    """
    try:
        # From bytes json.loads would also take UTF-16 and UTF-32.
        text = text if isinstance(text, str) else text.decode()
        return json.loads(text, object_pairs_hook=_members, parse_constant=_refuse_constant)
    except RecursionError:
        raise LumitreeError("JSON nested too deep") from None
    except json.JSONDecodeError as error:
        raise LumitreeError(f"no JSON: {error}") from None
    # Of bytes that are no UTF-8, and of integers too long to convert.
    except ValueError as error:
        raise LumitreeError(f"no JSON: {type(error).__name__}") from None


class Record:
    """A JSON object whose members are read by type and range.

    Args:
        value: what `parse_json` returned, or a part of it.
        what: it is, for messages.

    Raises:
        LumitreeError: it is no object; so do all methods where a member is not as expected.
    """

    def __init__(self, value: Any, what: str) -> None:
        if not isinstance(value, dict):
            raise LumitreeError(f"{what} is {_shown(value)}; expected a JSON object")
        self._members, self._what = value, what

    def expect_version(self, version: int) -> None:
        """Refuse an object whose member "version" is another; to be called before `expect_keys`."""
        found = self._members.get("version")
        if type(found) is not int or found != version:
            raise LumitreeError(
                f"{self._what} has version {_shown(found)}, this lumitree reads {version}"
            )

    def expect_keys(self, *keys: str) -> None:
        """Refuse an object that has not exactly the members of these names."""
        for verb, names in (
            ("lacks", keys - self._members.keys()),
            ("has the unknown key", self._members.keys() - keys),
        ):
            if names:
                raise LumitreeError(f"{self._what} {verb} {_shown(min(names))}")

    def choice(self, key: str, options: Sequence[_T]) -> _T:
        """A member that is one of some strings or integers."""
        value = self._members.get(key)
        for option in options:
            if type(value) is type(option) and value == option:
                return option
        self._refuse(key, " or ".join(map(_shown, options)))

    def record(self, key: str) -> "Record":
        """A member that is an object."""
        return Record(self._members.get(key), f"{key} of {self._what}")

    def members(self, key: str) -> dict[str, Any]:
        """The members of a member that is an object, as they are."""
        return self.record(key)._members

    def text(self, key: str, max_length: int) -> str:
        """A member that is printable text."""
        value = self._members.get(key)
        if type(value) is not str or len(value) > max_length or not value.isprintable():
            self._refuse(key, f"printable text of at most {max_length} characters")
        return value

    def label(self, key: str) -> str:
        """A member that `label` could have returned."""
        return self.text(key, MAX_LABEL)

    def integer(self, key: str) -> int:
        """A member that is an integer."""
        value = self._members.get(key)
        if type(value) is not int:
            self._refuse(key, "an integer")
        return value

    def number(self, key: str) -> float:
        """A member that is a finite number."""
        value = _number(self._members.get(key))
        if value is None:
            self._refuse(key, "a number")
        return value

    def array(self, key: str, *shape: int) -> NDArray[np.float64]:
        """A member that is an array of finite numbers, nested lists of the given lengths."""
        flat = _flat(self._members.get(key), shape)
        if flat is None:
            lengths = " x ".join(map(str, shape))
            self._refuse(key, f"{lengths} numbers")
        return np.array(flat).reshape(shape)

    def integers(self, key: str) -> list[int]:
        """A member that is a list of integers."""
        value = self._members.get(key)
        if type(value) is not list or any(type(item) is not int for item in value):
            self._refuse(key, "a list of integers")
        return value

    def items(self, key: str) -> list[Any]:
        """A member that is a list."""
        value = self._members.get(key)
        if type(value) is not list:
            self._refuse(key, "a list")
        return value

    def _refuse(self, key: str, expected: str) -> NoReturn:
        found = _shown(self._members.get(key))
        raise LumitreeError(f"{key} of {self._what} is {found}; expected {expected}")


def _members(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) < len(pairs):
        raise LumitreeError("a JSON object has two members of one name")
    return members


def _refuse_constant(name: str) -> Any:
    raise LumitreeError(f"JSON holds {name}; expected finite numbers")


def _number(value: Any) -> float | None:
    """A finite float, or None for everything else; true and false are no numbers."""
    if type(value) not in (int, float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if np.isfinite(number) else None


def _flat(value: Any, shape: tuple[int, ...]) -> list[float] | None:
    """The numbers of nested lists of these lengths, or None."""
    if not shape:
        number = _number(value)
        return None if number is None else [number]
    if type(value) is not list or len(value) != shape[0]:
        return None
    flat: list[float] = []
    for item in value:
        numbers = _flat(item, shape[1:])
        if numbers is None:
            return None
        flat += numbers
    return flat


def _shown(value: Any) -> str:
    """A value for a message: cut, and in printable ASCII."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return shown(json.dumps(value), _SHOWN)
