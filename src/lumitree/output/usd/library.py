"""The library of OpenUSD, an optional dependency."""

import importlib
from typing import Any

from lumitree.errors import LumitreeError

_MODULES = ("Gf", "Kind", "Sdf", "Tf", "Usd", "UsdGeom", "UsdLux", "UsdShade", "UsdUtils", "Vt")


def load_usd() -> Any:
    """The package `pxr`, whose modules state no types; refuses to go on without it."""
    try:
        library: Any = importlib.import_module("pxr")
        for name in _MODULES:
            importlib.import_module(f"pxr.{name}")
    except ImportError as error:
        raise LumitreeError(
            f"USD files need the package usd-core ({error}); install it with "
            "`pip install 'lumitree[usd]'`"
        ) from None
    return library
