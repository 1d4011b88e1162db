"""All readers, by name; the module of one is imported only when it is needed."""

import importlib

from fuzz.reader import Reader

# Names of readers by the module that has them.
MODULES = {
    "assets": ("asset",),
    "photometric": ("ies", "ldt", "tm25", "tm33"),
    "gldf": ("gldf",),
    "models": ("obj", "gltf"),
    "tables": (
        *("placements", "settings", "points", "dataset", "layers", "record", "state", "run"),
    ),
}
# For tests of the runner.
_FAULTS = {"faults": ("crash", "hang", "reserve", "exit")}
NAMES = tuple(name for names in MODULES.values() for name in names)


def reader(name: str) -> Reader:
    """The reader of a name."""
    every = MODULES | _FAULTS
    module = next(each for each, names in every.items() if name in names)
    found = importlib.import_module(f"fuzz.{module}").READERS
    return next(each for each in found if each.name == name)
