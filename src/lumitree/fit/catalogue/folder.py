"""A folder of baked lamps as a whole: its version, the parts of its list, and all its records."""

import contextlib
import dataclasses
import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from lumitree._version import __version__
from lumitree.core.arguments import check_count
from lumitree.core.files import write_json
from lumitree.core.reading import Record, parse_json, read_bytes
from lumitree.errors import LumitreeError, shown
from lumitree.fit.catalogue.record import (
    FAILURE,
    INDEX_FILES,
    RECORD,
    VERSION,
    BakedLamp,
    LampFiles,
    LampRecord,
    source_of,
)

# Folder of the files that belong to no single lamp.
FOLDER_FILES = f"{INDEX_FILES}/folder"
MAX_PARTS = 100_000
_VERSION_FILE = "version.json"
_MAX_LIST_BYTES = 1 << 26
_PART = re.compile(r"part-(\d{1,6})-of-(\d{1,6})\.json")


@dataclasses.dataclass(frozen=True)
class Part:
    """One part of a list of lamps: those at the positions number, number + count, and so on.

    Attributes:
        number: of the part, 1 to `count`.
        count: of all parts.
    """

    number: int
    count: int

    def __post_init__(self) -> None:
        check_count("number of parts", self.count, 1, MAX_PARTS)
        check_count("part", self.number, 1, self.count)

    @property
    def file_name(self) -> str:
        """Name of its file in the folder `FOLDER_FILES`."""
        return f"part-{self.number}-of-{self.count}.json"


@dataclasses.dataclass(frozen=True)
class FolderLamp:
    """A lamp of a folder, for its page; `image` is the thumbnail's name in `INDEX_FILES`."""

    lamp: BakedLamp
    image: str | None = None


def check_folder(root: Path) -> None:
    """Refuse a folder whose records are of a version that this lumitree does not read."""
    path = root / FOLDER_FILES / _VERSION_FILE
    if not os.path.exists(path):
        return
    try:
        record = Record(parse_json(read_bytes(path, "a version", 1000)), "the file")
        version = record.integer("version")
    except LumitreeError as error:
        raise LumitreeError(f"{shown(path, 300)} is damaged ({error}); remove it") from None
    if version > VERSION:
        raise LumitreeError(
            f"{shown(root, 300)} has records of version {version}, this lumitree reads 1 to "
            f"{VERSION}; update lumitree, or choose another folder"
        )


def mark_folder(root: Path) -> None:
    """Write the version of the folder's records."""
    path = root / FOLDER_FILES / _VERSION_FILE
    if not os.path.exists(path):
        write_json(path, {"version": VERSION, "lumitree": __version__})


def write_part(root: Path, part: Part, names: Iterable[str]) -> None:
    """Write which lamps a part has, so that the page can state which of them are missing."""
    write_json(root / FOLDER_FILES / part.file_name, {"version": VERSION, "lamps": list(names)})


def read_parts(root: Path) -> tuple[list[str], list[int], int]:
    """Lamps of the parts that have begun, numbers of those that have not, and number of all.

    If lists were divided differently, the latest counts. 0 parts if none was divided. Names in
    a damaged file are not returned.
    """
    entries = [
        (entry.stat().st_mtime_ns, int(found[1]), int(found[2]), entry.path)
        for entry in _entries(root / FOLDER_FILES)
        if (found := _PART.fullmatch(entry.name)) is not None
    ]
    if not entries:
        return [], [], 0
    _, _, count, _ = max(entries)
    names: list[str] = []
    begun = set()
    for _, number, of, path in entries:
        if of == count:
            begun.add(number)
            with contextlib.suppress(LumitreeError):
                record = Record(parse_json(read_bytes(path, "a part", _MAX_LIST_BYTES)), "part")
                names += [str(name) for name in record.items("lamps")]
    return names, [number for number in range(1, count + 1) if number not in begun], count


class Records:
    """The records of a folder; each is read again only when its file has changed."""

    def __init__(self, root: Path) -> None:
        self._root = root
        # By name of the file: time and size of the file, and what was read from it.
        self._read: dict[str, tuple[tuple[int, int], Any]] = {}

    def lamps(self) -> dict[str, FolderLamp]:
        """The lamps that have been baked, or have failed, by name."""
        within = {entry.name: entry for entry in _entries(self._root / INDEX_FILES)}
        assets = {entry.name: entry for entry in _entries(self._root)}
        lamps: dict[str, FolderLamp] = {}
        for file, entry in within.items():
            name = file.removesuffix(RECORD)
            if name == file or (found := self._cached(entry, name, _read_record)) is None:
                continue
            lamp, size, image = found
            asset = assets.get(f"{name}.lumitree")
            # Else the asset was removed, or is being replaced.
            if asset is not None and asset.stat().st_size == size:
                lamps[name] = FolderLamp(lamp, image if image in within else None)
        for file, entry in within.items():
            name = file.removesuffix(FAILURE)
            if name != file and (reason := self._cached(entry, name, LampFiles.read_failure)):
                lamps[name] = FolderLamp(BakedLamp(name, "", "failed", error=reason))
        return lamps

    def _cached(self, entry: os.DirEntry[str], name: str, read: Callable[[LampFiles], Any]) -> Any:
        """Result of `read` for a file of a lamp; None if the file cannot be read."""
        try:
            found = entry.stat()
        except FileNotFoundError:
            return None
        stamp = (found.st_mtime_ns, found.st_size)
        cached = self._read.get(entry.name)
        if cached is None or cached[0] != stamp:
            cached = self._read[entry.name] = (stamp, read(LampFiles(self._root, name)))
        return cached[1]


def _read_record(files: LampFiles) -> tuple[BakedLamp, int, str] | None:
    """A lamp with its record, and the size of its asset and the name of its image by that."""
    if (record := files.read()) is None:
        return None
    lamp = recorded(files, BakedLamp(files.name, source_of(record), "waiting"), record)
    return lamp, record.asset.size, files.image(record).name


def recorded(files: LampFiles, lamp: BakedLamp, record: LampRecord) -> BakedLamp:
    """A lamp with what its record states."""
    return dataclasses.replace(
        lamp,
        state="kept" if record.finished else "interrupted",
        path=files.asset,
        seconds=record.seconds,
        figures=record.figures,
    )


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except FileNotFoundError:
        return []
