"""The files that a model names, never outside its own folder, never larger than is sensible."""

import os
import re
from pathlib import Path

from lumitree.errors import LumitreeError, shown

MAX_MODEL_BYTES = 512 * 2**20
_MAX_SHOWN_PATH = 300


def read_limited(path: Path, limit: int = MAX_MODEL_BYTES) -> bytes:
    """Bytes of a regular file.

    Raises:
        LumitreeError: there is none, it cannot be read, or it is larger than `limit` bytes.
    """
    name = shown(path, _MAX_SHOWN_PATH)
    if not os.path.isfile(path):
        found = "is a folder" if os.path.isdir(path) else "does not exist or is not a file"
        raise LumitreeError(f"{name} {found}; expected a file")
    try:
        with path.open("rb") as file:
            data = file.read(min(os.fstat(file.fileno()).st_size, max(limit, 0)) + 1)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise LumitreeError(f"{name} cannot be read: {reason}; check its permissions") from None
    if len(data) > limit:
        size = f"{limit // 2**20} MiB" if limit >= 2**20 else f"{limit} bytes"
        raise LumitreeError(f"{name} is larger than {size}; make it smaller")
    return data


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
