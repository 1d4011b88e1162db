"""Atomic writing of files: a file with the final name is always complete."""

import contextlib
import errno
import json
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

from lumitree.core.system import (
    accepts_name,
    is_read_only,
    is_writable,
    keep,
    lock,
    longest_name,
    release,
    remove,
    replace,
)
from lumitree.core.text import check_utf8
from lumitree.errors import LumitreeError, shown

# The part of a temporary name before its random characters, and the pattern of the whole name.
TEMPORARY = ".lumitree-"
# Temporary folders have names that begin so.
SCRATCH = "lumitree-scratch-"
# Messages of the system about a full disk; libraries repeat them in their own.
_FULL = {
    number: text
    for number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    # Windows has no quota of this kind, and no text for it.
    if not (text := os.strerror(number)).startswith("Unknown error")
}
# A folder of more entries is listed at most once in so many seconds; when, by its path.
_LARGE_FOLDER, _LIST_AGAIN_SECONDS = 1000, 60.0
_listed_again: dict[str, float] = {}
# Bytes, more than what C++ keeps back until a file is closed.
_BUFFER = 1 << 14
_TEMPORARY_NAME = re.compile(
    r"\.(?P<stem>.*)\.lumitree-[a-z0-9_]{8}(?P<suffix>(\.[^.]*)?)", re.DOTALL
)

FilePath = str | os.PathLike[str]


