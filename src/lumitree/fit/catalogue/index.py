"""The index page of a folder of baked lamps."""

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from lumitree.core.files import check_writable, one_at_a_time, write_bytes
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, shown
from lumitree.fit.catalogue.page import GENERATOR, Entry, figure_rows, index_page
from lumitree.fit.catalogue.record import INDEX_FILES, LampFiles

INDEX = "index.html"
State = Literal["baked", "kept", "failed", "interrupted", "waiting"]
_MAX_INDEX_BYTES = 1 << 30


@dataclasses.dataclass(frozen=True)
class BakedLamp:
    """One lamp of `bake_many`.

    Attributes:
        name: of the lamp and of its files.
        source: luminaire that it was baked from.
        state: "baked"; "kept", if an earlier call has baked it with these settings; "failed";
            "interrupted", which the same call continues; or "waiting", if the call was
            interrupted before it, or while another process worked on it.
        path: file of the asset; None if none was written.
        error: why it failed; None if it did not.
        seconds: wall time of its bake, with that of earlier calls.
        figures: `lumens`, `file_bytes`, `size` and `irradiance_rms`; empty if there is no asset.
    """

    name: str
    source: str
    state: State
    path: Path | None = None
    error: str | None = None
    seconds: float = 0.0
    figures: dict[str, Any] = dataclasses.field(default_factory=dict)


def check_index(path: Path) -> None:
    """Refuse an index page that cannot be written, or that is not lumitree's."""
    check_writable(path)
    if os.path.exists(path):
        content = read_bytes(path, "an index page", _MAX_INDEX_BYTES)
        if GENERATOR.encode() not in content[:1000]:
            raise LumitreeError(
                f"{shown(path, 300)} is not a page of lumitree; choose another folder, or move it"
            )


def write_index(folder: Path, lamps: Sequence[BakedLamp]) -> None:
    """Write the index page of these lamps, and of others that the folder has records of.

    Another process may write it too. So records are read, and the page is written, by one process
    at a time: whichever is last has the records of all.
    """
    names = {lamp.name for lamp in lamps}
    with one_at_a_time(folder / INDEX_FILES):
        entries = [_recorded(folder, lamp) if lamp.state == "waiting" else lamp for lamp in lamps]
        for path in sorted((folder / INDEX_FILES).glob("*.json")):
            if path.stem not in names:
                lamp = _recorded(folder, BakedLamp(path.stem, "", "waiting"))
                entries += [lamp] if lamp.path is not None else []
        page = index_page(
            folder.resolve().name or "lamps", [_entry(folder, lamp) for lamp in entries]
        )
        write_bytes(folder / INDEX, page)


def _recorded(folder: Path, lamp: BakedLamp) -> BakedLamp:
    """A lamp with what its record says, if there is one."""
    files = LampFiles(folder, lamp.name)
    if (record := files.read()) is None:
        return lamp
    return dataclasses.replace(
        lamp,
        state="kept" if record.finished else "interrupted",
        path=files.asset,
        seconds=record.seconds,
        figures=record.figures,
    )


def _entry(folder: Path, lamp: BakedLamp) -> Entry:
    notes = {
        "failed": f"failed: {lamp.error}",
        "interrupted": "interrupted; the same command continues",
        "waiting": "not baked yet",
    }
    thumbnail = LampFiles(folder, lamp.name).thumbnail
    shows = lamp.path is not None and thumbnail.is_file()
    return Entry(
        name=lamp.name,
        link=None if lamp.path is None else lamp.path.name,
        image=thumbnail.read_bytes() if shows else None,
        rows=figure_rows(lamp.figures, lamp.seconds) if lamp.figures else (),
        note=notes.get(lamp.state, ""),
        failed=lamp.state == "failed",
    )
