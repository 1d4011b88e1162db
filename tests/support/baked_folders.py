"""Folders of baked lamps, written without a bake."""

import os
import types

import lumitree
from lumitree.fit.catalogue import lamp_job, record
from lumitree.fit.catalogue.lamp_job import LampJob
from lumitree.fit.catalogue.record import LampFiles, LampRecord, options_text, settings_text
from lumitree.fit.catalogue.stamps import FileStamp, stamps_of
from lumitree.fit.config import BakeConfig
from lumitree.lamp.source import LuminaireSource
from support.fields import random_asset

# Time of the files, s since 1970: long ago, so that they are not compared by content.
LONG_AGO = 1_000_000_000


def make_old(*paths):
    """Files that have not been changed for long."""
    for path in paths:
        os.utime(path, (LONG_AGO, LONG_AGO))


def write_old(path, content):
    """A file that has not been changed for long."""
    path.write_bytes(content)
    make_old(path)


def record_of(files, options="[]", stamps=None, settings="{}", **changes):
    """Record of an asset that has been written."""
    values = {
        "options": options,
        "files": stamps,
        "fingerprint": "f" * 64,
        "settings": settings,
        "finished": True,
        "asset": FileStamp.of(files.asset, files.folder),
        "image": "webp",
        "seconds": 12.0,
        "figures": {
            "lumens": 1234.5,
            "file_bytes": files.asset.stat().st_size,
            "size": [1, 2, 3],
            "irradiance_rms": 0.01,
        },
    }
    return LampRecord(**values | changes)


def write_lamp(folder, name, **changes):
    """An asset of nonsense, a thumbnail and a record."""
    files = LampFiles(folder, name)
    (folder / "index-files").mkdir(parents=True, exist_ok=True)
    write_old(files.asset, name.encode())
    record = record_of(files, **changes)
    files.image(record).write_bytes(b"image")
    files.write(record)
    return files


def written_job(sources, folder, name, config=None):
    """The bake of a source that has been baked: its file in `sources`, and its record."""
    config = BakeConfig.of("standard") if config is None else config
    path = sources / f"{name}.xml"
    write_old(path, f"<scene>{name}</scene>".encode())
    source = LuminaireSource(str(path))
    settings = settings_text(config, source)
    write_lamp(
        folder,
        name,
        options=options_text(source, folder),
        stamps=stamps_of([path, path.with_suffix(".toml")], folder, 2**62),
        settings=settings,
    )
    return LampJob(folder, name, source, config, settings, None)


def bake_nothing(monkeypatch, seed=lambda source: 1):
    """Bakes of lists write random assets; returns the names of those that were baked, in order.

    Args:
        seed: of the asset of a source.
    """
    names = []

    def bake(source, output, config, **options):
        names.append(output.stem)
        asset = random_asset(seed(source), tree_depth=2, l_max=0)
        lumitree.save(asset, output)
        return types.SimpleNamespace(
            asset=asset, irradiance=None, finished=True, stopped_by=None, seconds={"light": 1.0}
        )

    monkeypatch.setattr(lamp_job, "bake_source", bake)
    monkeypatch.setattr(record, "thumbnail", lambda *_: b"image")
    monkeypatch.setattr("lumitree.rendering.asset_flux.asset_lumens", lambda _: 5.0)
    return names