class WriteError(LumitreeError):
    """A file cannot be written.

    Attributes:
        path: the file.
        reason: why, as the system says it.
        full: whether its disk is full.
    """

    def __init__(self, path: Path, error: Exception, what: str = "", remedy: str = "") -> None:
        """Describe what went wrong.

        Args:
            error: of the system, or of the library that wrote the file.
            what: what cannot be written. Default: the path, or for a file of a temporary folder,
                whose name means nothing, where that is.
            remedy: what to do. Default: choose another output, or place for temporary files.
        """
        scratch = next((each for each in path.parents if each.name.startswith(SCRATCH)), None)
        if scratch is not None:
            what = f"temporary files in {shown(scratch.parent, 400)}"
            remedy = "name another folder with TMPDIR"
        number = getattr(error, "errno", None)
        text = getattr(error, "strerror", None) or " ".join(str(error).split())
        reasons = [reason for key, reason in _FULL.items() if key == number or reason in text]
        self.path, self.full = path, bool(reasons)
        self.reason = shown(reasons[0] if reasons else text, 400)
        first = "free some space or " if self.full else ""
        super().__init__(
            f"cannot write {what or shown(path, 400)}: {self.reason}; "
            f"{first}{remedy or 'choose another output'}"
        )


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary name; rename it to `path` if the block succeeds.

    Links are followed: the file to which they lead is replaced. A stream (see `is_stream`) is never
    replaced: the content of the temporary file is written to it.

    The temporary file is flushed to disk before the rename, and removed if the block fails.
    Temporary files that killed processes left for the same `path` are removed too.

    Raises:
        WriteError: the folder cannot be written, or the disk is full.
        LumitreeError: `path` is a folder or another object that is no file; see `is_stream`.
    """
    check_utf8(path)
    path = Path(path)
    try:
        streamed = is_stream(path)
        target = Path(tempfile.gettempdir(), path.name) if streamed else destination(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(target)
        handle, temporary = _create_locked(target)
    except (OSError, ValueError) as error:
        raise WriteError(path, error) from error
    try:
        yield temporary
        flush_to_disk(temporary)
        if streamed:
            _send(temporary, path)
        else:
            # mkstemp creates 0600; a finished result follows the user's umask.
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(temporary, 0o666 & ~umask)
            replace(temporary, target)
    except Exception as error:
        raise_write_error(path, error)
    finally:
        release(handle)
        # Where that fails, what went wrong before says more.
        with contextlib.suppress(OSError):
            remove(temporary)


def destination(path: Path) -> Path:
    """The path of the file or folder to which links lead; it may not exist."""
    return Path(os.path.realpath(path))


def is_stream(path: Path) -> bool:
    """Whether an output is written to as a stream, and not replaced.

    Streams are standard output and error, also under the name of a file to which they are
    redirected; character devices such as `/dev/null`; and pipes that only have a name under
    `/dev/fd`.

    Raises:
        LumitreeError: `path` is a folder, a named pipe, a socket or a disk.
        OSError: the system does not say what it is.
    """
    try:
        found = os.stat(path)
    except FileNotFoundError:
        return False
    kind = found.st_mode
    if _standard_stream(found) is not None or stat.S_ISCHR(kind):
        return True
    if stat.S_ISREG(kind):
        return False
    if stat.S_ISDIR(kind):
        raise LumitreeError(
            f"cannot write {shown(path, 400)}: it is a folder; choose a file with -o"
        )
    if stat.S_ISFIFO(kind) and not destination(path).exists():
        return True
    raise LumitreeError(
        f"cannot write {shown(path, 400)}: it is a pipe, a socket or a disk; choose a file, or "
        "/dev/stdout"
    )


def _standard_stream(found: os.stat_result) -> int | None:
    """Descriptor of standard output or error, if what was found is one of them."""
    for descriptor in (1, 2):
        with contextlib.suppress(OSError):
            if os.path.samestat(found, os.fstat(descriptor)):
                return descriptor
    return None


def _send(content: Path, path: Path) -> None:
    descriptor = _standard_stream(os.stat(path))
    # Behind what was printed before.
    for printed in (sys.stdout, sys.stderr):
        if printed is not None:
            printed.flush()
    with (
        open(content, "rb") as file,
        open(path if descriptor is None else os.dup(descriptor), "wb") as stream,
    ):
        shutil.copyfileobj(file, stream)


def flush_to_disk(path: Path) -> None:
    """Write a file through to the disk.

    Raises:
        OSError: the disk is full. OpenEXR and Mitsuba do not report it if it was full when they
            closed the file.
    """
    with open(path, "rb+") as file:
        end = file.seek(0, os.SEEK_END)
        file.write(bytes(_BUFFER))
        file.truncate(end)
        os.fsync(file.fileno())


def raise_write_error(path: Path, error: Exception) -> NoReturn:
    """Raise an exception again: as a `WriteError` of `path` if it says that writing failed."""
    if isinstance(error, WriteError) or not (isinstance(error, OSError) or _says_of_writing(error)):
        raise error
    raise WriteError(path, error) from error


def _create_locked(path: Path) -> tuple[int | None, Path]:
    """A new temporary file of `path`: its handle, from `system.keep`, and its name.

    It is locked as long as the process lives, which shows others that it is in use.
    """
    while True:
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}{TEMPORARY}", suffix=path.suffix, dir=path.parent
        )
        # Before it is locked, another process may take it for abandoned and remove it.
        if lock(handle) is not False and os.fstat(handle).st_nlink:
            return keep(handle), Path(name)
        os.close(handle)
        remove(Path(name))


@contextlib.contextmanager
def exclusive(path: Path, *, wait: bool = False) -> Iterator[bool]:
    """Context in which no other process holds `path`; yields False if one does.

    While it is held, `path` is an empty file. Files that killed processes left are not in the way.

    Args:
        wait: whether to wait until no other process holds it.

    Raises:
        WriteError: the folder cannot be written, or the disk is full.
    """
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise WriteError(path.parent, error) from error
        held = lock(handle, wait=wait) is not False
        # The process that held the file may just have removed it.
        if not held or os.fstat(handle).st_nlink:
            break
        os.close(handle)
    kept = keep(handle)
    try:
        yield held
    finally:
        # Where another process has it open, that one removes it.
        with contextlib.suppress(PermissionError):
            if held:
                remove(path)
        release(kept)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Refuse an output that cannot be written, before any work is done; creates nothing.

    Folders that are missing are made when the file is written.

    Raises:
        LumitreeError: `path` is no file and no stream (see `is_stream`), its name is not UTF-8, or
            its folder cannot be made or written.
    """
    check_utf8(path)
    path = Path(path)
    try:
        if is_stream(path):
            if not os.access(path, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            return
        target = destination(path)
        folder = target.parent
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        _check_name(target.name, folder)
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if not is_writable(folder):
            number = errno.EROFS if is_read_only(folder) else errno.EACCES
            raise OSError(number, os.strerror(number))
    except (OSError, ValueError) as error:
        raise WriteError(path, error) from error


def check_room(folder: Path, size: int) -> None:
    """Refuse a folder on whose disk there is no room for so many bytes.

    Raises:
        WriteError: there is no room, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            for _ in range(0, size, 1 << 20):
                file.write(bytes(1 << 20))
    except OSError as error:
        raise WriteError(folder, error) from error


def is_empty(folder: Path) -> bool:
    """Whether a folder is empty, apart from temporary files that killed processes left."""
    return all(map(is_temporary, os.listdir(folder)))


def is_temporary(name: str) -> bool:
    """Whether a file has the name of one that is being written."""
    return _TEMPORARY_NAME.fullmatch(name) is not None


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write `value` as indented JSON, atomically; errors as for `json_text`."""
    write_bytes(path, (json_text(value, indent=1) + "\n").encode())


def json_text(value: Any, indent: int | None = None) -> str:
    """JSON text of a value: in one line without spaces, or indented.

    Raises:
        LumitreeError: a number is NaN or infinite, which JSON does not have.
    """
    separators = (",", ":") if indent is None else None
    try:
        return json.dumps(value, indent=indent, separators=separators, allow_nan=False)
    except ValueError as error:
        raise LumitreeError(
            f"a number of the results is not finite, and no file is written ({error}); check the "
            "lamp and its images for colours that are not numbers"
        ) from None


def _check_name(name: str, folder: Path) -> None:
    """Refuse a name that the system does not accept, or whose temporary name would be too long."""
    if not accepts_name(name):
        raise OSError(errno.EINVAL, "this system has no files with such a name")
    longest = longest_name(folder) - len(f".{TEMPORARY}") - 8
    if len(os.fsencode(name)) > longest:
        raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))


def _remove_abandoned(path: Path) -> None:
    """Remove temporary files of `path` that no running process has locked.

    A large folder is not listed again for a while: else the time to write all of its files would
    grow with the square of their number.
    """
    folder = os.path.abspath(path.parent)
    if time.monotonic() < _listed_again.get(folder, 0.0):
        return
    count = 0
    for entry in path.parent.iterdir():
        count += 1
        found = _TEMPORARY_NAME.fullmatch(entry.name)
        if found is None or (found["stem"], found["suffix"]) != (path.stem, path.suffix):
            continue
        with contextlib.suppress(OSError):
            handle = os.open(entry, os.O_RDONLY)
            try:
                if lock(handle):
                    entry.unlink()
            finally:
                os.close(handle)
    if count > _LARGE_FOLDER:
        _listed_again[folder] = time.monotonic() + _LIST_AGAIN_SECONDS


def _says_of_writing(error: Exception) -> bool:
    """Whether an exception of a library says that a file could not be written.

    Mitsuba raises RuntimeError with the text "I/O error".
    """
    text = str(error)
    return any(reason in text for reason in _FULL.values()) or (
        isinstance(error, RuntimeError) and "I/O error" in text
    )
