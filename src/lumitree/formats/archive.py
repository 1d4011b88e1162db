"""Zip archives that may be damaged or hostile: members are read into memory, within limits.

Nothing is unpacked under a name that an archive states.
"""

import io
import os
import struct
import zipfile
import zlib

from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, shown

MAX_ARCHIVE_BYTES = 256 * 2**20
# Bytes of all members that are read of one archive and of those inside it.
_MAX_UNPACKED = 256 * 2**20
_MAX_MEMBERS = 1 << 14
# An entry of the list of members begins with it.
_ENTRY = b"PK\x01\x02"
# zipfile unpacks other methods without a limit of memory.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# Encodings of names that are not marked as UTF-8; zipfile takes the first.
_IS_UTF8 = 0x800
_ENCODINGS = ("cp437", "cp850", "cp1252", "utf-8")
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError)
_DAMAGED += (NotImplementedError, KeyError, MemoryError, struct.error)


class Archive:
    """A zip archive, whose members are found by their names in any case and encoding.

    It shares the limit of size with `outer`, the archive that it is a member of. `name` and
    `expected` are for messages.
    """

    def __init__(
        self, content: bytes, name: str, expected: str, outer: "Archive | None" = None
    ) -> None:
        self.name, self._outer, self._unpacked = name, outer, 0
        # Before the list is read: a file of the largest size may have millions of them.
        if (count := content.count(_ENTRY)) > _MAX_MEMBERS:
            raise LumitreeError(f"{name} has {count} members; at most {_MAX_MEMBERS} are read")
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(content))
            members = self._zip.infolist()
        except _DAMAGED as error:
            raise LumitreeError(
                f"{name} is damaged, or no zip archive ({type(error).__name__}); expected "
                f"{expected}"
            ) from None
        # The first of a name counts; exact names come before others.
        self._members: dict[str, zipfile.ZipInfo] = {}
        for key in (_plain, _folded):
            for encoding in _ENCODINGS:
                for member in members:
                    self._members.setdefault(key(_name(member, encoding)), member)

    @staticmethod
    def open(path: str | os.PathLike[str], expected: str) -> "Archive":
        """The archive that a file is."""
        content = read_bytes(path, expected, MAX_ARCHIVE_BYTES)
        return Archive(content, shown(path, 300), expected)

    def find(self, *names: str) -> str | None:
        """The first of some names that is in the archive."""
        return next((name for name in names if self._member(name) is not None), None)

    def names(self, folder: str) -> list[str]:
        """Names of the files directly in a folder, without the folder."""
        start = _folded(folder) + "/"
        found = {_plain(each.filename) for each in self._members.values() if not each.is_dir()}
        below = (name[len(start) :] for name in sorted(found) if _folded(name).startswith(start))
        return [name for name in below if name and "/" not in name]

    def read(self, name: str, expected: str, max_bytes: int = _MAX_UNPACKED) -> bytes:
        """Content of a member; `expected` is for messages.

        Nothing of a member larger than `max_bytes` is unpacked.
        """
        member = self._member(name)
        where = f"{shown(name, 200)} in {self.name}"
        if member is None:
            raise LumitreeError(f"{where} is missing; expected {expected}")
        if member.compress_type not in _METHODS:
            raise LumitreeError(
                f"{where} is compressed by method {member.compress_type} of zip archives; expected "
                "none or Deflate"
            )
        limit = min(max_bytes, self._left())
        if member.file_size > limit:
            raise LumitreeError(
                f"{where} is too large: {member.file_size >> 20} MiB, of which {limit >> 20} MiB "
                "would be unpacked"
            )
        try:
            with self._zip.open(member) as file:
                # At most the size that is stated.
                content = file.read()
        except _DAMAGED as error:
            raise LumitreeError(
                f"{where} is damaged or encrypted ({type(error).__name__}); expected {expected}"
            ) from None
        self._count(len(content))
        return content

    def _member(self, name: str) -> zipfile.ZipInfo | None:
        return self._members.get(_plain(name)) or self._members.get(_folded(name))

    def _left(self) -> int:
        return _MAX_UNPACKED - self._unpacked if self._outer is None else self._outer._left()

    def _count(self, size: int) -> None:
        self._unpacked += size
        if self._outer is not None:
            self._outer._count(size)


def _name(member: zipfile.ZipInfo, encoding: str) -> str:
    """Name of a member in an encoding that it may have."""
    if member.flag_bits & _IS_UTF8:
        return member.filename
    try:
        return member.filename.encode(_ENCODINGS[0]).decode(encoding)
    except UnicodeError:
        return member.filename


def _plain(name: str) -> str:
    return name.replace("\\", "/").removeprefix("./")


def _folded(name: str) -> str:
    return _plain(name).casefold()
