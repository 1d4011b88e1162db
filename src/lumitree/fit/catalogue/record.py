"""Files of each baked lamp of a folder: the asset, a thumbnail, and a record of its bake.

A record is one small file, so that writing one costs the same however many lamps there are, and a
process that is killed damages none.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any, Literal

from lumitree.asset.asset import Asset
from lumitree.core.files import write_bytes, write_json
from lumitree.core.reading import Record, parse_json, read_bytes
from lumitree.core.system import remove
from lumitree.errors import LumitreeError, shown
from lumitree.fit.catalogue.stamps import FileStamp, current_stamps, read_stamp, relative_name
from lumitree.fit.catalogue.thumbnail import thumbnail, thumbnail_kind
from lumitree.fit.config import BakeConfig
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.source import LuminaireSource, source_kind

# Folder of the thumbnails and records, within the assets' folder.
INDEX_FILES = "index-files"
RECORD, FAILURE = ".json", ".failed"
VERSION = 2
# Records of this version have neither the files of the source nor the stamp of the asset.
_FIRST_VERSION = 1
_MAX_RECORD_BYTES = 1 << 22
_MAX_SETTINGS, _MAX_REASON = 10_000, 1000
State = Literal["baked", "kept", "failed", "interrupted", "waiting"]


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
        seconds: wall time of its bake, including earlier calls.
        figures: `lumens`, `file_bytes`, `size` and `irradiance_rms`; empty if there is no asset.
    """

    name: str
    source: str
    state: State
    path: Path | None = None
    error: str | None = None
    seconds: float = 0.0
    figures: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class LampRecord:
    """Record of a bake, from which the next call knows whether to repeat it.

    Attributes:
        options: how the luminaire is named and read; see `options_text`.
        files: stamps of the files on which it depends; None if they are not known.
        fingerprint: of the luminaire's content.
        settings: of the bake, as JSON with sorted keys.
        finished: whether the bake was complete.
        asset: stamp of the asset's file.
        image: suffix of the thumbnail's file.
        seconds: wall time of the bake, of all calls.
        figures: `lumens`, `file_bytes`, the three sides `size`, and `irradiance_rms`, which is None
            if the irradiance was not compared.
    """

    options: str
    files: tuple[FileStamp, ...] | None
    fingerprint: str
    settings: str
    finished: bool
    asset: FileStamp
    image: str
    seconds: float
    figures: dict[str, Any]

    def is_of(self, fingerprint: str, settings: str) -> bool:
        """Whether it is the record of a bake of this luminaire with these settings."""
        return (self.fingerprint, self.settings) == (fingerprint, settings)

    def current(self, folder: Path) -> "LampRecord | None":
        """The record with the stamps of now, if the files on which the lamp depends are the same.

        None if one has another content, or if they are not known. Files are only read if their
        time has changed.
        """
        if self.files is None:
            return None
        files = current_stamps(self.files, folder)
        return None if files is None else dataclasses.replace(self, files=files)

    def of_asset(self, folder: Path) -> "LampRecord | None":
        """The record with the stamp of the asset as it is now; None if that is another file."""
        asset = self.asset.current(folder)
        return None if asset is None else dataclasses.replace(self, asset=asset)


