"""Atomic writing of files: a file with the final name is always complete."""

import contextlib
import errno
import fcntl
import json
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lumitree.errors import LumitreeError, shown

# The part of a temporary name before its random characters, and the pattern of the whole name.
_TEMPORARY = ".lumitree-"
_TEMPORARY_NAME = re.compile(
    r"\.(?P<stem>.*)\.lumitree-[a-z0-9_]{8}(?P<suffix>(\.[^.]*)?)", re.DOTALL
)


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary name beside `path`; rename it to `path` if the block succeeds.

    The temporary file is flushed to disk before the rename, and removed if the block fails.
    Temporary files that killed processes left for the same `path` are removed too.

    Raises:
        LumitreeError: the folder cannot be written, or the disk is full.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(path)
        handle, temporary = _create_locked(path)
    except (OSError, ValueError) as error:
        raise _write_error(path, error) from error
    try:
        yield temporary
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())
        # mkstemp creates 0600; a finished result follows the user's umask.
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
    except OSError as error:
        raise _write_error(path, error) from error
    except RuntimeError as error:
        # Mitsuba's message names the temporary file and ends with the reason.
        _, failed, reason = str(error).partition("I/O error")
        if not failed:
            raise
        full = OSError(errno.ENOSPC, reason.rpartition(": ")[2])
        raise _write_error(path, full) from error
    finally:
        os.close(handle)
        temporary.unlink(missing_ok=True)


def _create_locked(path: Path) -> tuple[int, Path]:
    """A new temporary file of `path`: its handle and its name.

    It is locked as long as the process lives, which shows others that it is in use.
    """
    while True:
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}{_TEMPORARY}", suffix=path.suffix, dir=path.parent
        )
        # Before it is locked, another process may take it for abandoned and remove it.
        if lock(handle) is not False and os.fstat(handle).st_nlink:
            return handle, Path(name)
        os.close(handle)
        Path(name).unlink(missing_ok=True)


def lock(handle: int, *, wait: bool = False) -> bool | None:
    """Lock an open file or folder for this process.

    Args:
        wait: whether to wait until no other process holds it.

    Returns:
        True, or False where another process holds it; None where the file system has no locks.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return False if error.errno in (errno.EWOULDBLOCK, errno.EACCES) else None
    return True


@contextlib.contextmanager
def exclusive(path: Path) -> Iterator[bool]:
    """Context in which no other process holds `path`; yields False if one does.

    While it is held, `path` is an empty file. What killed processes left is not in the way.

    Raises:
        LumitreeError: the folder cannot be written, or the disk is full.
    """
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise _write_error(path, error) from error
        held = lock(handle) is not False
        # The process that held the file may just have removed it.
        if not held or os.fstat(handle).st_nlink:
            break
        os.close(handle)
    try:
        yield held
    finally:
        if held:
            path.unlink(missing_ok=True)
        os.close(handle)


@contextlib.contextmanager
def one_at_a_time(folder: Path) -> Iterator[None]:
    """Context that waits until no other process is in such a context of `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder, os.O_RDONLY)
    try:
        lock(handle, wait=True)
        yield
    finally:
        os.close(handle)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Refuse an output that cannot be written, before any work is done; creates nothing.

    Folders that are missing are made when the file is written.

    Raises:
        LumitreeError: `path` is a folder, or its folder cannot be made or written.
    """
    path = Path(path)
    try:
        if "\0" in str(path):
            raise ValueError("the name holds a null character")
        if path.is_dir():
            raise LumitreeError(f"cannot write {path}: it is a folder; choose a file with -o")
        folder = path.parent
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        _check_name(path.name, folder)
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except (OSError, ValueError) as error:
        raise _write_error(path, error) from error


def is_empty(folder: Path) -> bool:
    """Whether a folder is empty, apart from temporary files that killed processes left."""
    return all(_TEMPORARY_NAME.fullmatch(name) for name in os.listdir(folder))


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write `value` as indented JSON, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _check_name(name: str, folder: Path) -> None:
    """Refuse a name whose temporary name would be too long for the file system."""
    longest = os.pathconf(folder, "PC_NAME_MAX") - len(f".{_TEMPORARY}") - 8
    if len(os.fsencode(name)) > longest:
        raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))


def _remove_abandoned(path: Path) -> None:
    """Remove temporary files of `path` that no running process has locked."""
    for entry in path.parent.iterdir():
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


def _write_error(path: Path, error: OSError | ValueError) -> LumitreeError:
    reason = getattr(error, "strerror", None) or str(error)
    full = getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    remedy = "free some space or choose" if full else "choose"
    return LumitreeError(
        f"cannot write {shown(path, 400)}: {reason}; {remedy} another output with -o"
    )
