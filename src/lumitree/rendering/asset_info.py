"""Information about an asset without its luminaire: its contents and its flux."""

import os
from pathlib import Path

from lumitree.asset.asset import Asset
from lumitree.core.backend import load_mitsuba
from lumitree.core.results import Json, plain
from lumitree.lamp.source import gldf_variant


def asset_json(asset: Asset, path: str | os.PathLike[str] | None) -> Json:
    """`Asset.info` as a dictionary, with `file` and `file_bytes` if `path` is not None."""
    info: Json = plain(asset.info)
    if path is None:
        return info
    return {
        "file": os.fspath(path),
        "file_bytes": Path(gldf_variant(path)[0]).stat().st_size,
        **info,
    }


def asset_report(asset: Asset, path: str | os.PathLike[str]) -> Json:
    """The output of `lumitree info`: `asset_json`, and the luminous flux, lm, for metres.

    For a photometric file it includes what the file states of how it was made.
    """
    from lumitree.formats.photometric_file import details_of
    from lumitree.rendering.asset_flux import asset_lumens

    if asset.light_field is None:
        # Estimated by rays; else a sum that needs no variant of Mitsuba, and so no libLLVM.
        load_mitsuba()
    return {**asset_json(asset, path), "lumens": asset_lumens(asset), **details_of(path)}