class LampFiles:
    """The files of the lamp `name` in the folder of the assets."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder = folder
        self.name = name
        # Not `with_suffix`: a name may contain dots.
        self.asset = folder / f"{name}.lumitree"

    @property
    def claim(self) -> Path:
        """File that the process has which works on the lamp; see `fit.catalogue.claim`."""
        return self._within(".claim")

    def image(self, record: LampRecord) -> Path:
        """File of the thumbnail."""
        return self._within(f".{record.image}")

    def _within(self, suffix: str) -> Path:
        # Not beside the asset, where images and files of this name may be the user's.
        return self.folder / INDEX_FILES / f"{self.name}{suffix}"

    def read(self) -> LampRecord | None:
        """The record; None if there is none, or it is damaged.

        Whether the asset is the one of the record is `LampRecord.of_asset`.
        """
        try:
            value = parse_json(read_bytes(self._within(RECORD), "a record", _MAX_RECORD_BYTES))
            return _record(value, self.asset.name)
        except LumitreeError:
            return None

    def read_failure(self) -> str | None:
        """Why the latest bake failed; None if it did not."""
        try:
            value = parse_json(read_bytes(self._within(FAILURE), "a record", _MAX_RECORD_BYTES))
            return Record(value, "record").text("error", _MAX_REASON)
        except LumitreeError:
            return None

    def write(self, record: LampRecord) -> None:
        """Write the record; the lamp has then not failed."""
        write_json(self._within(RECORD), _json(record))
        remove(self._within(FAILURE))

    def write_failure(self, reason: str) -> None:
        """Write why a bake failed. The record of an earlier one stays."""
        write_json(self._within(FAILURE), {"version": VERSION, "error": reason})

    def write_image(self, asset: Asset, settings: str) -> str:
        """Write the thumbnail of an asset; returns the suffix of its file."""
        kind = thumbnail_kind()
        write_bytes(self._within(f".{kind}"), thumbnail(asset, json.loads(settings)))
        return kind

    def stamp(self) -> FileStamp:
        """The stamp of the asset as it is."""
        stamp = FileStamp.of(self.asset, self.folder)
        if stamp is None or stamp.size < 0:
            raise LumitreeError(f"{shown(self.asset, 300)} has been removed; bake it again")
        return stamp


def figures_of(asset: Asset, file_bytes: int, irradiance: dict[str, Any] | None) -> dict[str, Any]:
    """Figures of a record; `irradiance` is taken from the result of the bake."""
    from lumitree.rendering.asset_flux import asset_lumens

    return {
        "lumens": asset_lumens(asset),
        "file_bytes": file_bytes,
        "size": asset.frame.size.tolist(),
        "irradiance_rms": (irradiance or {}).get("irradiance_rms"),
    }


def _json(record: LampRecord) -> dict[str, Any]:
    files = None if record.files is None else [stamp.to_json() for stamp in record.files]
    return {
        "version": VERSION,
        "state": "finished" if record.finished else "interrupted",
        "options": record.options,
        "files": files,
        "fingerprint": record.fingerprint,
        "settings": record.settings,
        "asset": record.asset.to_json()[1:],
        "image": record.image,
        "seconds": round(record.seconds, 1),
        "figures": record.figures,
    }


def _record(value: Any, asset_name: str) -> LampRecord:
    """The record of a JSON value, also one of the first version."""
    record = Record(value, "record")
    first = record.choice("version", (_FIRST_VERSION, VERSION)) == _FIRST_VERSION
    figures = record.record("figures")
    read = {
        "lumens": figures.number("lumens"),
        "file_bytes": figures.integer("file_bytes"),
        "size": figures.array("size", 3).tolist(),
        "irradiance_rms": None
        if figures.is_null("irradiance_rms")
        else figures.number("irradiance_rms"),
    }
    if first:
        # The time is not known, so the content is compared.
        asset = [read["file_bytes"], 0, record.text("asset_sha256", 64)]
    else:
        asset = record.items("asset")
    known = not first and not record.is_null("files")
    return LampRecord(
        options="" if first else record.text("options", _MAX_SETTINGS),
        files=tuple(map(read_stamp, record.items("files"))) if known else None,
        fingerprint=record.label("fingerprint"),
        settings=record.text("settings", _MAX_SETTINGS),
        finished=record.choice("state", ("finished", "interrupted")) == "finished",
        asset=dataclasses.replace(read_stamp(["", *asset]), name=asset_name),
        image="png" if first else record.choice("image", ("webp", "png")),
        seconds=record.number("seconds"),
        figures=read,
    )


def settings_text(config: BakeConfig, source: LuminaireSource) -> str:
    """The settings that apply to a source, as JSON; equal settings have equal text."""
    settings = dataclasses.asdict(config)
    if source_kind(source) == "photometric":
        settings = {name: settings[name] for name in ("light", "lumens", "temperature")}
        # Its numbers of light paths are for luminaires.
        grid = settings["light"]
        settings["light"] = {name: grid[name] for name in ("depth", "resolution")}
    return json.dumps(settings, sort_keys=True)


def options_text(source: LuminaireSource, folder: Path) -> str:
    """How a source is named and read, as JSON: its file and its options, relative to a folder."""

    name = source.name if source.name in BUILTIN else relative_name(source.name, folder)
    materials = None if source.materials is None else relative_name(source.materials, folder)
    return json.dumps([name, materials, source.keep, source.drop])


def source_of(record: LampRecord) -> str:
    """Name of the luminaire, relative to the folder; empty if the record does not state it."""
    try:
        described = json.loads(record.options)
    except ValueError:
        return ""
    return shown(described[0], 1000) if isinstance(described, list) and described else ""
