"""Complex luminaires, baked once into a radiance field and given back to Mitsuba 3.

The public names are listed in `__init__.pyi`, and are imported on first use. Import lumitree before
mitsuba: it then names a working libLLVM to Mitsuba (see `lumitree.core.backend`).
"""

from lumitree.core.interruption import exit_on_signals, is_program

if is_program():
    # The command line imports this package first; `main` installs its own handlers.
    exit_on_signals()

import lazy_loader

from lumitree.core.backend import select_llvm

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

select_llvm()
