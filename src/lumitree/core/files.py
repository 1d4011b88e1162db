"""Files and folders that lumitree writes: whole or not at all, and by one process at a time.

A file is written under a temporary name, locked and then renamed (`atomic_path`). Intermediate
results are in a `WorkFolder`, which has a marker. No other module deletes folders, and this one
deletes only files that lumitree has written. Locks vanish with their process, also when it is
killed. On Windows, which has none, a second process may repeat the work of the first.
"""

import atexit
import contextlib
import errno
import functools
import json
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
import time
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NoReturn

from lumitree.errors import LumitreeError, LumitreeWarning, shown

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

FilePath = str | os.PathLike[str]
MARKER = ".lumitree-work"
_MARKER_TEXT = (
    "This folder holds intermediate results of lumitree. It is removed when they are not needed\n"
    "any more, except for files that lumitree did not write.\n"
)
# Temporary files are named .STEM.lumitree-12345678.SUFFIX; folders without output SCRATCH12345678.
_TEMPORARY, _SCRATCH = ".lumitree-", "lumitree-scratch-"
_RANDOM = "[0-9a-f]{8}"
_TEMPORARY_NAME = re.compile(rf"\.(.*){re.escape(_TEMPORARY)}{_RANDOM}((\.[^.]*)?)", re.DOTALL)
# Files that a desktop adds to folders by itself.
_DESKTOP_FILES = frozenset({".DS_Store", "desktop.ini", "Thumbs.db"})
# Messages of the system about a full disk; libraries repeat them.
_FULL = {
    number: text
    for number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    # Windows has no quota of this kind, and no text for it.
    if not (text := os.strerror(number)).startswith("Unknown error")
}
# Bytes, more than C++ buffers until a file is closed.
_BUFFER = 1 << 14
# Names that Windows refuses, or takes for a device or a stream of another file.
_RESERVED = re.compile(
    r'(con|prn|aux|nul|com[0-9]|lpt[0-9])([. ].*)?|.*[<>:"|?*\x00-\x1f].*|.*[. ]', re.I | re.DOTALL
)


class WriteError(LumitreeError):
    """A file cannot be written.

    Attributes:
        path: the file.
        reason: why, in the words of the system.
        full: whether its disk is full.
    """

    def __init__(self, path: Path, error: Exception, what: str = "", remedy: str = "") -> None:
        """Describe what went wrong.

        Args:
            error: of the system, or of the library that wrote the file.
            what: name of the output. Default: the path, or the folder for temporary files.
            remedy: what to do. Default: choose another output, or place for temporary files.
        """
        scratch = next((each for each in path.parents if each.name.startswith(_SCRATCH)), None)
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


class BusyFolderError(LumitreeError):
    """Another process works in a folder."""


def write_bytes(path: FilePath, data: bytes) -> None:
    """Write a file, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_json(path: FilePath, value: object) -> None:
    """Write `value` as indented JSON, atomically; errors as for `json_text`."""
    write_bytes(path, (json_text(value, indent=1) + "\n").encode())


def json_text(value: object, indent: int | None = None) -> str:
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


def check_utf8(path: str | os.PathLike[str]) -> None:
    """Refuse the name of a file that is not UTF-8.

    Mitsuba, OpenEXR and Matplotlib refuse it with different exceptions.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise LumitreeError(
            f"the name {shown(path, 300)} is not valid UTF-8; rename it, or choose another"
        ) from None


@contextlib.contextmanager
def atomic_path(path: FilePath) -> Iterator[Path]:
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
        for entry in os.listdir(target.parent):
            found = _TEMPORARY_NAME.fullmatch(entry)
            if found is not None and (found[1], found[2]) == (target.stem, target.suffix):
                _remove_abandoned(target.parent / entry, remove)
        temporary = target.with_name(
            f".{target.stem}{_TEMPORARY}{secrets.token_hex(4)}{target.suffix}"
        )
        unlock = _lock(temporary)
    except (OSError, ValueError) as error:
        raise WriteError(path, error) from error
    try:
        yield temporary
        flush_to_disk(temporary)
        if streamed:
            _send(temporary, path)
        else:
            _patiently(os.replace, temporary, target)
    except Exception as error:
        _raise_write_error(path, error)
    finally:
        unlock()
        # If that fails, the error before says more.
        with contextlib.suppress(OSError):
            remove(temporary)


