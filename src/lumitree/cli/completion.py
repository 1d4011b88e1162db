"""Completion of the command line by the shell, with argcomplete.

The shell calls the program with `_ARGCOMPLETE` set. Nothing is imported here that takes time.
"""

import argparse
import os
from collections.abc import Callable
from typing import Any

# Not read from the registry, whose imports take longer than a completion may.
BUILTIN_NAMES = ("arc", "bulbs", "cluster", "dallas", "neoclassical", "portica", "star")
_LUMINAIRE = ("xml", "obj", "gltf", "glb")
_PHOTOMETRIC = ("ies", "ldt", "ray", "tm25ray")
# Endings of the files of an argument, by its name in the help; no ending: folders only.
_ENDINGS = {
    "ASSET": ("lumitree",),
    "ASSET|FOLDER/": ("lumitree",),
    "ASSET|LUMINAIRE": ("lumitree", *_PHOTOMETRIC, *_LUMINAIRE),
    "LUMINAIRE": _LUMINAIRE,
    "LUMINAIRE|DATASET": ("lumitree", *_PHOTOMETRIC, *_LUMINAIRE),
    "SCENE.xml": ("xml",),
    "SHEET": ("png",),
    "IMAGE": ("exr", "png"),
    "DATASET": (),
    "RUN": (),
    "DIR": (),
}
# The same for options that share a name in the help, and for arguments that take more.
_ENDINGS_BY_DEST = {
    "asset": ("lumitree", *_PHOTOMETRIC),
    "luminaires": (*_LUMINAIRE, *_PHOTOMETRIC),
    "place": ("lumitree", *_PHOTOMETRIC, *_LUMINAIRE),
    "materials": ("toml",),
    "placements": ("toml",),
    "json": ("json",),
}


def complete(parser: argparse.ArgumentParser) -> None:
    """Print the completions and end the process, if the shell asks for them; else do nothing."""
    if "_ARGCOMPLETE" not in os.environ:
        return
    import argcomplete

    _add_completers(parser)
    argcomplete.autocomplete(parser)


def _add_completers(parser: argparse.ArgumentParser) -> None:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _add_completers(command)
        elif (endings := _endings(action)) is not None:
            action.completer = _completer(action, endings)  # type: ignore[attr-defined]


def _endings(action: argparse.Action) -> tuple[str, ...] | None:
    """Endings of the files that an argument takes; None if it is not the name of a file."""
    metavar = action.metavar if isinstance(action.metavar, str) else ""
    return _ENDINGS_BY_DEST.get(action.dest, _ENDINGS.get(metavar))


def _completer(action: argparse.Action, endings: tuple[str, ...]) -> Callable[..., list[str]]:
    """Completer of file names with these endings, of folders, and of built-in luminaires."""
    named = "xml" in endings and action.metavar != "SCENE.xml"

    def names(prefix: str, **options: Any) -> list[str]:
        from argcomplete.completers import DirectoriesCompleter, FilesCompleter

        files = FilesCompleter(endings) if endings else DirectoriesCompleter()
        builtin = [name for name in BUILTIN_NAMES if named and name.startswith(prefix)]
        return [*builtin, *files(prefix, **options)]

    return names
