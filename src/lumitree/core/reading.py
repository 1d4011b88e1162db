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
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from lumitree.core.files import check_utf8
from lumitree.errors import LumitreeError, shown

# Arrays by name, of any types.
Arrays = dict[str, NDArray[Any]]
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


def read_arrays(path: str | os.PathLike[str], *names: str) -> Arrays:
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


def parse_json(text: str | bytes) -> object:
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


def _members(pairs: list[tuple[str, object]]) -> dict[str, object]:
    members = dict(pairs)
    if len(members) < len(pairs):
        raise LumitreeError("a JSON object has two members of one name")
    return members


def _refuse_constant(name: str) -> NoReturn:
    raise LumitreeError(f"JSON holds {name}; expected finite numbers")


def require(condition: object, message: str) -> None:
    """Raise a `LumitreeError` with a message if the condition is false."""
    if not condition:
        raise LumitreeError(message)


def expect(what: str, condition: object, message: str) -> None:
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
    what: str, arrays: dict[str, tuple[NDArray[np.generic], type[np.generic], tuple[int, ...]]]
) -> None:
    """Refuse `what` if one of its arrays has not the type and shape that are listed with it."""
    for name, (array, dtype, shape) in arrays.items():
        expect(
            what,
            array.dtype == dtype and array.shape == shape,
            f"{name} is {array.dtype} {array.shape}, expected {np.dtype(dtype)} {shape}",
        )