@contextlib.contextmanager
def atomic_files(output: Path) -> Iterator[Path]:
    """Yield a temporary folder; move its files beside `output` if the block succeeds.

    Folders in it are made if they are missing. Each file is written as by `atomic_path`, and the
    file with the name of `output` last: while it is missing, so may others be.

    Raises:
        WriteError: a file cannot be written, or the disk is full.
    """
    with _written_beside(output) as files:
        yield files
        main = files / output.name
        for each in sorted(files.rglob("*"), key=lambda each: (each == main, each)):
            place = output.parent / each.relative_to(files)
            if each.is_dir():
                place.mkdir(exist_ok=True)
                continue
            with atomic_path(place) as temporary:
                shutil.copyfile(each, temporary)


@contextlib.contextmanager
def atomic_folder(output: Path) -> Iterator[Path]:
    """Yield a temporary folder; rename it to `output` if the block succeeds.

    Args:
        output: the folder, which is missing or empty; see `check_new_folder`.

    Raises:
        WriteError: the folder cannot be written, or the disk is full.
    """
    # A name such as "folder/.." has no stem.
    folder = output.resolve()
    with _written_beside(folder, output) as files:
        yield files
        for each in files.iterdir():
            flush_to_disk(each)
        if folder.is_dir():
            # Windows does not rename to a folder that exists. Fails if it holds something by now.
            _remove_empty(folder)
        _patiently(os.replace, files, folder)


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


def check_writable(path: FilePath) -> None:
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
        if not os.access(folder, os.W_OK | os.X_OK):
            read_only = hasattr(os, "statvfs") and os.statvfs(folder).f_flag & os.ST_RDONLY
            number = errno.EROFS if read_only else errno.EACCES
            raise OSError(number, os.strerror(number))
    except (OSError, ValueError) as error:
        raise WriteError(path, error) from error


def check_new_folder(path: Path) -> None:
    """Refuse a folder that cannot be made, or holds something, before any work is done.

    Raises:
        LumitreeError: it is a file, holds something, or cannot be written.
    """
    if path.is_dir() and (found := contents(path)):
        raise LumitreeError(
            f"{shown(path, 300)} is a folder that holds {shown(found[0])}; choose a new or an "
            "empty folder with -o"
        )
    if path.is_dir() and path.samefile("."):
        raise LumitreeError("the output is the current folder; choose a new folder with -o")
    if path.exists() and not path.is_dir():
        raise LumitreeError(f"{shown(path, 300)} is no folder; choose a new or an empty one")
    check_writable(path / "file" if path.is_dir() else path)


def accepts_name(name: str) -> bool:
    """Whether a file may have this name on this system, apart from its length."""
    return os.name != "nt" or _RESERVED.fullmatch(name) is None


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


def remove(path: Path) -> None:
    """Remove a file, if there is one."""
    with contextlib.suppress(FileNotFoundError):
        _patiently(os.unlink, path)


def contents(folder: Path) -> list[str]:
    """Names of the entries of a folder, apart from files that a desktop adds by itself."""
    return sorted(set(os.listdir(folder)) - _DESKTOP_FILES)


def is_empty(folder: Path) -> bool:
    """Whether a folder is empty, apart from temporary files that killed processes left."""
    return all(map(_TEMPORARY_NAME.fullmatch, os.listdir(folder)))


def remove_written(folder: Path, names: Iterable[str]) -> None:
    """Remove files of lumitree from a folder, and the folders in it that are then empty.

    Args:
        names: patterns of files and folders; see `WorkFolder.remove`.

    Raises:
        OSError: something cannot be removed.
    """
    for name in names:
        for path in folder.glob(name):
            if path.is_dir() and not path.is_symlink():
                _patiently(shutil.rmtree, path)
            else:
                remove(path)
    for inner, _, _ in os.walk(folder, topdown=False):
        if inner != str(folder) and not contents(Path(inner)):
            _remove_empty(Path(inner))


@contextlib.contextmanager
def exclusive(path: Path) -> Iterator[None]:
    """Context in which no other process works in the folder `path`, which is made if missing.

    The folder itself is locked: processes that are killed leave nothing in it.

    Raises:
        BusyFolderError: another process works in it.
        WriteError: it cannot be made.
    """
    try:
        unlock = _lock(path, is_folder=True)
    except BlockingIOError:
        raise _busy(path, "output with -o") from None
    except (OSError, ValueError) as error:
        raise WriteError(path, error) from error
    try:
        yield
    finally:
        unlock()


