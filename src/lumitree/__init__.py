"""Complex luminaires, baked once into a radiance field and given back to Mitsuba 3.

Import lumitree before mitsuba: it then names a working libLLVM to Mitsuba (see
`lumitree.core.backend`).
"""

from typing import TYPE_CHECKING, Any

from lumitree.core.backend import select_llvm
from lumitree.errors import LumitreeError

if TYPE_CHECKING:
    from lumitree.asset.file import load, save
    from lumitree.render.plugins import register
    from lumitree.render.shape import shape

__version__ = "0.1.0"
__all__ = ["LumitreeError", "load", "register", "save", "shape"]

_HOMES = {
    "load": "lumitree.asset.file",
    "save": "lumitree.asset.file",
    "register": "lumitree.render.plugins",
    "shape": "lumitree.render.shape",
}

select_llvm()


def __getattr__(name: str) -> Any:
    # Lazy, so that `lumitree --help` answers at once.
    if name in _HOMES:
        import importlib

        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'lumitree' has no attribute {name!r}")
