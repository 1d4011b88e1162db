"""The index page of a folder of baked lamps, written at a bounded share of the time."""

import os
import re
import time
from collections.abc import Iterable
from pathlib import Path

from lumitree.core.files import check_writable, remove_written, write_bytes
from lumitree.errors import LumitreeError, shown
from lumitree.fit.catalogue.folder import FOLDER_FILES, FolderLamp, Records, read_parts
from lumitree.fit.catalogue.page import GENERATOR, folder_pages
from lumitree.fit.catalogue.record import BakedLamp

# Pages are written at most every so many seconds, and in this share of the time.
_EVERY_SECONDS, _SHARE = 5.0, 0.1
_START_BYTES = 1000
_PAGE = re.compile(r"(\d+)\.html")


def check_index(path: Path) -> None:
    """Refuse an index page that cannot be written, or that is not lumitree's."""
    check_writable(path)
    if not os.path.exists(path):
        return
    start = b""
    if os.path.isfile(path):
        with open(path, "rb") as file:
            start = file.read(_START_BYTES)
    if GENERATOR.encode() not in start:
        raise LumitreeError(
            f"{shown(path, 300)} is not a page of lumitree; choose another folder, or move it"
        )


class FolderIndex:
    """The pages of a folder: all lamps that have records, and lamps of a list without a record.

    Several processes may write them. Each reads the records before, so that the last one has all.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._records = Records(root)
        self._next = 0.0

    def update(self, lamps: Iterable[BakedLamp]) -> None:
        """Write the pages, unless that was done shortly before or another process does it now.

        Args:
            lamps: of the list of this process.
        """
        if time.monotonic() >= self._next:
            self._write(lamps, wait=False)

    def write(self, lamps: Iterable[BakedLamp]) -> list[BakedLamp]:
        """Write the pages; returns all lamps of the folder, by name."""
        return self._write(lamps, wait=True)

    def _write(self, lamps: Iterable[BakedLamp], wait: bool) -> list[BakedLamp]:
        start = time.monotonic()
        folder = self._root / FOLDER_FILES
        shown_lamps: list[FolderLamp] = []
        folder.mkdir(parents=True, exist_ok=True)
        shown_lamps = self._lamps(lamps)
        title = self._root.resolve().name or "lamps"
        pages = dict(folder_pages(title, shown_lamps))
        for name, content in pages.items():
            _write_changed(self._root / name, content)
        _remove_pages(folder, pages)
        end = time.monotonic()
        self._next = end + max(_EVERY_SECONDS, (end - start) / _SHARE)
        return [each.lamp for each in shown_lamps]

    def _lamps(self, lamps: Iterable[BakedLamp]) -> list[FolderLamp]:
        """Lamps of the folder, of the list, and of the parts that have begun, by name."""
        listed, _, parts = read_parts(self._root)
        found = {name: FolderLamp(BakedLamp(name, "", "waiting")) for name in listed}
        own = {lamp.name: FolderLamp(lamp) for lamp in lamps if lamp.path is None}
        found |= own
        found |= {
            name: each
            for name, each in self._records.lamps().items()
            # Of earlier settings, while the list does not say what became of the lamp.
            if (name not in own or own[name].lamp.state == "waiting")
            # Failed lamps that no list has any more would never be baked.
            and not (parts and each.lamp.state == "failed" and name not in found)
        }
        return sorted(found.values(), key=lambda each: (each.lamp.name.casefold(), each.lamp.name))


def _write_changed(path: Path, content: bytes) -> None:
    try:
        if path.stat().st_size == len(content) and path.read_bytes() == content:
            return
    except OSError:
        pass
    write_bytes(path, content)


def _remove_pages(folder: Path, pages: Iterable[str]) -> None:
    used = {os.path.basename(name) for name in pages}
    left = [
        name
        for name in os.listdir(folder)
        if _PAGE.fullmatch(name) is not None and name not in used
    ]
    remove_written(folder, left)
