"""Folders that lumitree owns: work folders for intermediate results, and temporary folders.

Outputs of several files are written into a temporary folder first. No other module deletes folders.
Only what lumitree has written is deleted.
"""

import atexit
import contextlib
import os
import re
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Iterable, Iterator
from pathlib import Path

from lumitree.core.files import (
    SCRATCH,
    TEMPORARY,
    WriteError,
    atomic_path,
    check_writable,
    flush_to_disk,
    raise_write_error,
)
from lumitree.core.system import (
    DESKTOP_FILES,
    keep,
    lock,
    open_folder,
    patiently,
    release,
    remove,
    replace,
)
from lumitree.errors import LumitreeError, LumitreeWarning, shown

MARKER = ".lumitree-work"
_MARKER_TEXT = (
    "This folder holds intermediate results of lumitree. It is removed when they are not needed\n"
    "any more, except for files that lumitree did not write.\n"
)


class BusyFolderError(LumitreeError):
    """Another process works in a folder."""


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

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            self._made = not self.path.exists()
            self.path.mkdir(parents=True, exist_ok=True)
            marker = self.path / MARKER
            if not marker.exists() and (found := contents(self.path)):
                raise LumitreeError(
                    f"{self.path} holds what lumitree did not write ({shown(found[0])}); choose an "
                    "empty or a new folder with --work, or move it away"
                )
            handle = self._locked(marker)
            self._handle: int | None = handle
            try:
                if not os.fstat(handle).st_size:
                    os.write(handle, _MARKER_TEXT.encode())
            except OSError:
                self._close()
                raise
            self._handle = keep(handle)
        except (OSError, ValueError) as error:
            raise WriteError(
                self.path, error, f"the work folder {self.path}", "choose another with --work"
            ) from error

    def _locked(self, marker: Path) -> int:
        """Handle of the marker, which this process holds from now on."""
        while True:
            self.path.mkdir(parents=True, exist_ok=True)
            handle = os.open(marker, os.O_RDWR | os.O_CREAT, 0o666)
            if lock(handle) is False:
                os.close(handle)
                raise BusyFolderError(
                    f"another process works in {self.path}; wait for it, or choose another folder "
                    "with --work"
                )
            # Else the process that held the folder has just removed it.
            if os.fstat(handle).st_nlink:
                return handle
            os.close(handle)

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
                (self.path / MARKER).write_bytes(_MARKER_TEXT.encode())
        finally:
            release(self._handle)

    def remove(self, names: Iterable[str]) -> None:
        """Remove what lumitree wrote, and the folder if it is then empty.

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
def alone_in(folder: Path) -> Iterator[None]:
    """Context in which no other process works in a folder, which is made if it is missing.

    The folder itself is locked: processes that are killed leave nothing in it.

    Raises:
        BusyFolderError: another process works in it.
        WriteError: it cannot be made.
    """
    while True:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            handle = open_folder(folder)
        except (OSError, ValueError) as error:
            raise WriteError(folder, error) from error
        if handle is None:
            break
        if lock(handle) is False:
            os.close(handle)
            raise BusyFolderError(
                f"another process works in {shown(folder, 300)}; wait for it, or choose another "
                "output with -o"
            )
        # Else the process that worked in the folder has just removed it.
        if os.fstat(handle).st_nlink:
            break
        os.close(handle)
    try:
        yield
    finally:
        release(handle)


def contents(folder: Path) -> list[str]:
    """Names of what a folder holds, apart from files that a desktop adds by itself."""
    return sorted(set(os.listdir(folder)) - DESKTOP_FILES)


def _remove_empty(folder: Path) -> None:
    """Remove a folder that holds nothing but what a desktop has added."""
    for name in set(os.listdir(folder)) & DESKTOP_FILES:
        remove(folder / name)
    patiently(folder.rmdir)


def remove_written(folder: Path, names: Iterable[str]) -> None:
    """Remove what lumitree wrote into a folder, and the folders in it that are then empty.

    Args:
        names: patterns of files and folders; see `WorkFolder.remove`.

    Raises:
        OSError: something cannot be removed.
    """
    for name in names:
        for path in folder.glob(name):
            if path.is_dir() and not path.is_symlink():
                patiently(shutil.rmtree, path)
            else:
                remove(path)
    for inner, _, _ in os.walk(folder, topdown=False):
        if inner != str(folder) and not contents(Path(inner)):
            _remove_empty(Path(inner))


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Context with a temporary folder; folders that killed processes left are removed.

    Raises:
        LumitreeError: the folder for temporary files cannot be written.
    """
    with _in_temporary():
        folder, handle = _create_locked(Path(tempfile.gettempdir()), SCRATCH)
    try:
        yield folder
    finally:
        release(handle)
        shutil.rmtree(folder, ignore_errors=True)


