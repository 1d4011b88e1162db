"""The files that a model names, which must lie in the model's own folder."""

import os
import re
from pathlib import Path

from lumitree.errors import LumitreeError, shown

# Largest size of a scene, of a model file and of an image that it names.
MAX_MODEL_BYTES = 512 * 2**20


class ModelFolder:
    """The folder of a model file, which the files that it names must lie in."""

    def __init__(self, model: str | os.PathLike[str]) -> None:
        self._folder = Path(os.path.realpath(Path(model).parent))

    def find(self, name: str, where: str) -> Path | None:
        """Path of a file that the model names; None where there is none.

        Args:
            name: relative to the model's folder, with / or \\.
            where: what names it, for messages.

        Raises:
            LumitreeError: the name leads out of the folder.
        """
        parts = name.replace("\\", "/").split("/")
        if (
            not name
            or "\0" in name
            or parts[0] == ""
            or ".." in parts
            or re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", name)
        ):
            raise LumitreeError(
                f"{where} names {shown(name)!r}; expected a file in the model's own folder: copy "
                "it there and name it without a path"
            )
        path = self._folder.joinpath(*parts)
        # No file has a name that the file system cannot encode, or that is too long for it.
        if not os.path.isfile(path):
            return None
        if not Path(os.path.realpath(path)).is_relative_to(self._folder):
            raise LumitreeError(
                f"{where} names {shown(name)!r}, a link out of the model's folder; put the file "
                "itself there"
            )
        return path
