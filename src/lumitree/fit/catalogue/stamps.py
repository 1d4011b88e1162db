"""Size, time and digest of a file, by which a later call finds out whether it has changed."""

import contextlib
import dataclasses
import hashlib
import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lumitree.core.reading import Record
from lumitree.errors import LumitreeError

# A file that was changed within so many seconds of its reading may have been read before it, and
# file systems state times by up to 2 s.
_UNSURE_NS = 2_000_000_000


@dataclasses.dataclass(frozen=True)
class FileStamp:
    """State of a file when it was read.

    Attributes:
        name: path relative to the folder of the assets.
        size: bytes; -1 if the file was missing.
        modified: time of the last change, ns since 1970; 0 if it does not identify the content.
        digest: SHA-256; empty if the file was missing.
    """

    name: str
    size: int
    modified: int
    digest: str

    @classmethod
    def of(cls, path: Path, folder: Path, read_at: int | None = None) -> "FileStamp | None":
        """The stamp of a file as it is.

        Args:
            path, folder: the file, and the folder of the assets.
            read_at: time before what is known of the file was read, ns since 1970. Default: now.

        Returns:
            None if the file may have changed since, or is no file that can be read.
        """
        name = relative_name(path, folder)
        try:
            if os.path.exists(path) and not os.path.isfile(path):
                return None
            digest = file_digest(path)
            # Afterwards: a change while it was read is then one of the time.
            found = os.stat(path)
        except FileNotFoundError:
            return cls(name, -1, 0, "")
        except OSError:
            return None
        if read_at is not None and found.st_mtime_ns > read_at - _UNSURE_NS:
            return None
        recent = found.st_mtime_ns > time.time_ns() - _UNSURE_NS
        return cls(name, found.st_size, 0 if recent else found.st_mtime_ns, digest)

    def current(self, folder: Path) -> "FileStamp | None":
        """The stamp of the file as it is now if it has the same content; None if not.

        The file is only read if its size is the same, but not its time.
        """
        path = Path(os.path.normpath(os.path.join(os.path.abspath(folder), self.name)))
        try:
            found = os.stat(path)
        except FileNotFoundError:
            return self if self.size < 0 else None
        except OSError:
            return None
        if found.st_size != self.size:
            return None
        if found.st_mtime_ns == self.modified:
            return self
        stamp = FileStamp.of(path, folder)
        return stamp if stamp is not None and stamp.digest == self.digest else None

    def to_json(self) -> list[Any]:
        """Members of a JSON file."""
        return [self.name, self.size, self.modified, self.digest]


def read_stamp(value: Any) -> FileStamp:
    """The inverse of `FileStamp.to_json`; refuses other values."""
    if type(value) is not list or len(value) != 4:
        raise LumitreeError("a file of a record is not a list of four values")
    record = Record(dict(zip(("name", "size", "modified", "digest"), value, strict=True)), "file")
    return FileStamp(
        record.text("name", 10_000),
        record.integer("size"),
        record.integer("modified"),
        record.text("digest", 64),
    )


def stamps_of(paths: Iterable[Path], folder: Path, read_at: int) -> tuple[FileStamp, ...] | None:
    """Stamps of files that have been read since `read_at`; None if one may have changed since.

    None too if a record cannot hold the name of one.
    """
    stamps = [FileStamp.of(path, folder, read_at) for path in paths]
    known = tuple(stamp for stamp in stamps if stamp is not None and stamp.name.isprintable())
    return known if len(known) == len(stamps) else None


def current_stamps(stamps: Iterable[FileStamp], folder: Path) -> tuple[FileStamp, ...] | None:
    """Stamps of files as they are now; None if the content of one is another."""
    found = []
    for stamp in stamps:
        now = stamp.current(folder)
        if now is None:
            return None
        found.append(now)
    return tuple(found)


def relative_name(path: str | Path, folder: Path) -> str:
    """Path relative to a folder, with / on each system; absolute if it is on another disk."""
    path = os.path.abspath(path)
    # Windows has no relative path between its disks.
    with contextlib.suppress(ValueError):
        path = os.path.relpath(path, os.path.abspath(folder))
    return path.replace(os.sep, "/")


def file_digest(path: Path) -> str:
    """SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
