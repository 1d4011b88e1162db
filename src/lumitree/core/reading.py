"""Strict reading of files that may be missing, damaged or hostile.

Whatever a file holds, an error message is one line of printable characters.
"""

import contextlib
import json
import os
import stat
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from lumitree.core.files import check_utf8
from lumitree.errors import LumitreeError, shown

_T = TypeVar("_T", bound=str | int)
# Exceptions of NumPy for damaged archives: also RuntimeError if a flag marks one as encrypted, and
# TypeError if the file is a single array.
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
# Bytes of a compressed archive in memory, unless it has as many on disk.
_MAX_UNPACKED = 2**28
# Largest number of characters of a name in a file.
MAX_LABEL = 1000
# Largest number of characters of a value in a message.
_SHOWN = 60


def read_bytes(path: str | os.PathLike[str], expected: str, max_bytes: int) -> bytes:
    """The content of a regular file.

    Args:
        path: the file.
        expected: kind of file that is expected, for the message, such as "a .lumitree asset".
        max_bytes: largest size that is accepted; a larger file is not read into memory.

    Raises:
        LumitreeError: the file is missing, not regular (a folder, pipe or device), not readable or
            too large, or its name is not UTF-8.
    """
    check_utf8(path)
    path, name, limit = Path(path), shown(path, 300), max(max_bytes, 0)
    try:
        # Checked before the file is opened: opening a pipe would block.
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            kind = "a folder" if stat.S_ISDIR(found.st_mode) else "not a regular file"
            raise LumitreeError(f"{name} is {kind}; expected {expected}")
        if found.st_size > limit:
            size = f"{limit // 2**20} MiB" if limit >= 2**20 else f"{limit} bytes"
            raise LumitreeError(f"{name} is larger than {size}, the limit for {expected}")
        with path.open("rb") as file:
            # Bounded, since the file may have grown.
            return file.read(found.st_size)
    except FileNotFoundError:
        raise LumitreeError(f"{name} does not exist; expected {expected}") from None
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise LumitreeError(f"cannot read {name}: {reason}; expected {expected}") from None
    except ValueError:
        raise LumitreeError(f"{name} is not a file name; expected {expected}") from None


def read_arrays(path: str | os.PathLike[str], *names: str) -> dict[str, NDArray[Any]]:
    """The arrays with the given names of an `.npz` archive, or all; no code in it is run.

    Raises:
        LumitreeError: the file is missing or damaged, an array is missing, or the arrays are larger
            than 256 MiB and than the file.
    """
    if not os.path.isfile(path):
        raise LumitreeError(f"{path} is missing or no regular file")
    limit = max(os.path.getsize(path), _MAX_UNPACKED)
    try:
        # Opened here, because NumPy does not close a damaged file.
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            if sum(member.file_size for member in archive.zip.infolist()) > limit:
                raise LumitreeError(f"{path} is larger than {limit // 2**20} MiB in memory")
            return {name: archive[name] for name in names or archive.files}
    except _DAMAGED_ARCHIVE as error:
        raise LumitreeError(f"{path} is damaged ({type(error).__name__})") from None


