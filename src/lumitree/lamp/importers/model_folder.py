"""The files that a model names, which must lie in the model's own folder."""

import contextlib
import contextvars
import os
import re
import unicodedata
import warnings
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

from lumitree.errors import LumitreeError, LumitreeWarning, shown

# Largest size of a scene, of a model file and of an image that it names.
MAX_MODEL_BYTES = 512 * 2**20
# Last components of a path that are looked for in the model's folder.
_MAX_COMPONENTS = 32

# Files that models have named in the innermost block of `noted_files`.
_noted: contextvars.ContextVar[set[Path] | None] = contextvars.ContextVar("noted", default=None)


@contextlib.contextmanager
def noted_files() -> Iterator[set[Path]]:
    """Context that notes the files that models name in it, also those that are missing."""
    files: set[Path] = set()
    token = _noted.set(files)
    try:
        yield files
    finally:
        _noted.reset(token)


class ModelFolder:
    """The folder of a model file: nothing outside it is read.

    A name is a path relative to the folder. A name with another path (absolute, of Windows, a URL,
    or with ..) often remains from the machine on which the model was made. Then the file of the
    same name in the folder is taken: that for which most of the path's last components agree.
    Lower and upper case are not distinguished if no file has the exact name.
    """

    def __init__(self, model: str | os.PathLike[str]) -> None:
        self._folder = Path(os.path.realpath(Path(model).parent))
        self._listings: dict[Path, dict[str, str]] = {}
        # Warned of once.
        self._substituted: set[str] = set()

    def find(self, name: str, where: str) -> Path | None:
        """Path of a file that the model names; None where there is none.

        A file with another path or in another case is taken with a warning.

        Args:
            name: with / or \\ between components.
            where: what names it, for messages.

        Raises:
            LumitreeError: the file is a link that leads out of the folder.
        """
        components, relative = _components(name)
        path = self._folder.joinpath(*components) if relative else None
        exact = path is not None and os.path.isfile(path)
        named = path
        path = path if exact else self._similar(components)
        if (files := _noted.get()) is not None:
            files |= {each for each in (named, path) if each is not None}
        if path is None:
            return None
        if not Path(os.path.realpath(path)).is_relative_to(self._folder):
            raise LumitreeError(
                f"{where} names {shown(name)!r}, a link out of the model's folder; put the file "
                "itself there"
            )
        if not exact and name not in self._substituted:
            self._substituted.add(name)
            found = shown(path.relative_to(self._folder).as_posix())
            warnings.warn(
                f"{where} names {shown(name)!r}; {found!r} in the model's folder is taken",
                LumitreeWarning,
                stacklevel=3,
            )
        return path

    def _similar(self, components: list[str]) -> Path | None:
        """The file that agrees with most of the last components, in any case."""
        components = components[-_MAX_COMPONENTS:]
        for first in range(len(components)):
            path = self._folder
            for component in components[first:]:
                found = self._listing(path).get(_folded(component))
                if found is None:
                    break
                path = path / found
            else:
                if os.path.isfile(path):
                    return path
        return None

    def _listing(self, folder: Path) -> dict[str, str]:
        """Names in a folder by the same without case; of several the first in order.

        Links out of the model's folder are not followed.
        """
        if folder not in self._listings:
            inside = Path(os.path.realpath(folder)).is_relative_to(self._folder)
            try:
                names = sorted(os.listdir(folder), reverse=True) if inside else []
            except OSError:
                names = []
            self._listings[folder] = {_folded(name): name for name in names}
        return self._listings[folder]


def _components(name: str) -> tuple[list[str], bool]:
    """Components of a path, and whether it is relative to the model's folder and below it."""
    if "\0" in name:
        return [], False
    scheme = re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", name)
    if scheme is not None:
        name = name[scheme.end() :]
        # A single letter is a drive.
        if scheme.end() > 2:
            name = unquote(name)
    parts = name.replace("\\", "/").split("/")
    relative = scheme is None and parts[0] != "" and ".." not in parts
    if ".." in parts:
        parts = parts[len(parts) - parts[::-1].index("..") :]
    return [part for part in parts if part not in ("", ".")], relative


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()
