"""What a folder of baked lamps holds of each: the asset, a thumbnail, and a record of its bake."""

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

from lumitree.asset.asset import Asset
from lumitree.core.files import write_bytes, write_json
from lumitree.core.image_settings import image_settings
from lumitree.core.images import auto_exposure, encode_png, tonemap
from lumitree.core.reading import Record, parse_json, read_bytes
from lumitree.errors import LumitreeError
from lumitree.fit.config import BakeConfig
from lumitree.fit.sources import PHOTOMETRIC_SETTINGS
from lumitree.lamp.source import LuminaireSource, source_kind

# Folder of the thumbnails and records, within that of the assets.
INDEX_FILES = "index-files"
_VERSION = 1
_MAX_RECORD_BYTES, _MAX_ASSET_BYTES = 1 << 20, 1 << 40
_MAX_SETTINGS = 10_000
# Of a thumbnail: pixels per side, paths per pixel, and direction from the lamp to the camera.
_PIXELS, _SAMPLES = 192, 64
_FROM = (0.4, 0.25, 0.882)


@dataclasses.dataclass(frozen=True)
class LampRecord:
    """Record of a bake, from which the next call knows whether to repeat it.

    Attributes:
        fingerprint: of the luminaire's content.
        settings: of the bake, as JSON with sorted keys.
        finished: whether the bake was complete.
        asset_digest: SHA-256 of the asset's file.
        seconds: wall time of the bake, of all calls.
        figures: `lumens`, `file_bytes`, the three sides `size`, and `irradiance_rms` if the
            irradiance was compared.
    """

    fingerprint: str
    settings: str
    finished: bool
    asset_digest: str
    seconds: float
    figures: dict[str, Any]

    def is_of(self, fingerprint: str, settings: str) -> bool:
        """Whether it is the record of a bake of this luminaire with these settings."""
        return (self.fingerprint, self.settings) == (fingerprint, settings)


class LampFiles:
    """The files of one lamp in a folder.

    Attributes:
        name: of the lamp.
        asset, thumbnail: the asset, and an image of it.
        lock: held by the process that works on the lamp; see `core.files.exclusive`.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.name = name
        # Not `with_suffix`: a name may contain dots.
        self.asset = folder / f"{name}.lumitree"
        # Not beside the asset, where images and files of this name may be the user's.
        self.thumbnail = folder / INDEX_FILES / f"{name}.png"
        self.lock = folder / INDEX_FILES / f"{name}.lock"
        self._record = folder / INDEX_FILES / f"{name}.json"

    def read(self) -> LampRecord | None:
        """The record; None if there is none, it is damaged, or the asset is not the one of it."""
        try:
            record = Record(
                parse_json(read_bytes(self._record, "a record", _MAX_RECORD_BYTES)), "record"
            )
            record.expect_version(_VERSION)
            figures = record.record("figures")
            found = LampRecord(
                fingerprint=record.label("fingerprint"),
                settings=record.text("settings", _MAX_SETTINGS),
                finished=bool(record.choice("state", ("finished", "interrupted")) == "finished"),
                asset_digest=record.label("asset_sha256"),
                seconds=record.number("seconds"),
                figures={
                    "lumens": figures.number("lumens"),
                    "file_bytes": figures.integer("file_bytes"),
                    "size": figures.array("size", 3).tolist(),
                    "irradiance_rms": figures.number("irradiance_rms")
                    if figures.has("irradiance_rms")
                    else None,
                },
            )
            return found if found.asset_digest == self._digest() else None
        except LumitreeError:
            return None

    def write(
        self,
        asset: Asset,
        irradiance: dict[str, Any] | None,
        *,
        fingerprint: str,
        settings: str,
        finished: bool,
        seconds: float,
    ) -> LampRecord:
        """Write the thumbnail and the record of an asset that has been written."""
        from lumitree.core.directions import pose_towards
        from lumitree.rendering.asset_flux import asset_lumens
        from lumitree.rendering.asset_images import shown_images

        described = image_settings("bake", lamp=asset.luminaire, settings=json.loads(settings))
        pose = pose_towards(_FROM, (0, 1, 0), 4.0)
        ((radiance, _),) = shown_images(asset, [pose], 1.75, _PIXELS, _SAMPLES)
        write_bytes(
            self.thumbnail, encode_png(tonemap(radiance, auto_exposure(radiance)), described)
        )
        figures: dict[str, Any] = {
            "lumens": asset_lumens(asset),
            "file_bytes": self.asset.stat().st_size,
            "size": asset.frame.size.tolist(),
        }
        if irradiance is not None and "irradiance_rms" in irradiance:
            figures["irradiance_rms"] = irradiance["irradiance_rms"]
        record = LampRecord(fingerprint, settings, finished, self._digest(), seconds, figures)
        write_json(
            self._record,
            {
                "version": _VERSION,
                "state": "finished" if finished else "interrupted",
                "fingerprint": fingerprint,
                "settings": settings,
                "asset_sha256": record.asset_digest,
                "seconds": round(seconds, 1),
                "figures": figures,
            },
        )
        return record

    def _digest(self) -> str:
        content = read_bytes(self.asset, "a .lumitree asset", _MAX_ASSET_BYTES)
        return hashlib.sha256(content).hexdigest()


def settings_text(config: BakeConfig, source: LuminaireSource) -> str:
    """The settings that apply to a source, as JSON; equal settings have equal text."""
    settings = dataclasses.asdict(config)
    if source_kind(source) == "photometric":
        settings = {name: settings[name] for name in PHOTOMETRIC_SETTINGS}
    return json.dumps(settings, sort_keys=True)