def label(name: str) -> str:
    """A name for a file: cut to `MAX_LABEL` characters, with "?" for unprintable ones."""
    return shown(name[:MAX_LABEL], MAX_LABEL)


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text; stricter than `json.loads`.

    Raises:
        LumitreeError: the text is not JSON, an object repeats a key, objects are nested too
            deeply, or a number is NaN or infinite.
    """
    try:
        # Given bytes, json.loads would also accept UTF-16 and UTF-32.
        text = text if isinstance(text, str) else text.decode()
        return json.loads(text, object_pairs_hook=_members, parse_constant=_refuse_constant)
    except RecursionError:
        raise LumitreeError("JSON nested too deep") from None
    except json.JSONDecodeError as error:
        raise LumitreeError(f"not valid JSON: {error}") from None
    # Raised for bytes that are not UTF-8, and for integers too long to convert.
    except ValueError as error:
        raise LumitreeError(f"not valid JSON: {type(error).__name__}") from None


class Record:
    """A JSON object whose members are checked as they are read.

    Args:
        value: the result of `parse_json`, or a part of it.
        what: name of the object, for messages.

    Raises:
        LumitreeError: `value` is not an object. All methods raise it for a member that is missing,
            or that has another type or range.
    """

    def __init__(self, value: Any, what: str) -> None:
        if not isinstance(value, dict):
            raise LumitreeError(f"{what} is {_shown(value)}; expected a JSON object")
        self._members, self._what = value, what

    def expect_version(self, version: int) -> None:
        """Refuse another "version" than this. To be called before `expect_keys`."""
        found = self._members.get("version")
        if type(found) is not int or found != version:
            raise LumitreeError(
                f"{self._what} has version {_shown(found)}, this lumitree reads {version}"
            )

    def has(self, key: str) -> bool:
        """Whether the object has a member."""
        return key in self._members

    def is_null(self, key: str) -> bool:
        """Whether a member is null."""
        return self._members.get(key) is None

    def is_object(self, key: str) -> bool:
        """Whether a member is an object."""
        return isinstance(self._members.get(key), dict)

    def expect_keys(self, *keys: str, optional: Sequence[str] = ()) -> None:
        """Refuse an object that lacks one of these keys, or has one that is not optional either."""
        for verb, names in (
            ("lacks", keys - self._members.keys()),
            ("has the unknown key", self._members.keys() - {*keys, *optional}),
        ):
            if names:
                raise LumitreeError(f"{self._what} {verb} {_shown(min(names))}")

    def choice(self, key: str, options: Sequence[_T]) -> _T:
        """A member that is one of the given strings or integers."""
        value = self._members.get(key)
        for option in options:
            if type(value) is type(option) and value == option:
                return option
        self._refuse(key, " or ".join(map(_shown, options)))

    def record(self, key: str) -> "Record":
        """A member that is an object."""
        return Record(self._members.get(key), f"{key} of {self._what}")

    def members(self, key: str) -> dict[str, Any]:
        """The members of a member that is an object, unchecked."""
        return self.record(key)._members

    def text(self, key: str, max_length: int) -> str:
        """A member that is printable text of at most `max_length` characters."""
        value = self._members.get(key)
        if type(value) is not str or len(value) > max_length or not value.isprintable():
            self._refuse(key, f"printable text of at most {max_length} characters")
        return value

    def label(self, key: str) -> str:
        """A member that is a name as `label` returns it."""
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
    """A finite float, or None for everything else; true and false are not numbers."""
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
    """A value for a message, shortened and in printable ASCII."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return shown(json.dumps(value), _SHOWN)


def require(condition: Any, message: str) -> None:
    """Raise a `LumitreeError` with a message if the condition is false."""
    if not condition:
        raise LumitreeError(message)


def expect(what: str, condition: Any, message: str) -> None:
    """Refuse `what` with a message if the condition is false."""
    require(condition, f"invalid {what}: {message}")


def expect_range(
    what: str, name: str, value: object, kind: type[int] | type[float], low: float, high: float
) -> None:
    """Refuse `what` unless a member of it is a number of a kind in a range. An int is a float."""
    kinds = (int, float) if kind is float else (int,)
    known = isinstance(value, kinds) and not isinstance(value, bool) and low <= value <= high
    expect(what, known, f"{name} {value!r}, expected {low:g} to {high:g}")


@contextlib.contextmanager
def naming(name: Callable[[], str]) -> Iterator[None]:
    """Context in which messages of a `LumitreeError` begin with a name, which is made on demand."""
    try:
        yield
    except LumitreeError as error:
        raise LumitreeError(f"{name()}: {error}") from None


def expect_arrays(
    what: str, arrays: dict[str, tuple[NDArray[Any], type[np.generic], tuple[int, ...]]]
) -> None:
    """Refuse `what` if one of its arrays has not the type and shape that are listed with it."""
    for name, (array, dtype, shape) in arrays.items():
        expect(
            what,
            array.dtype == dtype and array.shape == shape,
            f"{name} is {array.dtype} {array.shape}, expected {np.dtype(dtype)} {shape}",
        )
