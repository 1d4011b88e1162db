"""Assets that are open: each is read once, and shared while anything uses it; their information.

Photometric files are assets once they are opened, so all that takes an asset takes them.
"""

import itertools
import os
import threading
import weakref
from pathlib import Path

from lumitree.asset.asset import Asset
from lumitree.asset.file import load as read_asset
from lumitree.core.backend import in_turn, load_mitsuba
from lumitree.core.files import FilePath
from lumitree.core.results import Json, plain
from lumitree.errors import LumitreeError, shown
from lumitree.lamp.builtin import BUILTIN
from lumitree.lamp.source import (
    LuminaireSource,
    gldf_variant,
    refuse_options,
    source_kind,
)
from lumitree.trace.light_field_config import LightFieldConfig

# File names that stand for assets in memory.
_IN_MEMORY = "lumitree-asset-in-memory-"
_NUMBERS = itertools.count()
_LOCK = threading.Lock()
_NAMED: "weakref.WeakValueDictionary[str, Asset]" = weakref.WeakValueDictionary()
_READ: "weakref.WeakValueDictionary[tuple[object, ...], Asset]" = weakref.WeakValueDictionary()


def file_name(asset: Asset | str | os.PathLike[str]) -> str:
    """Name by which plugins find an asset: its path, or one that stands for it in this process."""
    if not isinstance(asset, Asset):
        return os.fspath(asset)
    with _LOCK:
        for name, other in _NAMED.items():
            if other is asset:
                return name
        name = f"{_IN_MEMORY}{next(_NUMBERS)}"
        _NAMED[name] = asset
        return name


def open_asset(asset: Asset | str | os.PathLike[str]) -> Asset:
    """The asset of a file, of a name that `file_name` gave, or the asset itself.

    Args:
        asset: an asset, the path of a `.lumitree` file, or the path of a photometric file or ray
            file, of which an asset of the quality "standard" is made.

    Raises:
        LumitreeError: the file is missing or damaged, or is something else, which is named.
    """
    if isinstance(asset, Asset):
        return asset
    if (named := _NAMED.get(os.path.basename(asset))) is not None:
        return named
    file, variant = gldf_variant(asset)
    if not os.path.exists(file):
        return _read(asset)
    path = Path(file).resolve()
    stamp = path.stat()
    key = (path, variant, stamp.st_mtime_ns, stamp.st_size, stamp.st_ino)
    found = _READ.get(key)
    if found is None:
        # If two threads read a file, the first asset is kept.
        found = _read(asset)
        with _LOCK:
            found = _READ.setdefault(key, found)
    return found


def _read(path: str | os.PathLike[str]) -> Asset:
    kind = source_kind(path)
    if kind == "photometric":
        load_mitsuba()
        # Assets are read without Mitsuba.
        from lumitree.formats.photometric_file import bake_file

        return bake_file(path, LightFieldConfig())
    name = os.fspath(path)
    if kind == "dataset" or (name in BUILTIN and not os.path.exists(path)):
        what = "a dataset" if kind == "dataset" else "a built-in luminaire"
        raise LumitreeError(
            f"{shown(name, 300)} is {what}, not an asset; bake it first, into a .lumitree file"
        )
    return read_asset(path)


@in_turn
def load(path: FilePath) -> Asset:
    """Read an asset from a file, and check it. Nothing in the file is executed.

    Args:
        path: path of a `.lumitree` file; or of a photometric file (`.ies`, `.ldt`, `.gldf`,
            `.tm33`) or a ray file (`.ray`, `.tm25ray`), of which an asset is made as by `bake`.
            While an asset is in use, further calls for its file return the same one.

    Returns:
        The asset.

    Raises:
        LumitreeError: the file is missing, damaged or not an asset, or breaks an invariant.
    """
    return open_asset(path)


def refuse_frame(source: object, metres: float, up: str) -> None:
    """Refuse a unit or an upward axis of the light of a photometric file, which states its own."""
    if (metres, up) != (1, "y"):
        raise LumitreeError(
            f"unit and up: not for a photometric file such as {shown(source, 300)}, which states "
            "its unit; leave them out"
        )


def asset_of(source: object) -> Asset | None:
    """The asset that a source is once it is opened; None for a luminaire or a dataset.

    Raises:
        LumitreeError: the asset cannot be read, or there are options for reading a luminaire.
    """
    if source_kind(source) not in ("asset", "photometric"):
        return None
    if isinstance(source, LuminaireSource):
        refuse_options(source, "an asset or a photometric file")
        source = source.name
    assert isinstance(source, Asset | str | os.PathLike)
    return open_asset(source)


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