class WorkFolder:
    """A folder of intermediate results, locked by this process while the object is open.

    A file named `MARKER` marks the folder as lumitree's. A folder that is not empty and lacks this
    file is refused.

    Args:
        path: the folder; made if it is missing.

    Raises:
        LumitreeError: the folder is not lumitree's, or cannot be written.
        BusyFolderError: it is locked by another process.
    """

    def __init__(self, path: FilePath) -> None:
        self.path = Path(path)
        marker = self.path / MARKER
        try:
            self._made = not self.path.exists()
            self.path.mkdir(parents=True, exist_ok=True)
            if not marker.exists() and (found := contents(self.path)):
                raise LumitreeError(
                    f"{self.path} holds what lumitree did not write ({shown(found[0])}); choose an "
                    "empty or a new folder with --work, or move it away"
                )
            self._unlock = _lock(marker)
            try:
                if not marker.stat().st_size:
                    marker.write_text(_MARKER_TEXT)
            except OSError:
                self._close()
                raise
        except BlockingIOError:
            raise _busy(self.path, "folder with --work") from None
        except (OSError, ValueError) as error:
            raise WriteError(
                self.path, error, f"the work folder {self.path}", "choose another with --work"
            ) from error

    def __enter__(self) -> "WorkFolder":
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            self._close()

    @property
    def is_empty(self) -> bool:
        """Whether the folder holds nothing from which a later call could continue."""
        try:
            return set(contents(self.path)) <= {MARKER}
        except OSError:
            return True

    def _close(self) -> None:
        # While it is locked: the next process may begin here at once.
        try:
            if self.is_empty:
                remove(self.path / MARKER)
                if self._made:
                    _remove_empty(self.path)
            elif not (self.path / MARKER).exists():
                # Someone removed the folder, and the work wrote into it again.
                (self.path / MARKER).write_text(_MARKER_TEXT)
        finally:
            self._unlock()

    def remove(self, names: Iterable[str]) -> None:
        """Remove files of lumitree, and the folder if it is then empty.

        Args:
            names: patterns relative to the work folder, as for `pathlib.Path.glob`, of files, and
                of folders that are removed with everything in them.
        """
        kept = [MARKER]
        try:
            remove_written(self.path, names)
            kept = [entry for entry in contents(self.path) if entry != MARKER]
            if not kept:
                remove(self.path / MARKER)
                _remove_empty(self.path)
        except FileNotFoundError:
            kept = []
        except OSError as error:
            kept = [error.strerror or str(error)]
        if kept:
            warnings.warn(
                f"{self.path} stays: it holds other things too ({shown(kept[0])})",
                LumitreeWarning,
                stacklevel=2,
            )


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Context with a temporary folder; folders that killed processes left are removed.

    Raises:
        LumitreeError: the folder for temporary files cannot be written.
    """
    with _temporary_folder(Path(tempfile.gettempdir()), _SCRATCH) as folder:
        yield folder


class ScratchFolder:
    """A temporary folder that lasts as long as the object, and at most as long as the process.

    All of a process are in one folder, so that any number of them takes one open file.

    Attributes:
        path: the folder.

    Raises:
        LumitreeError: the folder for temporary files cannot be written.
    """

    def __init__(self) -> None:
        root = tempfile.gettempdir()
        folder = _process_folders.get(root)
        # Many systems remove old temporary files.
        if folder is None or not folder.is_dir():
            folder = _process_folders[root] = _until_exit.enter_context(scratch_folder())
        self.path = Path(tempfile.mkdtemp(dir=folder))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


_until_exit = contextlib.ExitStack()
atexit.register(_until_exit.close)
# By the folder for temporary files.
_process_folders: dict[str, Path] = {}


def remove_abandoned_scratch() -> None:
    """Remove the temporary folders that killed processes left, as far as that is allowed."""
    with contextlib.suppress(OSError):
        _remove_abandoned_folders(Path(tempfile.gettempdir()), _SCRATCH)


@contextlib.contextmanager
def _temporary_folder(root: Path, prefix: str) -> Iterator[Path]:
    """Context with a new folder, which has a locked marker."""
    try:
        root.mkdir(parents=True, exist_ok=True)
        _remove_abandoned_folders(root, prefix)
        folder = root / f"{prefix}{secrets.token_hex(4)}"
        folder.mkdir(mode=0o700)
        unlock = _lock(folder / MARKER)
    except (OSError, ValueError) as error:
        if prefix != _SCRATCH:
            raise
        reason = getattr(error, "strerror", None) or error
        raise LumitreeError(
            f"no folder for temporary files can be made: {reason}; free some space or name another "
            "with TMPDIR"
        ) from error
    try:
        yield folder
    finally:
        unlock()
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def _written_beside(output: Path, name: Path | None = None) -> Iterator[Path]:
    """Yield a folder on the disk of `output`; remove it afterwards, with all that is still in it.

    Args:
        name: name of the output for messages. Default: `output`.
    """
    name = output if name is None else name
    try:
        with _temporary_folder(output.parent, f".{output.stem}{_TEMPORARY}") as temporary:
            # Renamed as a whole by `atomic_folder`, with the user's umask and without the marker.
            files = temporary / "files"
            files.mkdir()
            yield files
    except WriteError as error:
        # The user knows the output, and not the file of the temporary folder.
        cause = error.__cause__
        raise WriteError(name, cause if isinstance(cause, Exception) else error) from error
    except Exception as error:
        _raise_write_error(name, error)


def _lock(path: Path, *, is_folder: bool = False) -> Callable[[], None]:
    """Open a file, which is made if it is missing, and lock it for this process.

    Returns:
        A function that unlocks it. Without locks it does nothing, and the file is closed already:
        Windows does not rename or remove files that are open.

    Raises:
        BlockingIOError: another process holds it.
    """
    while True:
        # The process that held it may just have removed it.
        (path if is_folder else path.parent).mkdir(parents=True, exist_ok=True)
        if fcntl is None:
            if not is_folder:
                path.touch()
            return lambda: None
        handle = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            # Other errors: the file system has no locks.
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                os.close(handle)
                raise BlockingIOError from None
        if os.fstat(handle).st_nlink:
            return functools.partial(os.close, handle)
        os.close(handle)


def _busy(folder: Path, other: str) -> BusyFolderError:
    return BusyFolderError(
        f"another process works in {shown(folder, 300)}; wait for it, or choose another {other}"
    )


def _remove_abandoned_folders(root: Path, prefix: str) -> None:
    for name in os.listdir(root):
        if re.fullmatch(re.escape(prefix) + _RANDOM, name):
            folder = root / name
            # Left by a process that was killed before it made the marker.
            with contextlib.suppress(OSError):
                folder.rmdir()
            _remove_abandoned(folder / MARKER, lambda marker: shutil.rmtree(marker.parent))


def _remove_abandoned(path: Path, delete: Callable[[Path], None]) -> None:
    """Call `delete` for a path that no running process has locked."""
    # It may be another user's, or another process may be making or removing it.
    with contextlib.suppress(OSError):
        if fcntl is not None:
            handle = os.open(path, os.O_RDONLY)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                delete(path)
            finally:
                os.close(handle)


def _remove_empty(folder: Path) -> None:
    """Remove a folder that has no files but those that a desktop adds."""
    for name in set(os.listdir(folder)) & _DESKTOP_FILES:
        remove(folder / name)
    _patiently(folder.rmdir)


def _patiently(function: Callable[..., object], *arguments: Path) -> None:
    """Call a function on files, which Windows refuses while another process has them open.

    Raises:
        PermissionError: it is still refused after 2 s; on other systems at once.
    """
    end = time.monotonic() + (2.0 if os.name == "nt" else 0.0)
    while True:
        try:
            function(*arguments)
            return
        except PermissionError:
            if time.monotonic() >= end:
                raise
            time.sleep(0.05)


def _check_name(name: str, folder: Path) -> None:
    """Refuse a name that the system does not accept, or whose temporary name would be too long."""
    if not accepts_name(name):
        raise OSError(errno.EINVAL, "this system has no files with such a name")
    limit = os.pathconf(folder, "PC_NAME_MAX") if hasattr(os, "pathconf") else 255
    if len(os.fsencode(name)) + len(f".{_TEMPORARY}") + 8 > limit:
        raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))


def _standard_stream(found: os.stat_result) -> int | None:
    """Descriptor of standard output or error, if the file is one of them."""
    for descriptor in (1, 2):
        with contextlib.suppress(OSError):
            if os.path.samestat(found, os.fstat(descriptor)):
                return descriptor
    return None


def _send(content: Path, path: Path) -> None:
    """Write a file to a stream, behind the text that was printed before."""
    descriptor = _standard_stream(os.stat(path))
    for printed in (sys.stdout, sys.stderr):
        if printed is not None:
            printed.flush()
    with (
        open(content, "rb") as file,
        open(path if descriptor is None else os.dup(descriptor), "wb") as stream,
    ):
        shutil.copyfileobj(file, stream)


def _raise_write_error(path: Path, error: Exception) -> NoReturn:
    """Raise an exception again: as a `WriteError` of `path` if it says that writing failed."""
    text = str(error)
    says_so = (
        isinstance(error, OSError)
        or any(reason in text for reason in _FULL.values())
        # Mitsuba.
        or (isinstance(error, RuntimeError) and "I/O error" in text)
    )
    if isinstance(error, WriteError) or not says_so:
        raise error
    raise WriteError(path, error) from error
