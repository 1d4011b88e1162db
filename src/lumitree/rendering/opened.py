"""Assets and their fields that are open: each is read once, and shared while anything uses it."""

import itertools
import os
import threading
import weakref
from pathlib import Path

from lumitree.asset.asset import Asset
from lumitree.asset.file import load
from lumitree.octree.field import Field, shared_field

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

    Raises:
        LumitreeError: as `lumitree.load`.
    """
    if isinstance(asset, Asset):
        return asset
    if (named := _NAMED.get(os.path.basename(asset))) is not None:
        return named
    path = Path(asset).resolve()
    stamp = path.stat() if os.path.exists(path) else None
    key = (path, stamp and (stamp.st_mtime_ns, stamp.st_size, stamp.st_ino))
    found = _READ.get(key)
    if found is None:
        # As in `shared_field`: of two threads that read a file the first's asset is kept.
        found = load(path)
        with _LOCK:
            found = _READ.setdefault(key, found)
    return found


def open_field(
    asset: Asset | str | os.PathLike[str], min_density: float = 0.0, max_opacity: float = 1.0
) -> Field:
    """The field of an asset on the device; arguments as for `open_asset` and `Field`."""
    return shared_field(open_asset(asset), min_density, max_opacity)