def remove_abandoned_scratch() -> None:
    """Remove the temporary folders that killed processes left, as far as that is allowed."""
    with contextlib.suppress(OSError):
        _remove_all_abandoned(Path(tempfile.gettempdir()), SCRATCH)


class ScratchFolder:
    """A temporary folder that lasts as long as the object, and at most as long as the process.

    All of a process are in one folder, so that any number of them takes one open file.

    Attributes:
        path: the folder.

    Raises:
        LumitreeError: the folder for temporary files cannot be written.
    """

    def __init__(self) -> None:
        with _in_temporary():
            self.path = Path(tempfile.mkdtemp(dir=_process_folder()))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


_until_exit = contextlib.ExitStack()
atexit.register(_until_exit.close)
# By the folder for temporary files.
_process_folders: dict[str, Path] = {}


def _process_folder() -> Path:
    root = tempfile.gettempdir()
    folder = _process_folders.get(root)
    # Old temporary files are removed on many systems.
    if folder is None or not folder.is_dir():
        folder = _process_folders[root] = _until_exit.enter_context(scratch_folder())
    return folder


@contextlib.contextmanager
def _in_temporary() -> Iterator[None]:
    """Context that explains why the folder for temporary files cannot be written."""
    try:
        yield
    except OSError as error:
        raise LumitreeError(
            f"no folder for temporary files can be made: {error.strerror or error}; free some "
            "space or name another with TMPDIR"
        ) from error


@contextlib.contextmanager
def atomic_files(output: Path) -> Iterator[Path]:
    """Yield a temporary folder; move its files beside `output` if the block succeeds.

    Each is written as by `atomic_path`, and the file with the name of `output` last: while it is
    missing, so may others be.

    Raises:
        WriteError: a file cannot be written, or the disk is full.
    """
    with _written_beside(output) as files:
        yield files
        others = [each for each in sorted(files.iterdir()) if each.name != output.name]
        for each in (*others, files / output.name):
            with atomic_path(output.parent / each.name) as temporary:
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
    with _written_beside(output.resolve(), output) as files:
        yield files
        for each in files.iterdir():
            flush_to_disk(each)
        folder = output.resolve()
        if folder.is_dir():
            # Windows does not rename to a folder that exists. Fails if it holds something by now.
            _remove_empty(folder)
        replace(files, folder)


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


@contextlib.contextmanager
def _written_beside(output: Path, name: Path | None = None) -> Iterator[Path]:
    """Yield a folder on the disk of `output`; remove it afterwards, with what is left in it."""
    name = output if name is None else name
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        temporary, handle = _create_locked(output.parent, f".{output.stem}{TEMPORARY}")
    except (OSError, ValueError) as error:
        raise WriteError(name, error) from error
    try:
        files = temporary / "files"
        files.mkdir()
        yield files
    except WriteError as error:
        # The user knows the output, and not the file of the temporary folder.
        cause = error.__cause__
        raise WriteError(name, cause if isinstance(cause, Exception) else error) from error
    except Exception as error:
        raise_write_error(name, error)
    finally:
        release(handle)
        shutil.rmtree(temporary, ignore_errors=True)


def _create_locked(root: Path, prefix: str) -> tuple[Path, int | None]:
    """A new temporary folder, and the handle of its marker, which is locked; from `system.keep`.

    Folders with the same prefix that killed processes left are removed.
    """
    _remove_all_abandoned(root, prefix)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=root))
        # Before the marker is locked, another process may take the folder for abandoned.
        with contextlib.suppress(FileNotFoundError):
            handle = os.open(folder / MARKER, os.O_RDWR | os.O_CREAT, 0o600)
            if lock(handle) is not False and os.fstat(handle).st_nlink:
                return folder, keep(handle)
            os.close(handle)


def _remove_all_abandoned(root: Path, prefix: str) -> None:
    for folder in root.iterdir():
        if re.fullmatch(f"{re.escape(prefix)}[a-z0-9_]{{8}}", folder.name):
            _remove_abandoned(folder)


def _remove_abandoned(folder: Path) -> None:
    """Remove a temporary folder that no running process has locked."""
    # The folder may be another user's, or another process may be making or removing it.
    with contextlib.suppress(OSError):
        # Left by a process that was killed before it made the marker.
        os.rmdir(folder)
    with contextlib.suppress(OSError):
        handle = os.open(folder / MARKER, os.O_RDWR)
        try:
            if lock(handle):
                shutil.rmtree(folder)
        finally:
            os.close(handle)
